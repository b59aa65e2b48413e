"""The C header under the address and undefined-behaviour sanitizers: about a minute of damaged and invented input."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest
from c_programs import COMPILER, NEEDS_COMPILER

import lidar_icd
from lidar_protocol import Device, default_interface

HERE = Path(__file__).parent
SANITIZED = ["-std=c99", "-g", "-O1", "-Wall", "-Wextra", "-Werror", "-fsanitize=address,undefined"]
INPUTS = 400_000


@pytest.mark.slow
@NEEDS_COMPILER
@pytest.mark.parametrize("seed", [1, 2])
def test_no_input_makes_the_header_read_or_write_beyond_its_blocks(seed: int, tmp_path: Path) -> None:
    interface = default_interface()
    (tmp_path / "lidar.h").write_text(lidar_icd.c_header(interface))
    build = [COMPILER, *SANITIZED, "-fno-sanitize-recover=all", f"-I{tmp_path}", str(HERE / "fuzz_header.c")]
    subprocess.run([*build, "-o", str(tmp_path / "fuzz")], check=True)
    shots = json.loads((HERE / "golden.json").read_text())
    device = Device(interface, 3)
    frames = [bytes.fromhex(shot["frame"]) for shot in shots]
    frames.append(device.acknowledge(0, "no_op", time_ns=0, sequence=3, verdict="accepted"))
    assert interface.housekeeping is not None
    frames.append(device.housekeeping(0, dict.fromkeys(interface.housekeeping.names, 0)))
    command = [str(tmp_path / "fuzz"), str(seed), str(INPUTS)]
    ran = subprocess.run(command, input=b"".join(frames), capture_output=True, check=False)
    assert ran.returncode == 0, f"{' '.join(command)}: {ran.stderr.decode(errors='replace')}"
    packets, messages = map(int, ran.stdout.split())
    assert packets > messages > INPUTS / 100
