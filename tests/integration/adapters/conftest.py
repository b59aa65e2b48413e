"""Tests on adapters of a machine of their own, run by `machine`; elsewhere they are skipped."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # usb.py is a module of these tests

from usb import Adapter, Ftdi, Gadget


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Outside the machine state the reason."""
    reason = "needs USB adapters: make adapters"
    for item in items:
        if "ADAPTERS_MACHINE" not in os.environ and Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture(params=[Gadget, Ftdi])
def adapter(request: pytest.FixtureRequest) -> Iterator[Adapter]:
    """Each of the machine's USB adapters, plugged in."""
    with closing(request.param()) as plugged:
        yield plugged


@pytest.fixture
def gadget() -> Iterator[Gadget]:
    """The CDC-ACM adapter."""
    with closing(Gadget()) as plugged:
        yield plugged
