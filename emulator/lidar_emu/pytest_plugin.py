"""The pytest plugin: a fixture that starts emulated lidars for a test of flight software."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lidar_emu.testing import StartEmulator


@pytest.fixture
def lidar_emulator(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StartEmulator]:
    """Start emulated lidars: `lidar = lidar_emulator("descent.yaml")`.

    It takes the arguments of `lidar_emu.testing.start_emulator` without the folder, with the same result and
    errors. All emulators end with the test, whether it passes or fails.
    """
    from lidar_emu.testing import emulators_in

    with emulators_in(lambda: tmp_path_factory.mktemp("lidar")) as start:
        yield start
