"""A wheel with machine code starts without a compiler, and measures bit for bit what compiled kernels measure."""

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
    for level in ({}, *({"level": each} for each in levels)):
        try:
            measured = simulate(load(name, {"duration_s": 0.3, **level}))
        except InputError as refusal:  # a fault that this level does not have
            print(refusal)
            continue
        content = b"".join(getattr(measured, field.name).tobytes() for field in fields(measured))
        print(name, *level.values(), sha256(content).hexdigest())
print("numba" in sys.modules)
"""


@pytest.fixture(scope="module")
def scripts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scripts of an environment with such a wheel."""
    folder = tmp_path_factory.mktemp("prebuilt")
    kernels = folder / "kernels"
    done(sys.executable, TREE / "tools" / "build_kernels.py", kernels, folder=folder, limit_s=BUILD_LIMIT_S)
    wheel = built_wheel(folder, LIDAR_EMU_KERNELS=str(kernels))
    assert wheel.name.endswith("linux_x86_64.whl")
    return install(wheel, folder / "environment")


def test_it_measures_what_compiled_kernels_measure(scripts: Path, tmp_path: Path) -> None:
    prebuilt = done(scripts / "python", "-c", FLY_ALL, folder=tmp_path, HOME=str(tmp_path)).splitlines()
    compiled = done(sys.executable, "-c", FLY_ALL, folder=tmp_path, limit_s=BUILD_LIMIT_S).splitlines()
    assert len(prebuilt) > 40
    assert prebuilt[:-1] == compiled[:-1]
    assert (prebuilt[-1], compiled[-1]) == ("False", "True"), "whether numba was loaded"


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


def test_a_kernel_that_was_changed_is_compiled(scripts: Path, tmp_path: Path) -> None:
    """A user's change of an installed file acts, as it does without machine code."""
    code = """
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
    printed = done(scripts / "python", "-c", code, folder=tmp_path, HOME=str(tmp_path))
    assert printed.splitlines() == ["False", "True"]
