"""The list of tests that may be skipped: every line is about tests that exist, and another skip is a failure."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from allowed_skips import AllowedSkip, allowed_skips, is_allowed

ROOT = Path(__file__).resolve().parents[2]
SOCKETCAN = "tests/integration/socketcan/test_on_the_bus.py::test"


@pytest.mark.parametrize("line", allowed_skips(), ids=lambda line: f"{line.tests}: {line.reason}")
def test_a_line_is_about_tests_that_state_its_reason(line: AllowedSkip) -> None:
    assert line.where in ("anywhere", "developer")
    assert line.why
    path = ROOT / line.tests
    sources = [*path.rglob("*.py")] if path.is_dir() else [path]
    sources += [*(ROOT / "tests" / "support").glob("*.py"), ROOT / "examples" / "flight_processor" / "fly.py"]
    assert any(line.reason in source.read_text(encoding="utf-8") for source in sources)


def test_where_a_skip_is_allowed() -> None:
    assert is_allowed(SOCKETCAN, "needs SocketCAN: tests/...", in_ci=True)
    assert not is_allowed(SOCKETCAN, "it is late", in_ci=False)
    assert is_allowed("tests/protocol/test_c_misra.py", "not installed: cppcheck", in_ci=False)
    assert not is_allowed("tests/protocol/test_c_misra.py", "not installed: cppcheck", in_ci=True)


SKIPPED_TEST = "import pytest\n\n\ndef test_it():\n    pytest.skip('no time')\n"
SKIPPED_FILE = "import pytest\n\npytest.skip('no time', allow_module_level=True)\n"


@pytest.mark.slow
@pytest.mark.parametrize("source", [SKIPPED_TEST, SKIPPED_FILE], ids=["a test", "a file"])
def test_another_skip_is_a_failure(source: str, tmp_path: Path) -> None:
    (tmp_path / "test_skipped.py").write_text(source)
    command = ["-m", "pytest", "-p", "no:cacheprovider", "-p", "conftest", "test_skipped.py"]
    options = ["--rootdir", ".", "-c", str(ROOT / "pyproject.toml")]
    environment = {"PYTHONPATH": f"{ROOT / 'tests'}:{ROOT / 'tests' / 'support'}"}
    done = subprocess.run(
        [sys.executable, *command, *options], cwd=tmp_path, env=environment, text=True, capture_output=True
    )
    assert done.returncode in (1, 2)
    assert "may not be skipped by allowed_skips.txt: no time" in done.stdout
