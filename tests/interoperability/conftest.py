"""One descent, recorded on a byte link and on both kinds of CAN, which programs of others decode."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from waiting import LIMIT_S

from lidar_emu import Measurement, load, simulate
from lidar_emu.recording.captures import RAW_IP, PcapWriter, udp_record
from lidar_emu.wire import Encoder

SCENARIO = "descent.yaml"


def lidar_emu(*arguments: str, folder: Path) -> str:
    """Output of a command that must succeed."""
    command = [sys.executable, "-m", "lidar_emu", *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=LIMIT_S)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="session")
def documents(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `lidar-emu icd` writes of the default interface."""
    folder = tmp_path_factory.mktemp("documents")
    lidar_emu("icd", "--out", str(folder), folder=folder)
    return folder


@pytest.fixture(scope="session")
def simulated() -> Measurement:
    """All shots of the descent."""
    return simulate(load(SCENARIO))


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of the descent on a byte link, run.mcap, and its traffic, run.pcap and run.ccsds."""
    folder = tmp_path_factory.mktemp("recorded")
    lidar_emu("run", SCENARIO, "--pace", "max", "--record", "run.mcap", folder=folder)
    lidar_emu("report", "run.mcap", "--out", "run.pcap", "--out", "run.ccsds", folder=folder)
    return folder


@pytest.fixture(scope="session")
def datagrams(tmp_path_factory: pytest.TempPathFactory, simulated: Measurement) -> Path:
    """The descent as datagrams."""
    path = tmp_path_factory.mktemp("udp") / "udp.pcap"
    with path.open("wb") as file:
        writer = PcapWriter(file, RAW_IP)
        encoder = Encoder(load(SCENARIO).wire, can=False, fd=False, beam_count=simulated.beam_count)
        for number, packet in enumerate(encoder.packets(simulated)):
            assert isinstance(packet, bytes)
            writer.write(number, udp_record("127.0.0.1:5600", packet))
    return path
