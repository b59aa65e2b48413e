"""The budget: every number has a limit with a reason, and exceeding one is an error."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = ROOT / "tools" / "budget.py"


def test_exceeding_a_limit_is_an_error_that_states_its_reason(tmp_path: Path) -> None:
    """A copy of the program counts a tree that has hardly anything, against limits of 0 and of plenty."""
    text = (ROOT / "budget.toml").read_text(encoding="utf-8")
    for each in tomllib.loads(text).values():
        assert len(each["why"]) > 20
        assert each["limit"] >= each.get("goal", 0), "a goal that is reached becomes the limit"
    for folder in ("tools", "docs/reference"):
        (tmp_path / folder).mkdir(parents=True)
    copy = tmp_path / "tools" / "budget.py"
    copy.write_bytes(PROGRAM.read_bytes())
    (tmp_path / "README.md").write_text("two words")
    (tmp_path / "docs" / "reference" / "a.md").write_text("| key | type |\n|---|---|\n| `a` | b |\n")
    (tmp_path / "pyproject.toml").write_text("[project.optional-dependencies]\na = []\n")
    for words, code in ((2, 0), (1, 1)):
        limits = re.sub(r"(\[page_words\]\nlimit = ).*(\ngoal = .*)?", rf"\g<1>{words}\ngoal = 1", text)
        (tmp_path / "budget.toml").write_text(
            re.sub(r"(\[(?:options|commands)\]\nlimit = ).*", r"\g<1>999", limits)
        )
        done = subprocess.run([sys.executable, str(copy)], capture_output=True, text=True)
        assert done.returncode == code, done.stdout
        assert ("OVER by 1: " in done.stdout) is bool(code)
        assert re.search(rf"page_words +2 of +{words}  goal 1, 1 to go", done.stdout)
        assert re.search(r"keys +1 of", done.stdout)
