"""Fly with the firmware on an emulated processor, and print its last report.

    python fly.py cortex_m3 --duration 10

The processor is cortex_m3, leon3, powerpc_440, powerpc_440_can or powerpc_process; the rest is for `lidar-emu run
descent.yaml`. The folder build/ has then the recording of the flight and the report of the firmware.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from leon3_report import saved_report

HERE = Path(__file__).resolve().parent
ON_CAN, CAN_INTERFACE = "powerpc_440_can", "vcan0"
BAMBOO = ["qemu-system-ppc", "-M", "bamboo", "-nodefaults"]
CAN_CARD = [
    *("-object", "can-bus,id=bus"),
    *("-object", f"can-host-socketcan,id=host,if={CAN_INTERFACE},canbus=bus"),
    *("-device", "ctucan_pci,addr=1,canbus0=bus,canbus1=bus"),
]
PROCESSORS = {
    "cortex_m3": ("arm-none-eabi-gcc", ["qemu-system-arm", "-M", "mps2-an385"]),
    "leon3": ("sparc64-linux-gnu-gcc", ["qemu-system-sparc", "-M", "leon3_generic"]),
    "powerpc_440": ("powerpc-linux-gnu-gcc", BAMBOO),
    "powerpc_440_can": ("powerpc-linux-gnu-gcc", [*BAMBOO, "-serial", "null", *CAN_CARD]),
    "powerpc_process": ("powerpc-linux-gnu-gcc", ["qemu-ppc"]),
}
PACKAGES = {
    "cortex_m3": "gcc-arm-none-eabi qemu-system-arm",
    "leon3": "gcc-sparc64-linux-gnu qemu-system-sparc",
    "powerpc_440": "gcc-powerpc-linux-gnu qemu-system-ppc",
    "powerpc_440_can": "gcc-powerpc-linux-gnu qemu-system-ppc",
    "powerpc_process": "gcc-powerpc-linux-gnu libc6-dev-powerpc-cross qemu-user",
}
REPORT_LIMIT_S = 20


def missing(processor: str) -> str | None:
    """What the processor needs and is missing: Debian's packages, or an interface of SocketCAN."""
    compiler, (emulator, *_) = PROCESSORS[processor]
    if not all(map(shutil.which, ["make", compiler, emulator])):
        return f"{processor} needs Debian's make {PACKAGES[processor]}"
    if processor == ON_CAN and not Path("/sys/class/net", CAN_INTERFACE).exists():
        return f"{processor} needs the interface {CAN_INTERFACE}: ip link add {CAN_INTERFACE} type vcan"
    return None


def fly(processor: str, folder: Path, arguments: Sequence[str] = ()) -> tuple[int, list[str]]:
    """Build the firmware in a folder, and fly with it.

    Returns:
        the number of shots that the lidar sent, and the lines of the firmware's report.

    Raises:
        RuntimeError: the run failed, or was refused.
        CalledProcessError: the firmware could not be built.
    """
    folder.mkdir(parents=True, exist_ok=True)
    subprocess.run(["make", "-C", str(HERE), f"BUILD={folder}", processor], check=True)
    link, monitor = folder / "lidar", folder / "monitor"
    command = ["lidar-emu", "run", "descent.yaml", *_line(processor, link)]
    command += ["--start", "on-command", "--wait-limit", "60", "--set", "device.start=boot"]
    command += ["--record", str(folder / "flight.mcap"), "--json", *arguments]
    with ExitStack() as stack:
        run = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        stack.callback(_end, run)
        assert run.stdout is not None
        if '"ready"' not in run.stdout.readline():
            raise RuntimeError(f"{' '.join(command)} ended at once")
        guest = stack.enter_context(_started(processor, folder, link, monitor))
        stack.callback(_end, guest)
        output = run.stdout.read().splitlines()
        if run.wait() != 0 or not output:
            raise RuntimeError(
                f"the run failed; {processor} commanded no flight within a minute, or see above"
            )
        sent: int = json.loads(output[-1])["shots"]["sent"]
        return sent, _whole_report(processor, folder, monitor, sent)


def _line(processor: str, link: Path) -> list[str]:
    """Options of the lidar's line to the processor."""
    if processor == ON_CAN:
        return ["-i", "socketcan", "-c", CAN_INTERFACE, "--bitrate", "1000000"]
    return ["--port", f"pty:{link}", "--baud", "921600"]


def _end(process: subprocess.Popen[str]) -> None:
    if process.poll() is None:
        process.terminate()


def _started(processor: str, folder: Path, link: Path, monitor: Path) -> subprocess.Popen[str]:
    """The emulator, with the lidar's port as its first serial line unless the lidar is on CAN."""
    _, emulator = PROCESSORS[processor]
    firmware, report = folder / f"{processor}.elf", folder / "report.txt"
    if processor == "powerpc_process":
        with link.open("rb+", buffering=0) as port, report.open("wb") as out:
            return subprocess.Popen([*emulator, str(firmware)], stdin=port, stdout=out, text=True)
    lines = ["-chardev", f"serial,id=lidar,path={_option(link)}", "-serial", "chardev:lidar"]
    if processor == ON_CAN:
        lines = []
    if processor == "leon3":
        lines += ["-qmp", f"unix:{_option(monitor)},server=on,wait=off"]
    else:
        lines += ["-serial", f"file:{report}"]
    bare = ["-display", "none", "-monitor", "none"]
    return subprocess.Popen([*emulator, *bare, *lines, "-kernel", str(firmware)], text=True)


def _option(path: Path) -> str:
    """A path within an option of QEMU, which separates at commas."""
    return str(path).replace(",", ",,")


def _whole_report(processor: str, folder: Path, monitor: Path, shots: int) -> list[str]:
    """The report, once it has as many shots as were sent; as it is after `REPORT_LIMIT_S`."""
    deadline_s = time.monotonic() + REPORT_LIMIT_S
    while True:
        text = (
            saved_report(monitor, folder / "memory.bin")
            if processor == "leon3"
            else (folder / "report.txt").read_text()
        )
        lines = text.split("\n")[:-1]
        if sum(line.startswith("shot ") for line in lines) >= shots or time.monotonic() > deadline_s:
            return lines
        time.sleep(0.05)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(epilog="Further options are for lidar-emu run descent.yaml.")
    parser.add_argument("processor", choices=PROCESSORS)
    chosen, arguments = parser.parse_known_args()
    processor: str = chosen.processor
    if wanted := missing(processor):
        sys.exit(wanted)
    try:
        sent, lines = fly(processor, HERE / "build", arguments)
    except (RuntimeError, subprocess.CalledProcessError) as error:
        sys.exit(str(error))
    print(*lines[-1:], sep="\n")
    received = sum(line.startswith("shot ") for line in lines)
    print(f"{processor}: {received} of {sent} shots received")
    sys.exit(received != sent)


if __name__ == "__main__":
    main()
