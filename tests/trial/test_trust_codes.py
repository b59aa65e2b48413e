"""Codes of trust: those of the interface in use, by the names of its enumeration."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from lidar_emu.cli import cli
from lidar_emu.errors import InputError
from lidar_emu.trial.solutions import Trust, trust_of_codes
from lidar_protocol import default_interface, load
from lidar_protocol.definition_file import files

NAVIGATOR = Path(__file__).resolve().parents[1] / "support" / "navigator.py"
DEFAULT = (files("lidar_protocol") / "default.toml").read_text(encoding="utf-8")
OTHER_CODES = {"not_judged": 4, "used": 3, "invalid": 6, "gated": 1, "inconsistent": 0, "excluded": 5}
PACK = """
name: other codes
requirements:
  - {id: DISTRUST, text: A wrong beam is distrusted., solution: distrust_s, at_most: 0.5}
  - {id: DECEIVED, text: Few wrong values are used., flight: deceived_share, at_most: 0.1}
  - {id: RIGHT, text: Right values are used., flight: false_distrust_share, at_most: 0.1}
cases:
  - id: biased
    question: Is the beam distrusted?
    scenario: descent.yaml
    set:
      wire.interface: FOLDER/other.toml
      site: flat
      duration_s: 4
      trajectory.waypoints: [{altitude_m: 400, speed_mps: 30}, {altitude_m: 100, speed_mps: 20}]
      faults: [{kind: bias, beams: [1], range_m: 60, closing_speed_mps: 8, from_s: 2, to_s: 3}]
"""


def definition(codes: dict[str, int]) -> str:
    """The default interface with other codes of trust."""
    head, _, rest = DEFAULT.partition("[enumerations.trust]\n")
    words = "".join(f"{name} = {code}\n" for name, code in codes.items())
    return f"{head}[enumerations.trust]\n{words}\n{rest[rest.index('[') :]}"


def test_the_default_interface_has_the_codes_of_trust() -> None:
    codes = {name.lower(): int(trust) for name, trust in Trust.__members__.items()}
    assert default_interface().enumerations["trust"] == codes
    by_field = trust_of_codes(default_interface(), "default")
    assert by_field == {key: {int(one): one for one in Trust} for key in ("range_trust", "speed_trust")}


def test_codes_are_those_of_their_names() -> None:
    found = trust_of_codes(load(definition(OTHER_CODES), "other.toml"), "other.toml")
    assert found["speed_trust"] == {
        4: Trust.NOT_JUDGED, 3: Trust.USED, 6: Trust.INVALID, 1: Trust.GATED, 0: Trust.INCONSISTENT, 5: Trust.EXCLUDED
    }  # fmt: skip


@pytest.mark.parametrize(
    ("changed", "reported"),
    [
        (definition({"used": 1, "rejected": 2}), "values of range_trust are used, rejected; must be"),
        (definition({"gated": 1}), "values of range_trust are gated"),
        (DEFAULT.replace(', values = "trust"', ""), "values of range_trust are numbers without names"),
    ],
)
def test_names_that_are_missing_are_one_line_before_any_flight(
    changed: str, reported: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pack.yaml").write_text(PACK.replace("FOLDER", str(tmp_path)))
    (tmp_path / "other.toml").write_text(changed)
    done = CliRunner().invoke(cli, ["trial", str(tmp_path), "--port", "pty", "--out", "out"])
    assert isinstance(done.exception, InputError)
    assert f"other.toml: host_messages.navigation: {reported}" in str(done.exception)
    assert "\n" not in str(done.exception)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_trial_in_other_codes_is_graded_by_their_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pack.yaml").write_text(PACK.replace("FOLDER", str(tmp_path)))
    (tmp_path / "other.toml").write_text(definition(OTHER_CODES))
    host = f"{shlex.join([sys.executable, str(NAVIGATOR)])} {{scenario}} {{port}}"
    CliRunner().invoke(cli, ["trial", str(tmp_path), "--port", "pty", "--baud", "921600", "--pace", "max",
                             "--host", host, "--out", "out"])  # fmt: skip
    (case,) = json.loads((tmp_path / "out" / "trial.json").read_text())["cases"]
    assert case["passes"], case
    (flight,) = case["flights"]
    assert np.isfinite(flight["figures"]["deceived_share"])
