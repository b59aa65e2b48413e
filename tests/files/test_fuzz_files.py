"""Readers of a user's files, on the inputs that once failed or by which the guided fuzzer reached new code."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from lidar_emu.errors import InputError
from tools import fuzz_files

CORPUS = Path(__file__).with_name("fuzz_corpus")


@pytest.mark.parametrize("target", fuzz_files.TARGETS)
def test_readers_hold_on_what_once_failed_or_reaches_deep(
    target: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = []
    refused = fuzz_files._refused

    @contextmanager
    def counted(path: str = "") -> Iterator[None]:
        with refused(path):
            yield
            values.append(path)

    monkeypatch.setattr(fuzz_files, "_refused", counted)
    inputs = (CORPUS / f"{target}.txt").read_text().split()
    for data in inputs:
        fuzz_files.TARGETS[target](bytes.fromhex(data))
    assert len(inputs) > 5
    assert values, "some of them are read"


class Bad:
    """A reader with a fault."""

    def __init__(self, fault: str) -> None:
        self._fault = fault

    def __call__(self, file: str, unit: str) -> None:
        match self._fault:
            case "raises":
                raise KeyError(file)
            case "warns":
                np.float64(1e308) * np.array([10.0])
            case "names no file":
                raise InputError("vertex", None, unit, "must be a number")
            case "fills the memory":
                np.ones(2 << 27)


@pytest.mark.parametrize(
    ("fault", "raised"),
    [
        ("raises", KeyError),
        ("warns", RuntimeWarning),
        ("names no file", AssertionError),
        ("fills the memory", MemoryError),
    ],
)
def test_a_bad_reader_is_found(fault: str, raised: type[Exception], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz_files, "read_mesh", Bad(fault))
    with pytest.raises(raised):
        fuzz_files.TARGETS["ply"](b"")
