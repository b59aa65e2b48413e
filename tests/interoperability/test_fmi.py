"""The lidar as an FMU: fmpy validates it, and measures with it what is simulated on the same flight."""

from __future__ import annotations

import json
import os
import shutil
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from click.testing import CliRunner
from fmpy.fmi1 import FMICallException, calloc, free
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.validation import validate_fmu
from scipy.spatial.transform import Rotation

from lidar_emu import load, simulate
from lidar_emu.cli import cli, main
from lidar_emu.shots.model import build_model

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("cc") is None, reason="not installed: gcc"),
]
STEP_S, DURATION_S, BEAMS = 0.05, 6.0, 4
HOSTILE = """<a href="x">&amp;'%s %n]]>é"""
COUNTERS = ["packets", "rejected", "shot"]
VALUES = {"range_m": "range_valid", "closing_speed_mps": "speed_valid"}


def written(folder: Path, *options: str) -> Path:
    """An FMU of the descent."""
    path = folder / "lidar.fmu"
    done = CliRunner().invoke(cli, ["fmu", "descent", "--out", str(path), *options])
    assert done.exit_code == 0, done.output
    return path


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(
        tmp_path_factory.mktemp("fm%20u é"),
        "--set",
        "level=geometric",
        "--set",
        f"name={json.dumps(HOSTILE)}",
    )


def flight() -> np.ndarray[Any, Any]:
    """The state of the shipped descent at every step, as inputs of the FMU."""
    flown = build_model(load("descent")).flight
    assert flown is not None
    time_s = np.arange(round(DURATION_S / STEP_S) + 1) * STEP_S
    state = flown.trajectory.state(time_s)
    motion = {
        "position_site_m": state.position_site_m,
        "velocity_site_mps": state.velocity_site_mps,
        "acceleration_site_mps2": state.acceleration_site_mps2,
        "site_from_body": np.roll(Rotation.from_matrix(state.site_from_body).as_quat(), 1, axis=1),
        "body_rate_radps": state.body_rate_radps,
    }
    columns = {"time": time_s} | {
        f"{name}[{axis + 1}]": values[:, axis]
        for name, values in motion.items()
        for axis in range(values.shape[1])
    }
    inputs = np.zeros(len(time_s), dtype=[(name, float) for name in columns])
    for name, values in columns.items():
        inputs[name] = values
    return inputs


@pytest.mark.parametrize("level", ["geometric", "statistical", "spectral"])
def test_fmpy_measures_what_is_simulated(tmp_path: Path, level: str) -> None:
    beams = [f"[{beam}]" for beam in range(1, BEAMS + 1)]
    flown = fmpy.simulate_fmu(
        str(written(tmp_path, "--set", f"level={level}")),
        stop_time=DURATION_S,
        step_size=STEP_S,
        output_interval=STEP_S,
        start_values={"acceleration_known": True},
        input=flight(),
        output=[*COUNTERS, *(name + beam for pair in VALUES.items() for name in pair for beam in beams)],
    )
    rows = flown[flown["packets"] > 0]
    shots = round(DURATION_S / STEP_S) - 1  # those sent until the begin of the last step
    assert rows["shot"].tolist() == list(range(shots))
    assert rows["packets"].tolist() == list(range(1, shots + 1))
    assert not rows["rejected"].any()
    expected = simulate("descent", duration_s=DURATION_S, level=level)
    for (name, validity), tolerance in zip(VALUES.items(), (0.51e-3, 0.51e-4), strict=True):
        wanted = getattr(expected, name)[:shots]
        valid = np.stack([rows[validity + beam] for beam in beams], axis=1)
        np.testing.assert_array_equal(valid, np.isfinite(wanted))
        measured = np.stack([rows[name + beam] for beam in beams], axis=1)
        np.testing.assert_allclose(measured, np.nan_to_num(wanted), rtol=0, atol=tolerance)


def test_the_validator_is_silent_whatever_the_name(unit: Path) -> None:
    assert validate_fmu(str(unit)) == []
    assert fmpy.read_model_description(str(unit)).modelName == HOSTILE


class Unit:
    """An instance, and the lines of its log."""

    def __init__(self, path: Path, folder: str) -> None:
        description = fmpy.read_model_description(str(path))
        self.numbers = {each.name: each.valueReference for each in description.modelVariables}
        self.lines: list[str] = []
        self.slave = FMU2Slave(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="lidar",
        )
        self._callbacks = fmi2CallbackFunctions(
            fmi2CallbackLoggerTYPE(lambda *line: self.lines.append(line[-1].decode())),
            fmi2CallbackAllocateMemoryTYPE(calloc),
            fmi2CallbackFreeMemoryTYPE(free),
        )
        self.slave.instantiate(callbacks=self._callbacks)

    def begin(self) -> None:
        self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def set(self, name: str, value: float) -> None:
        self.slave.setReal([self.numbers[name]], [value])

    def fly(self, steps: int, first: int = 0) -> list[float]:
        """Range of beam 1 after each step, from the inputs' start values."""
        found = []
        for step in range(first, steps):
            self.slave.doStep(step * STEP_S, STEP_S)
            found += self.slave.getReal([self.numbers["range_m[1]"]])
        return found


