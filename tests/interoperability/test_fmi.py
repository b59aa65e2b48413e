"""The lidar as an FMU of both versions: fmpy validates it, and measures with it what is simulated on one flight."""

from __future__ import annotations

import ctypes
import json
import os
import select
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zipfile import ZipFile

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
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from lxml import etree
from scipy.spatial.transform import Rotation

from lidar_emu import load, simulate
from lidar_emu.cli import cli, main
from lidar_emu.embedded_device import EmbeddedDevice
from lidar_emu.shots.model import build_model
from lidar_emu.wire import interface_named
from lidar_protocol import Message, SerialReceiver

pytestmark = [pytest.mark.slow, pytest.mark.skipif(shutil.which("cc") is None, reason="not installed: gcc")]
STEP_S, DURATION_S, BEAMS = 0.05, 6.0, 4
HOSTILE = """<a href="x">&amp;'%s %n]]>é"""
COUNTERS = ["packets", "rejected", "shot"]
VALUES = {"range_m": "range_valid", "closing_speed_mps": "speed_valid"}
Table = np.ndarray[Any, Any]


def written(folder: Path, *options: str) -> Path:
    """An FMU of the descent."""
    path = folder / "lidar.fmu"
    done = CliRunner().invoke(cli, ["fmu", "descent", "--out", str(path), *options])
    assert done.exit_code == 0, done.output
    return path


def hostile(folder: Path, version: str) -> Path:
    """An FMU with an unusual name."""
    name = f"name={json.dumps(HOSTILE)}"
    return written(folder, "--fmi-version", version, "--set", "level=geometric", "--set", name)


