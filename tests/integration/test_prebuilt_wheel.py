"""A wheel with machine code needs no compiler and no numba, and measures bit for bit what compiled kernels measure."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from wheels import CAN_BUILD, TREE, built_wheel, done, install

from lidar_emu.numerics.lazy_kernel import _NEEDED, _processor_flags

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not CAN_BUILD, reason="needs compilers of C and C++, and the headers of Python"),
    pytest.mark.skipif(not _processor_flags() >= _NEEDED, reason="needs a processor of x86-64-v3"),
]
BUILD_LIMIT_S = 1500.0

FLY_ALL = """
import sys
from dataclasses import fields
from hashlib import sha256
from lidar_emu import InputError, load, shipped_scenarios, simulate

for name in sorted(shipped_scenarios()):
    if name == "live.yaml":
        continue
    levels = [] if name.startswith("bench") else ["geometric", "spectral"]
    changes = [{}, *({"level": each} for each in levels)]
    if name == "descent.yaml":
        changes += [{"site": "sphere"}, {"level": "reference", "duration_s": 0.05}]
    for level in changes:
        try:
            measured = simulate(load(name, {"duration_s": 0.3} | level))
        except InputError as refusal:  # a fault that this level does not have
            print(refusal)
            continue
        content = b"".join(getattr(measured, field.name).tobytes() for field in fields(measured))
        print(name, level, sha256(content).hexdigest())
print("numba" in sys.modules)
"""


FROM_PYTHON = """
import lidar_emu

assert lidar_emu.shot_spectra("descent", 5, level="reference", duration_s=0.5)
lidar_emu.simulate("descent", duration_s=0.1, detector=lambda spectrum: [])
device = lidar_emu.EmbeddedDevice("live", site="flat")
device.set_truth(0, (0, 0, 500), (0, 0, -20), (0, 2**-0.5, 2**-0.5, 0))
device.set_truth(100_000_000, (0, 0, 498), (0, 0, -20), (0, 2**-0.5, 2**-0.5, 0))
assert device.advance(100_000_000)
"""
COMMANDS = [
    "run descent.yaml --pace max --duration 2 --record flight.mcap",
    "report flight.mcap --html flight.html",
    "replay flight.mcap --recompute",
    "simulate descent.yaml --exact --duration 1 --out exact.csv",
    "campaign dispersed_descent.yaml --runs 2 --out results",
    "plan descent.yaml",
    "detection descent.yaml",
    "ground descent.yaml",
]
CHANGED = """
import sys
import numpy as np
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vector_arrays import set_from_rotation_vector as built

changed = kernel(fastmath=True)(built.py_func)
matrices = np.empty((2, 3, 3))
for function, matrix in zip((built, changed), matrices, strict=True):
    function(0.0, 0.0, 0.1, matrix)
    print("numba" in sys.modules)
assert np.allclose(*matrices, rtol=0, atol=1e-15)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("prebuilt")
    kernels = folder / "kernels"
    done(sys.executable, TREE / "tools" / "build_kernels.py", kernels, folder=folder, limit_s=BUILD_LIMIT_S)
    built = built_wheel(folder, LIDAR_EMU_KERNELS=str(kernels))
    assert built.name.endswith("linux_x86_64.whl")
    return built


@pytest.fixture(scope="module")
def scripts(wheel: Path) -> Path:
    """Scripts of an environment with such a wheel, and without numba."""
    return install(wheel, wheel.parent / "environment", without=("numba", "llvmlite"))


def test_it_measures_what_compiled_kernels_measure(scripts: Path, tmp_path: Path) -> None:
    prebuilt = done(scripts / "python", "-c", FLY_ALL, folder=tmp_path, HOME=str(tmp_path)).splitlines()
    compiled = done(sys.executable, "-c", FLY_ALL, folder=tmp_path, limit_s=BUILD_LIMIT_S).splitlines()
    assert len(prebuilt) > 40
    assert prebuilt[:-1] == compiled[:-1]
    assert (prebuilt[-1], compiled[-1]) == ("False", "True"), "whether numba was loaded"


def test_commands_and_python_need_no_numba(scripts: Path, tmp_path: Path) -> None:
    for command in COMMANDS:
        done(scripts / "lidar-emu", *command.split(), folder=tmp_path, HOME=str(tmp_path))
    done(scripts / "python", "-c", FROM_PYTHON, folder=tmp_path, HOME=str(tmp_path))


def test_it_starts_without_compiler_and_cache(scripts: Path, tmp_path: Path) -> None:
    """In a container: no tool on the path, a home that is empty and stays so."""
    home = tmp_path / "home"
    home.mkdir()
    run = subprocess.run(
        [scripts / "lidar-emu", "run", "descent.yaml", "--pace", "max", "--duration", "1"],
        env={"HOME": str(home), "PATH": str(scripts)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert "20 sent" in run.stdout
    assert run.stderr == ""
    assert list(home.iterdir()) == []


def test_a_changed_kernel_is_compiled(wheel: Path, tmp_path: Path) -> None:
    """A user's change of an installed file acts, as it does without machine code."""
    scripts = install(wheel, tmp_path / "with_numba")
    printed = done(scripts / "python", "-c", CHANGED, folder=tmp_path, HOME=str(tmp_path))
    assert printed.splitlines() == ["False", "True"]


def test_without_numba_a_changed_kernel_names_the_extra(scripts: Path, wheel: Path, tmp_path: Path) -> None:
    refused = subprocess.run(
        [scripts / "python", "-c", CHANGED], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    line = refused.stderr.splitlines()[-1]
    assert "InputError: numerics.vectors.set_from_rotation_vector: " in line
    command = line.partition("; run: ")[2]
    assert command.endswith(f"pip install '{wheel}[compiler]'")
    # Typed as printed, pip takes it, and finds nothing missing but the compiler.
    typed = ["bash", "-c", f"{command} --dry-run --no-index --find-links /nowhere"]
    answer = subprocess.run(typed, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "No matching distribution found for numba" in answer.stderr
