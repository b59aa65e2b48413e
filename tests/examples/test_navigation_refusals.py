"""What the navigation example is given and cannot use."""

from __future__ import annotations

import sys

import navigate
import pytest


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["nothing.yaml", "--port", "/dev/null"], "nothing.yaml"),
        (["bench.yaml", "--port", "/dev/null"], "bench_pattern"),
        (["descent.yaml"], "--port"),
        (["descent.yaml", "--port", "/dev/no-such-port"], "/dev/no-such-port"),
        (["descent.yaml", "--port", "/dev/null", "-i", "slcan"], "--port"),
        (["descent.yaml", "-i", "slcan"], "--channel"),
        (["descent.yaml", "-c", "vcan0"], "--channel"),
        (["descent.yaml", "-i", "slcan", "-c", "/dev/no-such-port"], "/dev/no-such-port"),
        (["descent.yaml", "-i", "no-such-bus", "-c", "x"], "no-such-bus"),
        (["descent.yaml", "--set", "timing", "--port", "/dev/null"], "timing"),
        (["descent.yaml", "--port", "/dev/null"], "/dev/null"),
        (["descent.yaml", "--set", "timing.rate_hz=0", "--port", "/dev/null"], "timing.rate_hz"),
    ],
)
def test_what_cannot_be_used_is_one_line(
    arguments: list[str], named: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["navigate.py", *arguments])
    with pytest.raises(SystemExit) as end:
        navigate.main()
    assert end.value.code == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    (line,) = printed.err.splitlines()
    assert named in line
