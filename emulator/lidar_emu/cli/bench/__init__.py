"""`lidar-emu bench`: the accuracy, the speed and the timing of the emulator, measured on this machine."""

from __future__ import annotations

import click

from lidar_emu.cli.bench.accuracy import accuracy
from lidar_emu.cli.bench.campaign import campaign
from lidar_emu.cli.bench.casting import casting
from lidar_emu.cli.bench.protocol import protocol
from lidar_emu.cli.bench.realtime import realtime
from lidar_emu.cli.bench.response import response


@click.group(short_help="Measure the emulator's accuracy, speed and timing on this machine.")
def bench() -> None:
    """Measure the emulator itself, on this machine."""


for command in (accuracy, campaign, casting, protocol, realtime, response):
    bench.add_command(command)
