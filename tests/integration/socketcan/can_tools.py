"""Other people's programs on the bus: candump, cansend, cantools, tshark."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from slcan_lines import Line
from waiting import LIMIT_S, eventually

from lidar_protocol import CanFrame

_LAST = 0x7FF
MEASUREMENTS = range(0x100, 0x130)
_LOGGED = re.compile(r"\(\d+\.\d+\) (\w+) ([0-9A-F]{3})#(#[0-9A-F])?([0-9A-F]*)( [RT])?")


def run_tool(*command: str, stdin: str = "") -> str:
    """What a program prints that has to succeed."""
    return subprocess.run(
        command, input=stdin, capture_output=True, text=True, check=True, timeout=LIMIT_S
    ).stdout


def send(can_id: int, data: bytes, interface: str = "vcan0") -> None:
    """A frame by cansend: 11-bit identifier, or 32 bits with flags for its kind."""
    run_tool("cansend", interface, f"{can_id:0{3 if can_id < 0x800 else 8}X}#{data.hex()}")


def send_command(frame: CanFrame) -> None:
    """A classic frame of the library's, by cansend."""
    send(frame.can_id, frame.data)


class Candump:
    """candump with a log file."""

    def __init__(self, path: Path) -> None:
        self._path = path

    @property
    def log(self) -> str:
        """What it has logged so far, in whole lines."""
        text = self._path.read_text()
        return text[: text.rfind("\n") + 1]

    def is_complete(self, interface: str) -> bool:
        """Whether it has caught up: a last frame is sent, again where the bus loses it, until it is there."""
        send(_LAST, b"", interface)
        return any(frame.can_id == _LAST for frame in self._all_frames())

    def frames(self) -> list[Line]:
        """Data frames with 11-bit identifiers."""
        return [frame for frame in self._all_frames() if frame.can_id != _LAST]

    def _all_frames(self) -> list[Line]:
        return [_line(match) for line in self.log.splitlines() if (match := _LOGGED.fullmatch(line))]

    def shots(self) -> list[Line]:
        """Frames of shots."""
        return [frame for frame in self.frames() if frame.can_id in MEASUREMENTS]


@contextmanager
def candump(folder: Path, interface: str = "vcan0") -> Iterator[Candump]:
    """candump with ample room, listening from here on; it survives an interface that goes down."""
    path = folder / f"candump-{interface}.log"
    with path.open("wb") as log:
        # Line buffered by stdbuf, so that every frame is in the file as soon as it has come.
        command = ["stdbuf", "-oL", "candump", "-D", "-L", "-r", str(8 << 20), interface]
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.DEVNULL)
        with ended_at_the_end(process):
            eventually(lambda: interface in Path("/proc/net/can/rcvlist_all").read_text())
            dump, thrown_away = Candump(path), _thrown_away()
            yield dump
            eventually(lambda: dump.is_complete(interface))
            assert "DROPCOUNT" not in dump.log, "candump did not keep up"
            assert _thrown_away() == thrown_away, "the kernel's queue of received frames was full"


def _thrown_away() -> int:
    """Received frames for which a processor's queue had no room."""
    return sum(int(line.split()[1], 16) for line in Path("/proc/net/softnet_stat").read_text().splitlines())


@contextmanager
def tshark(folder: Path, interface: str = "vcan0") -> Iterator[Callable[[], list[tuple[int, bytes]]]]:
    """tshark, dissecting from here on: identifiers and data of the frames that it has seen so far."""
    path = folder / f"tshark-{interface}.txt"
    fields = ["-T", "fields", "-e", "can.id", "-e", "data.data"]
    before = _packet_sockets()
    with path.open("wb") as out:
        command = ["tshark", "-l", "-Q", "-i", interface, *fields]
        process = subprocess.Popen(command, stdout=out, stderr=subprocess.DEVNULL)
    with ended_at_the_end(process):
        eventually(lambda: _packet_sockets() > before)
        yield lambda: [
            _dissected(line) for line in path.read_text().splitlines(keepends=True) if line[-1] == "\n"
        ]


@contextmanager
def ended_at_the_end(process: subprocess.Popen[bytes]) -> Iterator[None]:
    """Leave no process behind."""
    try:
        yield
    finally:
        process.terminate()
        process.wait(20)


def _dissected(line: str) -> tuple[int, bytes]:
    can_id, data = line.rstrip("\n").split("\t")
    return int(can_id, 0), bytes.fromhex(data)


def _packet_sockets() -> int:
    return Path("/proc/net/packet").read_text().count("\n")


def _line(match: re.Match[str]) -> Line:
    _, can_id, flags, data, _ = match.groups()
    kind = "t" if flags is None else "b" if int(flags[1], 16) & 1 else "d"
    return Line(kind, int(can_id, 16), bytes.fromhex(data))
