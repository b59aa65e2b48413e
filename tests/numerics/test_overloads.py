"""The module in C that chooses machine code by the types of arguments: it tells apart what numba tells apart."""

from __future__ import annotations

import sys
from importlib.util import module_from_spec, spec_from_file_location
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba import typeof
from wheels import CAN_BUILD

from lidar_emu.numerics import lazy_kernel as prebuilt
from lidar_emu.numerics.kernels import kernel

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
from build_kernels import build_overloads


class Line(NamedTuple):
    slope: float
    start: float


class Other(NamedTuple):
    slope: float
    start: float


def read_only(values: np.ndarray) -> np.ndarray:
    values = values.copy()
    values.flags.writeable = False
    return values


PLAIN = np.dtype([("a", "f8"), ("b", "i4")])
VALUES = (
    1.5, 7, True, None, 1 << 62, np.float64(2.0), np.float32(2.0), np.int64(3), np.int32(3), np.uint64(3),
    np.bool_(True), np.complex128(1j),
    np.zeros(3), np.zeros(0), np.zeros(()), np.zeros((2, 3)), np.zeros((2, 3)).T, np.zeros((4, 4))[::2, ::2],
    np.zeros(8)[::2], np.zeros((2, 3, 1)), np.zeros(3, "f4"), np.zeros(3, "i8"), np.zeros(3, "u8"), np.zeros(3, "?"),
    np.zeros(3, "c16"), np.zeros(3, "i1"), np.zeros(3, "u1"), read_only(np.zeros(3)), read_only(np.zeros((2, 3))),
    np.zeros(3, PLAIN), np.zeros(3, np.dtype(PLAIN.descr, align=True)),
    np.zeros(3, [("a", "f8"), ("c", "i4")]), np.zeros(3, [("a", "f8"), ("b", "i4", 2)]), np.zeros(3, PLAIN)[0],
    (), (1.0,), (1.0, 2), (1, 2.0), ((1.0,), 2), (1.0, (2,)), (np.zeros(3), 1), (np.zeros((3, 3)), 1),
    Line(1.0, 2.0), Line(1.0, 2), Other(1.0, 2.0), (Line(1.0, 2.0),),
)  # fmt: skip


@pytest.fixture(scope="module")
def overloads(tmp_path_factory: pytest.TempPathFactory) -> Any:
    if not CAN_BUILD:
        pytest.skip("needs compilers of C and C++, and the headers of Python")
    folder = tmp_path_factory.mktemp("overloads")
    build_overloads(folder)
    (file,) = folder.iterdir()
    spec = spec_from_file_location("overloads", file)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    module.use_names(prebuilt.name_of)
    return module


def test_keys_tell_apart_what_numba_tells_apart(overloads: Any) -> None:
    keys, types = [overloads.key_of(value) for value in VALUES], [typeof(value) for value in VALUES]
    assert None not in keys
    for (key, kind, value), (key_b, kind_b, value_b) in product(
        zip(keys, types, VALUES, strict=True), repeat=2
    ):
        assert (key == key_b) == (kind == kind_b), (value, value_b)


def test_arrays_that_are_not_aligned_are_told_apart_too(overloads: Any) -> None:
    shifted = np.zeros(25, "u1")[1:].view("f8")
    assert not shifted.flags.aligned
    assert overloads.key_of(shifted) != overloads.key_of(shifted.copy())


def test_arguments_do_not_run_together(overloads: Any) -> None:
    for a, b in product(VALUES, repeat=2):
        key = overloads.key_of(a, b)
        assert key == overloads.key_of(a) + overloads.key_of(b)
        assert (key == overloads.key_of(b, a)) == (typeof(a) == typeof(b))


@pytest.mark.parametrize(
    "value", ["text", [1.0], 1 << 63, object(), np.zeros(3, "O"), (1.0, "text"), (1.0,) * 5000]
)
def test_nothing_is_built_for_what_kernels_do_not_take(overloads: Any, value: Any) -> None:
    named = overloads.key_of(value)
    assert named is None or value.dtype == object, (
        "an array of objects has a name that no kernel is built for"
    )


def test_the_function_of_the_types_is_called(overloads: Any) -> None:
    built = ((overloads.key_of(1.0, 2), lambda *args: ("built", *args)),)
    chosen = overloads.Overloads(built, lambda *args: ("otherwise", *args))
    assert chosen(3.0, 4) == ("built", 3.0, 4)
    assert chosen(3, 4.0) == ("otherwise", 3, 4.0)
    assert chosen() == ("otherwise",)
    assert chosen("text") == ("otherwise", "text")
    with pytest.raises(TypeError):
        overloads.Overloads((("key", print),), print)


def test_an_exception_of_a_name_is_raised(overloads: Any) -> None:
    overloads.use_names(lambda _: 1 / 0)
    try:
        with pytest.raises(ZeroDivisionError):
            overloads.key_of(Line(1.0, 2.0))
        overloads.use_names(lambda _: "no bytes")
        with pytest.raises(TypeError):
            overloads.key_of(Line(1.0, 2.0))
    finally:
        overloads.use_names(prebuilt.name_of)


def test_a_processor_without_the_instructions_compiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    table = tmp_path / "table.json"
    table.write_text("{}")
    monkeypatch.setattr(prebuilt, "TABLE", table)
    monkeypatch.setattr(prebuilt, "_processor_flags", lambda: prebuilt._NEEDED - {"avx2"})
    prebuilt.prebuilt_table.cache_clear()
    try:
        assert prebuilt.prebuilt_table() == {}
    finally:
        prebuilt.prebuilt_table.cache_clear()
    assert caplog.messages == ["lidar-emu: kernels are compiled here: this processor lacks avx2"]


def test_code_of_another_state_of_a_kernel_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    @kernel(outermost=True)
    def doubled(x: float) -> float:
        return 2.0 * x

    stale = {doubled.full_name: {"digest": "of another state", "built": {}}}  # type: ignore[attr-defined]
    monkeypatch.setattr(prebuilt, "prebuilt_table", lambda: stale)
    assert prebuilt.prebuilt(doubled, lambda _: doubled) is None  # type: ignore[arg-type]
