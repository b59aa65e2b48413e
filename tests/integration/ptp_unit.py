"""Program of the second kernel of test_ptp.py: the emulator, whose clock `ptp4l` keeps; prints what it sends.

Each line is JSON: shot, time_ns and locked of a packet with the system clock as it arrived, or locked of housekeeping.
Ends once a clock that was locked is locked no more.
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time

from lidar_protocol import Housekeeping, Message, SerialReceiver, default_interface

PORT = 5599


def main() -> None:
    """Run until the clock has lost its lock."""
    epoch, holdover_s = sys.argv[1:]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.bind(("127.0.0.1", PORT))
        host.settimeout(120)
        ptp = ["ptp4l", "-2", "-S", "-s", "-q", "-i", "eth0", "--first_step_threshold", "0.1"]
        settings = {
            "device.clock.source": "system",
            "device.clock.holdover_s": holdover_s,
            "timing.epoch": epoch,
        }
        run = ["lidar-emu", "run", "bench.yaml", "--port", f"udp:{PORT}", "--duration", "600"]
        run += [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        with subprocess.Popen(run, **quiet) as lidar, subprocess.Popen(ptp, **quiet) as clock:
            report(host)
            for program in (lidar, clock):
                program.terminate()


def report(host: socket.socket) -> None:
    """Print what arrives."""
    receiver, was_locked = SerialReceiver(default_interface()), False
    while True:
        for message in receiver.receive(host.recv(9000)):
            if isinstance(message, Housekeeping):
                print(json.dumps({"housekeeping": message.values["clock_locked"]}), flush=True)
            if isinstance(message, Message):
                locked = bool(message.header["clock_locked"])
                seen = {"shot": message.shot, "time_ns": message.time_ns, "locked": locked}
                print(json.dumps({**seen, "utc_ns": time.time_ns()}), flush=True)
                if was_locked and not locked:
                    return
                was_locked = locked


if __name__ == "__main__":
    main()
