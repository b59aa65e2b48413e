"""What `lidar-emu bench realtime` refuses, under the names of its own options; nothing is flown."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from lidar_emu.cli import cli
from lidar_emu.errors import InputError


@pytest.mark.parametrize(
    ("option", "value", "allowed"),
    [
        ("--rate", "5000", "at most 1111.11"),
        ("--rate", "fast", "a number above 0"),
        ("--rate", "nan", "a number above 0"),
        ("--duration", "0", "a number above 0"),
        ("--duration", "1e9", "less than or equal to 10000000"),
        ("--beamlets", "64", "1, 7, 19, 37, 61"),
        ("--beamlets", "1e3", "a whole number"),
        ("--plot", "lateness.txt", ".png"),
    ],
)
def test_a_refusal_names_the_option_the_value_and_what_is_allowed(option, value, allowed):
    done = CliRunner().invoke(cli, ["bench", "realtime", option, value], standalone_mode=False)
    assert isinstance(done.exception, InputError)
    line = str(done.exception)
    assert line.startswith(value if option == "--plot" else option)
    assert allowed in line
