"""The pytest plugin: fixtures that start emulated lidars, and grade flight software, in a test."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from lidar_emu.testing import StartEmulator
    from lidar_emu.trial.judge import CaseVerdict


@pytest.fixture
def lidar_emulator(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StartEmulator]:
    """Start emulated lidars: `lidar = lidar_emulator("descent.yaml")`.

    It takes the arguments of `lidar_emu.testing.start_emulator` without the folder, with the same result and
    errors. All emulators end with the test, whether it passes or fails.
    """
    from lidar_emu.testing import StartEmulator

    with ExitStack() as stack:
        yield StartEmulator(lambda: tmp_path_factory.mktemp("lidar"), stack)


@pytest.fixture
def lidar_trial(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., CaseVerdict]:
    """Fly a case of a pack, and judge the navigation: `found = lidar_trial("nominal/moon", "./navigate {port}")`.

    It takes the arguments of `lidar_emu.trial.judge.try_case` without the folder, with the same result and errors.
    """
    from lidar_emu.trial.judge import try_case

    return lambda case, host, *options: try_case(case, host, tmp_path_factory.mktemp("trial"), *options)
