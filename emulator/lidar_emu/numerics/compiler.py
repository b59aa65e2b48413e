"""numba's compiler for kernels, loaded when one must be compiled or read from the cache on disk.

numba's own cache keeps a compiled function until its file changes, even if the functions that it calls change, and two
processes that compile concurrently may exchange entries of its index. Here a name is a hash of code, constants and
options of the kernel and of every kernel that it calls, and each file has a checksum: a file is correct or the kernel
is compiled again. It is machine code: files and folders that others may write are not used. The files are in
`~/.cache/lidar-emu/kernels` unless `XDG_CACHE_HOME` or `NUMBA_CACHE_DIR` is set, and may be deleted at any time.
"""

from __future__ import annotations

import gc
import os
import pickle
import sys
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
import numpy as np
from numba import njit
from numba.core import config, event, types
from numba.core.caching import NullCache
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.compiler import Compiler, CompileResult
from numba.core.cpu import CPUTargetOptions
from numba.core.options import TargetOptions
from numba.core.registry import CPUDispatcher
from numba.core.serialize import dumps
from numba.extending import typeof_impl

from lidar_emu.errors import InputError, RunError, reason_of, warn_once
from lidar_emu.files import cache_folder, whole_file
from lidar_emu.numerics.compilation import report_compilation
from lidar_emu.numerics.lazy_kernel import PROCESSOR, Kernel, digest, missing_features, shown

_COMPILERS = (numba.__version__, np.__version__, sys.version_info[:2])
_CHECK_SUM_BYTES = 32
_UNCACHED = "kernels are compiled at every start, since they cannot be cached"

_UNTRUSTED = "another user may write there; chmod -R go-w a folder of yours, or set XDG_CACHE_HOME to one"


class KernelCache(NullCache):
    """The cache that a dispatcher reads before it compiles a kernel, and writes afterwards."""

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """The kernel compiled for this signature; None if it must be compiled."""
        target_context.refresh()
        kept = self._content(signature, target_context)
        if kept is None and report_compilation(self._kernel.full_name):
            kept = self._content(signature, target_context)
        if kept is None:
            return None
        check_sum, content = kept[:_CHECK_SUM_BYTES], kept[_CHECK_SUM_BYTES:]
        if sha256(content).digest() != check_sum:
            warn_once("damaged", f"damaged kernels in {_folder()} are compiled again")
            return None
        try:
            return CompileResult._rebuild(target_context, *pickle.loads(content))  # type: ignore[no-untyped-call]
        except (ImportError, AttributeError):  # it names a class that has moved since
            return None

    def _content(self, signature: Any, target_context: Any) -> bytes | None:
        try:
            path = self._path(signature, target_context.codegen())
            with path.open("rb") as file:
                if _is_trusted(path.parent.stat()) and _is_trusted(os.fstat(file.fileno())):
                    return file.read()
        except (OSError, RuntimeError):  # Missing, not readable, or a user without a home folder.
            return None
        warn_once("untrusted", f"kernels in {path.parent} are not used: {_UNTRUSTED}")
        return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        for environment in compiled._find_referenced_environments():
            # Of included kernels; as numba does with what it reads from a cache.
            compiled.library.codegen.set_env(environment.env_name, environment)
        content = dumps(compiled._reduce())  # type: ignore[no-untyped-call]
        try:
            path = self._path(signature, compiled.codegen)
            path.parent.mkdir(0o755, parents=True, exist_ok=True)
            if not _is_trusted(path.parent.stat()):
                warn_once("untrusted", f"kernels are not kept in {path.parent}: {_UNTRUSTED}")
                return
            with whole_file(path) as file:
                # Some systems let the group write what a user creates.
                os.fchmod(file.fileno(), os.fstat(file.fileno()).st_mode & ~0o022)
                file.write(sha256(content).digest() + content)
        except InputError as error:
            warn_once("uncached", f"{_UNCACHED}: {error.where}: {error.value}")
        except (OSError, RuntimeError, RunError) as error:
            warn_once("uncached", f"{_UNCACHED}: {reason_of(error)}")

    def _path(self, signature: Any, codegen: Any) -> Path:
        target = *_COMPILERS, _LLVM_OPTION, *codegen.magic_tuple(), *map(_spelt, signature)
        return _folder() / f"{self._kernel.full_name}-{digest(self._kernel, repr(target))}"


