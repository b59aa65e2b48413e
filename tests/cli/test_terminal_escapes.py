"""Names of others with escape sequences and markup: no command passes them on to a terminal."""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from lidar_emu.cli.plain_console import PlainConsole
from lidar_emu.errors import printable

EVIL = "evil\x1b]0;owned\x07\x1b[2J\x9b31m\u202e[bold]x"
SHOWN = r"evil\x1b]0;owned\x07\x1b[2J\x9b31m\u202e[bold]x"
SCENARIOS = Path(__file__).parents[2] / "scenarios"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scenario and a recording with such names."""
    folder = tmp_path_factory.mktemp("evil")
    for name in ("descent", "bench"):
        shutil.copy(SCENARIOS / f"{name}.yaml", folder / f"{name}{EVIL}.yaml")
    recorded = ["run", f"bench{EVIL}.yaml", "--duration", "0.3", "--pace", "max", "--record", f"{EVIL}.mcap"]
    subprocess.run(
        [sys.executable, "-m", "lidar_emu", *recorded], cwd=folder, check=True, stdout=subprocess.DEVNULL
    )
    return folder


@pytest.mark.parametrize(
    "command",
    [
        ["run", f"bench{EVIL}.yaml", "--duration", "0.2", "--pace", "max"],
        ["plan", f"descent{EVIL}.yaml"],
        ["simulate", f"bench{EVIL}.yaml", "--duration", "0.2", "--out", f"{EVIL}.csv"],
        ["detection", f"descent{EVIL}.yaml"],
        ["ground", f"descent{EVIL}.yaml"],
        ["report", f"{EVIL}.mcap"],
        ["report", f"{EVIL}.mcap", "--json"],
        ["replay", f"{EVIL}.mcap", "--to", f"{EVIL}.pcap"],
        ["replay", f"{EVIL}.mcap", "--recompute"],
        ["run", f"missing{EVIL}.yaml"],
        ["run", f"bench{EVIL}.yaml", "--set", f"{EVIL}=1"],
        ["run", f"bench{EVIL}.yaml", "--port", f"/dev/{EVIL}"],
        ["run", f"bench{EVIL}.yaml", "-i", EVIL],
    ],
    ids=lambda command: (
        " ".join(command).encode("ascii", "ignore").decode().translate(dict.fromkeys(range(32)))
    ),
)
@pytest.mark.slow
def test_no_command_prints_what_a_terminal_obeys(folder: Path, command: list[str]) -> None:
    ran = subprocess.run(
        [sys.executable, "-m", "lidar_emu", *command], cwd=folder, capture_output=True, timeout=300
    )
    printed = (ran.stdout + ran.stderr).decode()
    assert printed
    assert set("".join(printed.split())) <= {c for c in printed if c.isprintable()}
    assert "Traceback" not in printed


def test_text_is_shown_as_it_is() -> None:
    assert printable(EVIL) == SHOWN
    assert printable("as it is:\n\t42 µm, 7.5°") == "as it is:\n\t42 µm, 7.5°"
    shown = io.StringIO()
    PlainConsole(file=shown, force_terminal=True, width=200).print(
        EVIL + ":100:", style="bold", highlight=False
    )
    assert SHOWN.replace(r"\x07", "") + ":100:" in shown.getvalue(), "rich itself removes the bell"
    assert "\x1b[1m" in shown.getvalue(), "a style of our own stays"
    assert "\x1b]" not in shown.getvalue()