@pytest.fixture(scope="module", params=["2", "3"])
def unit(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hostile(tmp_path_factory.mktemp("fm%20u é"), request.param)


@pytest.fixture(scope="module")
def unit3(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hostile(tmp_path_factory.mktemp("fmi3"), "3")


def flight() -> dict[str, Table]:
    """The state of the shipped descent at every step, and its time."""
    flown = build_model(load("descent")).flight
    assert flown is not None
    time_s = np.arange(round(DURATION_S / STEP_S) + 1) * STEP_S
    state = flown.trajectory.state(time_s)
    return {
        "time": time_s,
        "position_site_m": state.position_site_m,
        "velocity_site_mps": state.velocity_site_mps,
        "acceleration_site_mps2": state.acceleration_site_mps2,
        "site_from_body": np.roll(Rotation.from_matrix(state.site_from_body).as_quat(), 1, axis=1),
        "body_rate_radps": state.body_rate_radps,
    }


def scalars(columns: dict[str, Table]) -> dict[str, Table]:
    """Columns of FMI 2, which has no arrays."""
    return {
        name if values.ndim == 1 else f"{name}[{number}]": column
        for name, values in columns.items()
        for number, column in enumerate(values.reshape(len(values), -1).T, 1)
    }


def flown(unit: Path, version: str) -> dict[str, Table]:
    """What fmpy records of the descent."""
    given = flight()
    beams = [f"[{beam}]" for beam in range(1, BEAMS + 1)] if version == "2" else [""]
    if version == "2":
        given = scalars(given)
    else:  # fmpy's table of inputs takes arrays of one length; the descent has the attitude's start value
        del given["site_from_body"]
    inputs = np.zeros(
        len(given["time"]), dtype=[(name, float, each.shape[1:]) for name, each in given.items()]
    )
    for name, values in given.items():
        inputs[name] = values
    rows = fmpy.simulate_fmu(
        str(unit),
        stop_time=DURATION_S,
        step_size=STEP_S,
        output_interval=STEP_S,
        start_values={"acceleration_known": True},
        input=inputs,
        output=[*COUNTERS, *(name + beam for pair in VALUES.items() for name in pair for beam in beams)],
    )
    rows = rows[rows["packets"] > 0]
    arrays = [name for pair in VALUES.items() for name in pair]
    return {name: rows[name] for name in COUNTERS} | {
        name: np.column_stack([rows[name + beam] for beam in beams]) for name in arrays
    }


@pytest.mark.parametrize(
    ("version", "level"), [("2", "geometric"), ("2", "spectral"), ("3", "geometric"), ("3", "spectral")]
)
def test_fmpy_measures_what_is_simulated(tmp_path: Path, version: str, level: str) -> None:
    measured = flown(written(tmp_path, "--fmi-version", version, "--set", f"level={level}"), version)
    shots = round(DURATION_S / STEP_S) - 1  # those sent until the beginning of the last step
    assert measured["shot"].tolist() == list(range(shots))
    assert measured["packets"].tolist() == list(range(1, shots + 1))
    assert not measured["rejected"].any()
    expected = simulate("descent", duration_s=DURATION_S, level=level)
    for (name, validity), tolerance in zip(VALUES.items(), (0.51e-3, 0.51e-4), strict=True):
        wanted = getattr(expected, name)[:shots]
        np.testing.assert_array_equal(measured[validity], np.isfinite(wanted))
        np.testing.assert_allclose(measured[name], np.nan_to_num(wanted), rtol=0, atol=tolerance)


@pytest.mark.parametrize("step_s", [0.02, STEP_S, 0.13])
def test_bytes_are_those_of_the_device(unit3: Path, step_s: float) -> None:
    given = flight()
    device = EmbeddedDevice(
        "descent", {"level": "geometric", "trajectory": {"kind": "live", "listen": "udp:127.0.0.1:5600"}}
    )
    receiver = SerialReceiver(interface_named("default", "scenario", "wire.interface"))
    packets, most = 0, 0
    with instances(unit3, 1) as (one,):
        one.begin()
        for step in range(20):
            time_s = step * step_s
            state = {
                name: [float(np.interp(time_s, given["time"], axis)) for axis in given[name].T]
                for name in given
                if name != "time" and name != "acceleration_site_mps2"
            }
            for name, values in state.items():
                one.set(name, values)
            one.slave.doStep(time_s, step_s)
            device.set_truth(round(time_s * 1e9), **state)  # type: ignore[arg-type]
            due = device.advance(round(time_s * 1e9))
            (sent,) = one.get("serial_bytes")
            assert sent == b"".join(packet.payload for packet in due)
            messages = [each for each in receiver.receive(sent) if isinstance(each, Message)]
            packets, most = packets + len(messages), max(most, len(messages))
            assert one.get("packets") == [packets]
            assert one.get("time") == [time_s + step_s]
            if messages:
                newest = messages[-1]
                assert one.get("shot") == [newest.shot]
                assert one.get("range_valid") == [row["range_valid"] for row in newest.beams]
                assert one.get("range_m") == [row["range_m"] or 0.0 for row in newest.beams]
                assert one.get("closing_speed_mps") == [
                    row["closing_speed_mps"] or 0.0 for row in newest.beams
                ]
    assert most == int(np.ceil(step_s / STEP_S))
    assert packets > 5


def test_the_validator_is_silent_whatever_the_name(unit: Path) -> None:
    assert validate_fmu(str(unit)) == []
    assert fmpy.read_model_description(str(unit)).modelName == HOSTILE


def test_sources_are_described_by_the_standards_schema(unit3: Path) -> None:
    schema = Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3BuildDescription.xsd"
    with ZipFile(unit3) as archive:
        described = etree.fromstring(archive.read("sources/buildDescription.xml"))
        listed = {f"sources/{file.get('name')}" for file in described.iter("SourceFile")}
        assert listed == {name for name in archive.namelist() if name.endswith(".c")}
    etree.XMLSchema(file=str(schema)).assertValid(described)


class Unit:
    """An instance, and the lines of its log."""

    def __init__(self, path: Path, folder: str) -> None:
        description = fmpy.read_model_description(str(path))
        self._is_fmi3 = description.fmiVersion == "3.0"
        self.variables = description.modelVariables
        self.lines: list[str] = []
        self.slave = (FMU3Slave if self._is_fmi3 else FMU2Slave)(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="lidar",
        )
        if self._is_fmi3:
            self.slave.instantiate(logMessage=self._log)
        else:
            self._callbacks = fmi2CallbackFunctions(
                fmi2CallbackLoggerTYPE(self._log),
                fmi2CallbackAllocateMemoryTYPE(calloc),
                fmi2CallbackFreeMemoryTYPE(free),
            )
            self.slave.instantiate(callbacks=self._callbacks)

    def _log(self, *arguments: Any) -> None:
        self.lines.append(arguments[-1].decode())

    def begin(self) -> None:
        if self._is_fmi3:
            self.slave.enterInitializationMode(startTime=0.0)
        else:
            self.slave.setupExperiment(startTime=0.0)
            self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def find(self, name: str) -> tuple[str, list[int]]:
        """Type and value references of a variable, or of the elements of an array."""
        found = [each for each in self.variables if each.name.partition("[")[0] == name]
        return found[0].type, [each.valueReference for each in found]

    def set(self, name: str, values: Sequence[float]) -> None:
        kind, numbers = self.find(name)
        getattr(self.slave, f"set{kind}")(numbers, values)

    def get(self, name: str) -> list[Any]:
        kind, numbers = self.find(name)
        (shape,) = {each.shape for each in self.variables if each.valueReference in numbers}
        count = {"nValues": int(np.prod(shape))} if self._is_fmi3 else {}
        return list(getattr(self.slave, f"get{kind}")(numbers, **count))

    def fly(self, steps: int) -> list[float]:
        """Range of beam 1 after each step, from the inputs' start values."""
        found = []
        for step in range(steps):
            self.slave.doStep(step * STEP_S, STEP_S)
            found.append(self.get("range_m")[0])
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
        other.set("position_site_m", [0.0, 0.0, 500.0])
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
    ("name", "values", "line"),
    [
        ("velocity_site_mps", [0.0, np.nan, 0.0], "inputs: velocity_site_mps[2] is nan; pass finite numbers"),
        ("position_site_m", [-np.inf, 0.0, 9.0], "inputs: position_site_m[1] is -inf; pass finite numbers"),
        ("site_from_body", [3.0, 0.0, 0.0, 0.0], "bad attitude; pass a unit quaternion w, x, y, z"),
        ("site_from_body", [0.0, 0.0, 0.0, 0.0], "bad attitude; pass a unit quaternion w, x, y, z"),
    ],
)
def test_unusable_inputs_are_an_error_and_a_line(
    unit: Path, name: str, values: list[float], line: str
) -> None:
    with instances(unit, 1) as (one,):
        one.begin()
        good = one.fly(3)
        one.set(name, values)
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


@pytest.mark.parametrize(
    ("time_s", "line"),
    [
        (1e300, "inputs: the time is 1e+300; pass finite numbers"),
        (1e9, "set_truth: time_ns: implausible time; pass a time from 0 on, at most 10 s after"),
        (0.0, "set_truth: time_ns: duplicate; pass a time after the last truth"),
    ],
)
def test_a_time_that_cannot_be_is_an_error_and_a_line(unit: Path, time_s: float, line: str) -> None:
    with instances(unit, 1) as (one,):
        one.begin()
        one.slave.doStep(0.0, STEP_S)
        with pytest.raises(FMICallException):
            one.slave.doStep(time_s, STEP_S)
        (logged,) = one.lines
        assert logged.startswith(line)
        one.slave.doStep(STEP_S, STEP_S)  # the device goes on
        assert one.get("packets") == [1]


def test_unknown_and_measured_variables_cannot_be_set(unit: Path) -> None:
    with instances(unit, 1) as (one,):
        kind, (*_, number) = one.find("velocity_site_mps")
        measured = one.find("range_m")[1][0]
        for call, numbers, line in [
            (
                f"set{kind}",
                [number, 4_000_000],
                "value reference 4000000: there is no such variable of this type",
            ),
            (f"get{kind}", [4_000_000], "value reference 4000000: there is no such variable of this type"),
            ("setBoolean", [number], f"value reference {number}: there is no such variable of this type"),
            (f"set{kind}", [measured], f"value reference {measured}: only inputs and parameters can be set"),
        ]:
            one.lines.clear()
            values = [] if call.startswith("get") else [[1] * len(numbers)]
            with pytest.raises(FMICallException):
                getattr(one.slave, call)(numbers, *values)
            assert one.lines == [line]
        assert one.get("velocity_site_mps") == [0.0, 0.0, 0.0]
        assert one.get("range_m") == [0.0] * BEAMS


def test_arrays_have_their_size(unit3: Path) -> None:
    with instances(unit3, 1) as (one,):
        position, velocity = (one.find(name)[1][0] for name in ("position_site_m", "velocity_site_mps"))
        for count in (0, 1, 5, 7, 1000):
            one.lines.clear()
            with pytest.raises(FMICallException):
                one.slave.setFloat64([position, velocity], [7.0] * count)
            with pytest.raises(FMICallException):
                one.slave.getFloat64([position, velocity], nValues=count)
            assert one.lines == [f"{count} values for variables that have 6"] * 2
        assert one.get("position_site_m") == [0.0, 0.0, 1000.0]
        with pytest.raises(FMICallException):  # an element of an array is no variable
            one.slave.getFloat64([position + 1])
        one.slave.setFloat64([velocity, position], [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
        assert one.get("position_site_m") == [4.0, 5.0, 6.0]
        assert one.slave.getFloat64([velocity, position], nValues=6) == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
        with pytest.raises(FMICallException):
            one.slave.setBinary(one.find("serial_bytes")[1], [b"x"])
        assert "only inputs and parameters can be set" in one.lines[-1]


def test_what_is_not_offered_is_declared_and_an_error(unit3: Path) -> None:
    offered = fmpy.read_model_description(str(unit3)).coSimulation
    assert offered.needsExecutionTool
    assert offered.canHandleVariableCommunicationStepSize
    assert not any(
        [
            offered.hasEventMode,
            offered.canGetAndSetFMUstate,
            offered.canSerializeFMUstate,
            offered.providesIntermediateUpdate,
            offered.mightReturnEarlyFromDoStep,
            offered.providesDirectionalDerivative,
            offered.providesAdjointDerivatives,
            offered.maxOutputDerivativeOrder,
        ]
    )
    with instances(unit3, 1) as (one,):
        one.begin()
        calls = {
            "fmi3EnterEventMode": one.slave.enterEventMode,
            "fmi3EnterStepMode": one.slave.enterStepMode,
            "fmi3GetFMUState": one.slave.getFMUState,
            "fmi3UpdateDiscreteStates": one.slave.updateDiscreteStates,
            "fmi3EnterConfigurationMode": one.slave.enterConfigurationMode,
            "fmi3GetOutputDerivatives": lambda: one.slave.getOutputDerivatives([0], [1]),
        }
        for name, call in calls.items():
            with pytest.raises(FMICallException):
                call()
            assert one.lines[-1] == f"the FMU does not offer {name}"
        with pytest.raises(FMICallException):
            one.slave.getClock([0])
        assert one.fly(3)[2] > 0  # none of them has an effect
        with pytest.raises(Exception, match="Failed to instantiate"):
            one.slave.instantiate(eventModeUsed=True, logMessage=one._log)
        assert one.lines[-1] == "the FMU has no event mode"


def test_the_library_exports_the_standards_functions_alone(unit3: Path, tmp_path: Path) -> None:
    """So that two FMUs in one simulator share no symbol, however it loads them."""
    library = next((Path(fmpy.extract(str(unit3), unzipdir=str(tmp_path))) / "binaries").glob("*/*.so"))
    loaded = ctypes.CDLL(str(library))
    assert hasattr(loaded, "fmi3DoStep")
    assert not hasattr(loaded, "lidar_step")
    assert not hasattr(loaded, "lidar_places")


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


SIMULATOR = """
import sys
sys.path.insert(0, sys.argv[1])
from pathlib import Path
from test_fmi import instances, workers
with instances(Path(sys.argv[2]), 2) as units:
    for each in units:
        each.begin()
    print(*workers(), flush=True)
    sys.stdin.read()
"""


def test_processes_end_with_a_simulator_that_is_killed(unit: Path) -> None:
    arguments = [sys.executable, "-c", SIMULATOR, str(Path(__file__).parent), str(unit)]
    with subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as simulator:
        assert simulator.stdout is not None
        processes = [os.pidfd_open(int(worker)) for worker in simulator.stdout.readline().split()]
        simulator.kill()
    assert len(processes) == 2
    for process in processes:
        assert select.select([process], [], [], 60)[0]
        os.close(process)


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


def test_without_a_compiler_there_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("sys.argv", ["lidar-emu", "fmu", "descent", "--out", "a.fmu"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "fmu: no C compiler; use Linux, with cc" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