def _is_trusted(state: os.stat_result) -> bool:
    """Whether only this user or root can have written a file, whose machine code would run with this user's rights."""
    return state.st_uid in (0, os.geteuid()) and not state.st_mode & 0o022


def _folder() -> Path:
    stated: str = config.CACHE_DIR  # type: ignore[attr-defined]
    return Path(stated or cache_folder()) / "kernels"


def _spelt(numba_type: Any) -> str:
    """Name of a type, with the class and the fields of a named tuple, which numba omits.

    The class is named with its module: a file refers to both, and either may have been removed.
    """
    kind = getattr(numba_type, "instance_class", None)
    named = "" if kind is None else shown(kind)
    return f"{numba_type}{named}" + "".join(map(_spelt, getattr(numba_type, "types", ())))


if getattr(config, "CPU_NAME") is None and not missing_features():  # noqa: B009
    # Vectors of eight numbers, as in a wheel: longer ones leave more of short loops to be done number by number.
    config.CPU_NAME, config.CPU_FEATURES = PROCESSOR, ""  # type: ignore[attr-defined]

# Most loops have 16 to 64 steps: one vector at a time leaves least to be done number by number.
_LLVM_OPTION = "-force-vector-interleave=1"
llvm.set_option("", _LLVM_OPTION)

# numba knows the flag, but its decorators do not.
CPUTargetOptions.noalias = TargetOptions.Mapping("noalias")  # type: ignore[no-untyped-call]

_NO_WRAPPERS = {"nopython": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


class _Uncollected(event.Listener):
    """Suspends garbage collection while numba compiles: numba creates millions of objects and keeps most of them."""

    def __init__(self) -> None:
        self._depth = 0
        self._collecting = False

    def on_start(self, _event: Any) -> None:
        if self._depth == 0:
            self._collecting = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, _event: Any) -> None:
        self._depth -= 1
        if self._depth == 0 and self._collecting:
            gc.enable()


event.register("numba:compile", _Uncollected())  # type: ignore[no-untyped-call]


class _IncludedLibrary(JITCodeLibrary):
    """Code that others include, which is optimised and translated there: numba would do both for each function by
    itself, with all that it includes, too."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._finalized = True

    def get_pointer_to_function(self, _name: str) -> int:
        return 0


class _IncludedCompiler(Compiler):
    """numba's compiler of functions that Python does not call."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)  # type: ignore[no-untyped-call]
        self.state.library = _IncludedLibrary(self.state.targetctx.codegen(), "included")  # type: ignore[no-untyped-call]


def _set_environment_in_use(codegen: Any, name: str, environment: Any) -> None:
    if codegen._engine.is_symbol_defined(name):
        _set_environment(codegen, name, environment)


# An included function has no place for its environment until it is included.
_set_environment: Any = JITCPUCodegen.set_env
JITCPUCodegen.set_env = _set_environment_in_use  # type: ignore[method-assign]


@cache
def compiled_for_python(kernel: Kernel) -> Callable[..., Any]:
    """The kernel as Python calls it: compiled for the types of its arguments at the first call with these."""
    compiled: Callable[..., Any] = dispatcher(kernel) if kernel.outermost else _with_wrappers(kernel)
    return compiled


@cache
def dispatcher(kernel: Kernel) -> Any:
    """numba's dispatcher for a kernel as compiled code calls it.

    Only an outermost kernel has wrappers for Python: unpacking Python arguments is more code than most kernels have,
    and took a third of the compilation time. Another one that is called from Python is compiled again, with them.
    """
    if kernel.outermost:
        return _with_wrappers(kernel)
    return without_wrappers(kernel)


def without_wrappers(kernel: Kernel) -> Any:
    """numba's dispatcher for a kernel that only compiled code calls."""
    options = _NO_WRAPPERS | kernel.targetoptions
    return CPUDispatcher(kernel.py_func, targetoptions=options, pipeline_class=_IncludedCompiler)


def _with_wrappers(kernel: Kernel) -> Any:
    compiled = njit(**kernel.targetoptions)(kernel.py_func)
    compiled._cache = KernelCache(kernel)
    return compiled


@typeof_impl.register(Kernel)
def _type_of_kernel(kernel: Kernel, _context: object) -> Any:
    return types.Dispatcher(dispatcher(kernel))
