"""`lidar-emu bench`: the accuracy, the speed and the timing of the emulator, measured on this machine."""

from __future__ import annotations

import click

from lidar_emu.cli.bench.accuracy import accuracy
from lidar_emu.cli.bench.realtime import realtime, response


@click.group(short_help="Measure the emulator's accuracy, speed and timing on this machine.")
def bench() -> None:
    """Measure the emulator itself, on this machine."""


for command in (accuracy, realtime, response):
    bench.add_command(command)
