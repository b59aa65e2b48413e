"""What a run imports: a stage that it leaves out is not loaded either."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from lidar_emu.scenario.load import shipped_scenarios

_ROOT = Path(__file__).resolve().parents[2]
WATCHED = {
    *("numba", "scipy", "scipy.stats", "scipy.optimize", "scipy.interpolate", "scipy.integrate"),
    *("rasterio", "trimesh", "embreex", "matplotlib", "pyarrow", "pandas", "distributed"),
    *("can", "serial", "rich", "mcap"),
    *(
        "lidar_emu.trajectory.powered",
        "lidar_emu.trajectory.profile",
        "lidar_emu.receiver.echoes",
        "lidar_emu.receiver.dust",
    ),
    *("lidar_emu.scene", "lidar_emu.scene.procedural", "lidar_emu.scene.mesh", "lidar_emu.scene.objects"),
    *("lidar_emu.beams.flight", "lidar_emu.beams.recorded", "lidar_emu.receiver.beam_measurement"),
    *("lidar_emu.receiver.receiver_faults", "lidar_emu.reference"),
    *("lidar_emu.faults.beams", "lidar_emu.faults.physics", "lidar_emu.plan.flight"),
}
FLIGHT = {
    *("numba", "scipy", "plan.flight", "beams.flight", "trajectory.profile", "scene", "receiver.echoes"),
    "receiver.beam_measurement",
}
OBJECTS = {"scene.mesh", "scene.objects"}
SIMULATED = {
    "bench": set[str](),
    "descent": FLIGHT,
    "dust_storm": FLIGHT,
    "dusty_landing": FLIGHT | {"receiver.dust"},
    "hazard_scan": FLIGHT | OBJECTS | {"scene.procedural"},
    "hazards": FLIGHT | OBJECTS | {"scene.procedural"},
    "homodyne_sign": FLIGHT | {"faults.physics", "receiver.receiver_faults"},
    "nasa_three_beam": FLIGHT,
    "noisy_descent_2025": FLIGHT | {"faults.beams", "faults.physics", "receiver.receiver_faults"},
    "ns13_descent": FLIGHT | {"faults.beams"},
    "obstacles": FLIGHT | OBJECTS,
    "paper_fig2": FLIGHT | OBJECTS | {"scene.procedural"},
    "paper_fig3": FLIGHT,
    "paper_fig4": FLIGHT,
    "paper_fig5": FLIGHT,
    "powered_descent": FLIGHT | {"trajectory.powered"},
    "terrain_step_2023": FLIGHT,
}
RUN = {"bench": set[str](), "descent": FLIGHT}
PLANNED = {"bench": set[str](), "live": FLIGHT}

CODE = """
import json, os, sys
from contextlib import redirect_stdout
from lidar_emu.cli import cli

watched, patterns, base, flights = map(json.loads, sys.argv[1:])

def load(command):
    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere):
        assert not cli(command, standalone_mode=False)
    return sorted(set(watched) & set(sys.modules))

def loaded_by_fork(command):
    "Modules that a command loads in addition to the modules of this process."
    read, write = os.pipe()
    if not os.fork():
        try:
            os.write(write, json.dumps(load(command)).encode())
        finally:
            os._exit(0)
    os.close(write)
    with open(read) as pipe:
        return json.loads(pipe.read() or '["nothing: it failed"]')

print(json.dumps([*map(loaded_by_fork, patterns), load(base), *map(loaded_by_fork, flights)]))
"""


@pytest.mark.slow
def test_a_command_loads_what_its_scenario_needs(tmp_path: Path) -> None:
    """Bench patterns and a plain descent start from the bare command line.

    To load numba and scipy takes seconds, and every flight needs them: the others start from the plain descent.
    """
    short = ["--duration", "0.05"]
    simulate = {name: ["simulate", name, *short, "--out", str(tmp_path / "out.csv")] for name in SIMULATED}
    run = {name: ["run", name, *short, "--pace", "max", "--plain"] for name in RUN}
    plan = {name: ["plan", name, *short] for name in PLANNED}
    patterns = [commands["bench"] for commands in (simulate, run, plan)]
    base = simulate.pop("descent")
    flights = [
        command for commands in (simulate, run, plan) for name, command in commands.items() if name != "bench"
    ]
    done = subprocess.run(
        [sys.executable, "-c", CODE, *map(json.dumps, (sorted(WATCHED), patterns, base, flights))],
        capture_output=True,
        text=True,
        check=True,
    )
    loaded = [{name.removeprefix("lidar_emu.") for name in names} for names in json.loads(done.stdout)]
    tables = {"simulate": SIMULATED, "run": RUN, "plan": PLANNED}
    differences = {
        " ".join(command[:2]): {"more": sorted(found - expected), "less": sorted(expected - found)}
        for command, found in zip([*patterns, base, *flights], loaded, strict=True)
        if found != (expected := tables[command[0]][command[1]])
    }
    assert differences == {}, done.stderr


def test_no_shipped_scenario_is_forgotten() -> None:
    assert {f"{name}.yaml" for name in (*SIMULATED, *PLANNED)} == set(shipped_scenarios())


def test_every_watched_module_exists() -> None:
    own = [name for name in WATCHED if name.startswith("lidar_emu.")]
    assert [name for name in own if find_spec(name) is None] == []


FLY = """
import sys
import lidar_emu.cli, lidar_emu.runtime.run
from lidar_emu.runtime.summary import planned_summary
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model, measure_whole
scenario = load("descent", duration_s=0.05)
model = build_model(scenario)
assert len(measure_whole(model)) == 1
assert planned_summary(scenario, model)["expected_dropout"] > 0
print(*sys.modules)
"""


def test_a_plain_run_with_machine_code_loads_no_large_library() -> None:
    """As from a wheel: kernels that are interpreted need no numba either, which itself loads scipy."""
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-c", FLY]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    loaded = set(done.stdout.split())
    assert "lidar_emu.receiver.beam_measurement" in loaded
    assert loaded.isdisjoint(
        {"numba", "scipy", "pandas", "pyarrow", "matplotlib", "numpy.ma", "numpy.testing"}
    )


HEAVY = (
    *("numba", "numpy", "scipy", "trimesh", "matplotlib", "pydantic"),
    *("can", "serial", "rich", "mcap", "rasterio", "pyarrow"),
)
HELP = """
import sys
from lidar_emu.cli import cli
for command in sys.argv[1:]:
    cli([*command.split(), "--help"], prog_name="lidar-emu", standalone_mode=False)
    print("loaded by", command, sorted(set(%r) & set(sys.modules)))
"""


def test_help_loads_nothing_heavy() -> None:
    from lidar_emu.cli import cli

    commands = ["", *sorted(cli.commands)]
    done = subprocess.run(
        [sys.executable, "-c", HELP % (HEAVY,), *commands], capture_output=True, text=True, check=True
    )
    loaded = [line for line in done.stdout.splitlines() if line.startswith("loaded by")]
    assert loaded == [f"loaded by {command} []" for command in commands]
    assert done.stdout.count("Usage: lidar-emu") == len(commands)


def test_nothing_but_compiled_kernels_is_unpickled() -> None:
    """A pickle runs what it names; that of a kernel is machine code anyway, and is trusted by the owner of its file."""
    unpickles = re.compile(
        r"\b(pickle|cPickle|cloudpickle|dill|shelve|marshal|joblib|read_pickle|allow_pickle=True)\b"
    )
    files = [path for folder in ("emulator", "protocol") for path in (_ROOT / folder).rglob("*.py")]
    assert [path.name for path in files if unpickles.search(path.read_text())] == ["compiler.py"]
