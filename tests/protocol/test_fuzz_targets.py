"""The targets of tools/fuzz.py hold on bytes that nobody chose, and would not if a decoder raised or kept too much."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidar_protocol import SerialReceiver

_CORPUS = Path(__file__).with_name("fuzz_corpus")
_FILE = Path(__file__).resolve().parents[2] / "tools" / "fuzz_targets.py"


def _loaded() -> Any:
    spec = importlib.util.spec_from_file_location("fuzz_targets", _FILE)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules["fuzz_targets"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


FUZZ = _loaded()


@pytest.mark.parametrize("target", FUZZ.TARGETS)
def test_targets_hold_on_what_reached_every_branch(target: str) -> None:
    """The inputs by which the guided fuzzer reached new code."""
    inputs = (_CORPUS / f"{target}.txt").read_text().split()
    assert len(inputs) > 10
    for data in inputs:
        FUZZ.TARGETS[target](bytes.fromhex(data))


@pytest.mark.slow
@pytest.mark.parametrize("target", FUZZ.TARGETS)
def test_targets_hold(target: str) -> None:
    @settings(max_examples=150, deadline=None)
    @given(st.binary(max_size=600))
    def hold(data: bytes) -> None:
        FUZZ.TARGETS[target](data)

    hold()


@pytest.mark.parametrize("fault", ["raises", "keeps", "loses"])
def test_a_bad_decoder_is_found(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    class Bad(SerialReceiver):
        def receive(self, data: bytes) -> Any:
            if fault == "raises" and data.startswith(b"\xff"):
                raise IndexError
            return [] if fault == "loses" else super().receive(data)

        @property
        def buffered_bytes(self) -> int:
            return 10**6 if fault == "keeps" else super().buffered_bytes

    monkeypatch.setattr(FUZZ, "SerialReceiver", Bad)
    with pytest.raises((AssertionError, IndexError)):
        FUZZ.serial(b"\x04\x02\xff\xff")
