"""Space packets of a recording, one after another in a file: what a link with damage leaves of them."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner
from spacepackets.ccsds import SpacePacketHeader

from lidar_emu.cli import cli
from lidar_emu.errors import InputError


def run(*arguments: str) -> str:
    done = CliRunner().invoke(cli, list(arguments), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


def refusal(*arguments: str) -> str:
    with pytest.raises(InputError) as refused:
        CliRunner().invoke(cli, list(arguments), catch_exceptions=False)
    return str(refused.value)


def record(folder: Path, *settings: str) -> str:
    path = str(folder / "run.mcap")
    options = [part for setting in settings for part in ("--set", setting)]
    run("run", "descent.yaml", "--pace", "max", "--duration", "2", "--record", path, *options)
    return path


def headers(path: Path) -> list[SpacePacketHeader]:
    """Headers of the packets, each found by the length of the one before it."""
    data, found = path.read_bytes(), []
    while data:
        header = SpacePacketHeader.unpack(data)
        found.append(header)
        assert len(data) >= header.packet_len
        data = data[header.packet_len :]
    return found


@pytest.mark.parametrize("framing", ["cobs", "slip"])
def test_every_packet_once_without_its_framing(framing: str, tmp_path: Path) -> None:
    definition = (Path(__file__).parents[2] / "protocol/lidar_protocol/default.toml").read_text()
    (tmp_path / "own.toml").write_text(definition.replace('kind = "cobs"', f'kind = "{framing}"'))
    recording = record(tmp_path, f"wire.interface={tmp_path}/own.toml")
    assert "42 packets" in run("report", recording, "--out", str(tmp_path / "run.ccsds"))
    counts = [header.seq_count for header in headers(tmp_path / "run.ccsds") if header.apid == 0x2A0]
    assert counts == list(range(40))


def test_a_packet_that_no_longer_has_its_length_is_left_out(tmp_path: Path) -> None:
    fault = "{kind: truncated, keep: 0.8, at_s: 1}"
    recording = record(tmp_path, f"faults=[{fault}]")
    line = run("replay", recording, "--to", str(tmp_path / "run.ccsds"))
    assert line.strip() == f"{tmp_path}/run.ccsds: 41 packets, 1 left out: damaged"
    counts = [header.seq_count for header in headers(tmp_path / "run.ccsds") if header.apid == 0x2A0]
    assert counts == [k for k in range(40) if k != 20]


def test_traffic_without_space_packets_is_refused(tmp_path: Path) -> None:
    recording = record(tmp_path)
    run("replay", recording, "--to", str(tmp_path / "run.pcap"))
    out = tmp_path / "x.ccsds"
    line = refusal("replay", str(tmp_path / "run.pcap"), "--to", str(out))
    assert line.endswith("a capture, which does not say its framing; must be a recording of a byte link")
    recording = record(tmp_path, "wire.interface=altimeter")
    assert refusal("report", recording, "--out", str(out)).endswith("must be a recording of space packets")
    assert not out.exists()
