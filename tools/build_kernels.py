"""Build machine code of the kernels that shipped scenarios call, for a wheel that neither compiles nor loads numba.

    make wheel

Every shipped scenario is flown at the levels that flights use; for the types of arguments that come up, numba compiles
the kernels for processors of the level x86-64-v3, into one extension module beside a table of what it holds. A second
module, in C, chooses among them by the types of arguments. It takes some minutes and a C compiler.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numba import typeof
from numba.core import config
from numba.core.types import Type

from lidar_emu.numerics.lazy_kernel import PROCESSOR

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "emulator" / "lidar_emu" / "numerics" / "overloads.c"
LEVELS = ("geometric", "spectral")
NESTED = (
    "{ground: {kind: nested, grids: [{kind: generated, size_m: 100, spacing_m: 1},"
    " {kind: generated, size_m: 400, spacing_m: 4}]}}"
)


class Recorded:
    """The types of arguments with which kernels were called from Python."""

    def __init__(self, key_of: Callable[..., bytes | None]) -> None:
        self._key_of = key_of
        self.kernels: dict[Any, dict[bytes, tuple[Type, ...]]] = {}

    def around(self, compiled_for_python: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """Return what compiles kernels for Python, with a record of their calls."""

        def compiled(kernel: Any) -> Callable[..., Any]:
            machine_code, seen = compiled_for_python(kernel), self.kernels.setdefault(kernel, {})

            def call(*args: Any) -> Any:
                key = self._key_of(*args)
                if key is not None and key not in seen:
                    seen[key] = tuple(map(typeof, args))
                return machine_code(*args)

            return call

        return compiled


def build_overloads(folder: Path) -> None:
    """Compile the module that chooses a function by the types of arguments."""
    target = folder / f"overloads{sysconfig.get_config_var('EXT_SUFFIX')}"
    include = [f"-I{sysconfig.get_path('include')}", f"-I{np.get_include()}"]
    command = [os.environ.get("CC", "cc"), "-O2", "-Wall", "-Wextra", "-shared", "-fPIC", *include]
    subprocess.run([*command, str(SOURCE), "-o", str(target)], check=True)


def flights() -> Iterator[list[str]]:
    """Commands that call the kernels of all shipped scenarios and sites, and of the other ways to compute a shot."""
    brief = ["--pace", "max", "--duration", "0.3"]
    reference = ["--set", "level=reference", "--duration", "0.05"]
    for path in sorted((ROOT / "scenarios").glob("*.yaml")):
        if path.stem != "live":
            yield ["run", path.name, *brief]
        yield ["plan", path.name]
        if "bench_pattern" not in path.read_text() and path.stem != "live":
            for level in LEVELS:
                yield ["run", path.name, *brief, "--set", f"level={level}"]
    yield ["ground", "descent.yaml"]
    sites = sorted(path.stem for path in (ROOT / "emulator/lidar_emu/shipped/sites").glob("*.yaml"))
    for site in (*sites, NESTED):
        yield ["run", "descent.yaml", *brief, "--set", f"site={site}"]
    yield ["run", "descent.yaml", *brief, "--exact"]
    for key in ("vibration={along_z: {g_rms: 1}}", "instrument.detection.compensate=acceleration"):
        yield ["run", "descent.yaml", *brief, "--set", key]
    for samples in ("narrowband", "full_rate"):
        yield ["run", "descent.yaml", *brief, *reference, "--set", f"reference_samples={samples}"]


def call_from_python() -> None:
    """Call the kernels that no command calls alone: those of a custom detector and of live truth."""
    import lidar_emu

    lidar_emu.simulate("descent.yaml", duration_s=0.1, detector=lambda _: [])
    device = lidar_emu.EmbeddedDevice("live.yaml")
    for step in range(1, 40):
        device.set_truth(step * 10_000_000, (0, 0, 500 - step), (0, 0, -100), (0.0, 2**-0.5, 2**-0.5, 0.0))
        device.advance(step * 10_000_000)


def record(folder: Path) -> list[tuple[str, str, dict[bytes, tuple[Type, ...]]]]:
    """Fly, and record the types of arguments as the module in the folder spells them, by module and name of the kernel.

    Runs in a separate process, which takes kernels from the cache: numba compiles for one processor in a process.
    """
    from click.testing import CliRunner

    from lidar_emu.cli import cli
    from lidar_emu.numerics import compiler
    from lidar_emu.numerics.lazy_kernel import name_of

    sys.path.insert(0, str(folder))
    overloads = import_module("overloads")
    overloads.use_names(name_of)
    recorded = Recorded(overloads.key_of)
    compiler.compiled_for_python = recorded.around(compiler.compiled_for_python)
    for command in flights():
        result = CliRunner().invoke(cli, command)
        print(f"{' '.join(command)}: exit {result.exit_code}", file=sys.stderr)
    call_from_python()
    by_name = sorted(recorded.kernels.items(), key=lambda item: item[0].full_name)
    return [(kernel.__module__, kernel.__qualname__, seen) for kernel, seen in by_name]


def build(recorded: list[tuple[str, str, dict[bytes, tuple[Type, ...]]]], folder: Path) -> dict[str, Any]:
    """Compile the kernels; returns the table of what was built."""
    from numba.pycc import CC

    from lidar_emu.numerics.compiler import without_wrappers
    from lidar_emu.numerics.lazy_kernel import PROCESSOR, digest

    module = CC("prebuilt_kernels", source_module=sys.modules[__name__])
    module.target_cpu = PROCESSOR
    module.output_dir = str(folder)
    table = {}
    for source, name, seen in recorded:
        kernel, built = getattr(import_module(source), name), {}
        for number, (key, types) in enumerate(seen.items()):
            symbol = f"{kernel.full_name.replace('.', '_')}_{number}"
            target = without_wrappers(kernel)
            target.compile(types)
            signature = target.overloads[types].signature
            module.export(symbol, signature)(_calling(target, len(types)))
            built[key.hex()] = symbol
        if built:
            table[kernel.full_name] = {"digest": digest(kernel), "built": built}
    module.compile()
    return table


def _calling(target: Any, count: int) -> Any:
    """A function that only calls the kernel: its options are not those of the module's functions."""
    names = ", ".join(f"a{k}" for k in range(count))
    scope: dict[str, Any] = {"target": target}
    exec(f"def calling({names}):\n    return target({names})", scope)
    return scope["calling"]


def main() -> None:
    """Build both modules and the table."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.iterdir():
        old.unlink()
    build_overloads(folder)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        recorded = process.submit(record, folder).result()
    with tempfile.TemporaryDirectory() as cache:
        config.CACHE_DIR, config.CPU_NAME, config.CPU_FEATURES = cache, PROCESSOR, ""
        table = build(recorded, folder)
    (folder / "prebuilt_kernels.json").write_text(json.dumps(table, indent=1))
    size_mb = sum(path.stat().st_size for path in folder.iterdir()) / 1e6
    count = sum(len(kernel["built"]) for kernel in table.values())
    print(f"{folder}: {len(table)} kernels for {count} types of arguments, {size_mb:.1f} MB")


if __name__ == "__main__":
    main()