@contextmanager
def instances(path: Path, count: int) -> Iterator[list[Unit]]:
    folder = fmpy.extract(str(path), unzipdir=str(path.parent / "unzipped %41 é"))
    units = [Unit(path, folder) for _ in range(count)]
    try:
        yield units
    finally:
        for unit in units:
            unit.slave.freeInstance()


def workers() -> list[int]:
    """The children of this process that are an FMU's."""
    files = Path("/proc/self/task").glob("*/children")
    found = [int(child) for file in files for child in file.read_text().split()]
    return [
        child for child in found if b"lidar_emu.fmu.worker" in Path(f"/proc/{child}/cmdline").read_bytes()
    ]


def test_instances_are_independent_and_begin_again(unit: Path) -> None:
    with instances(unit, 2) as (one, other):
        one.begin()
        other.begin()
        assert len(workers()) == 2
        other.set("position_site_m[3]", 500.0)
        high, low = one.fly(4), other.fly(4)
        assert high[2] == pytest.approx(1000 / np.cos(np.radians(22.5)), abs=50)  # of the ground's relief
        assert low[2] == pytest.approx(500 / np.cos(np.radians(22.5)), abs=50)
        one.slave.terminate()
        assert len(workers()) == 1
        one.slave.reset()
        one.begin()
        assert one.fly(4) == high
    assert workers() == []


@pytest.mark.parametrize(
    ("name", "value", "line"),
    [
        ("velocity_site_mps[2]", np.nan, "inputs: velocity_site_mps[2] is nan; allowed: finite numbers"),
        ("position_site_m[1]", -np.inf, "inputs: position_site_m[1] is -inf; allowed: finite numbers"),
        ("site_from_body[1]", 3.0, "bad attitude; allowed: a unit quaternion w, x, y, z"),
    ],
)
def test_unusable_inputs_are_an_error_and_a_line(unit: Path, name: str, value: float, line: str) -> None:
    with instances(unit, 1) as (one,):
        one.begin()
        good = one.fly(3)
        one.set(name, value)
        with pytest.raises(FMICallException):
            one.slave.doStep(3 * STEP_S, STEP_S)
        (logged,) = one.lines
        assert line in logged
        one.slave.reset()
        one.begin()
        assert one.fly(3) == good


@pytest.mark.parametrize("step", [0.0, -1.0, np.nan])
def test_a_step_goes_forward(unit: Path, step: float) -> None:
    with instances(unit, 1) as (one,):
        one.begin()
        with pytest.raises(FMICallException):
            one.slave.doStep(0.0, step)
        assert one.lines == ["the communication step is not above 0"]


def test_a_process_that_dies_is_an_error_and_a_line(unit: Path) -> None:
    with instances(unit, 1) as (one,):
        one.begin()
        good = one.fly(3)
        (worker,) = workers()
        os.kill(worker, signal.SIGKILL)
        for _ in range(2):
            with pytest.raises(FMICallException):
                one.slave.doStep(3 * STEP_S, STEP_S)
        first, second = one.lines
        assert first == "the lidar's process has ended"
        assert second.endswith("reset and initialise")
        one.slave.reset()
        one.begin()
        assert one.fly(3) == good


def test_a_process_that_cannot_begin_says_why(unit: Path, tmp_path: Path) -> None:
    folder = Path(fmpy.extract(str(unit), unzipdir=str(tmp_path / "unzipped")))
    (folder / "resources" / "scenario.json").write_text("{}")
    one = Unit(unit, str(folder))
    with pytest.raises(FMICallException):
        one.begin()
    assert len(one.lines) == 1
    (folder / "resources" / "python").write_text("/nowhere/python%s")
    one.slave.reset()
    with pytest.raises(FMICallException):
        one.begin()
    assert one.lines[1].replace("%%", "%") == "/nowhere/python%s: No such file or directory"
    one.slave.freeInstance()


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["descent", "--out", "a.txt"], "a.txt: '.txt' is not usable; allowed: .fmu"),
        (["bench", "--out", "a.fmu"], "bench: a bench pattern; allowed: a flight"),
        (
            ["descent", "--out", "none/a.fmu"],
            "--out: 'none/a.fmu' is not usable; allowed: a file in a folder",
        ),
        (["descent", "--out", "a.fmu"], "fmu: no C compiler; allowed: Linux, with cc"),
    ],
)
def test_what_cannot_be_written_is_one_line(
    arguments: list[str],
    line: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("sys.argv", ["lidar-emu", "fmu", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert line in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
