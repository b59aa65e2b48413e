"""What a run pays for its packets, from the measurement to the frame, beside encoders and decoders in C.

python -m benchmarks.protocol    needs a C compiler, `cc`

The peers are called through ctypes and give the same bytes and values: an encoder that this script generates from the
interface's layout, and the decoder of the C header that `lidar-emu documents` writes. A peer's time includes what
Python pays to hand over the columns of a measurement.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

import lidar_icd
from benchmarks.tables import command_line
from lidar_emu.bench.settings import median_times_s
from lidar_emu.measurement import Measurement
from lidar_emu.scenario.load import load
from lidar_emu.scenario.schema import Wire
from lidar_emu.shots.model import build_model, measure_whole
from lidar_emu.wire import Encoder
from lidar_protocol import CanReceiver, CanSet, Interface, SerialReceiver, default_interface
from lidar_protocol.crc import CRCS, Crc
from lidar_protocol.fields import Codec, Constant, Counter, Flag, Number, Time
from lidar_protocol.layout import Layout

ROUNDS: Final = 100
_CALLS: Final = 50
"""In a row, so that reading the clock costs nothing beside them."""

_SETS: Final[tuple[CanSet, ...]] = ("core", "full", "fd")
_MODE_TRACK: Final = 4
_BLOCK: Final = "a second of packets at 20 Hz, built"


class Job(NamedTuple):
    """A task, and the same in C."""

    name: str
    ours: Callable[[], object]
    compiled: Callable[[], object] | None = None


class Cost(NamedTuple):
    """Times of a job."""

    name: str
    time_s: float
    compiled_s: float | None


def flown() -> Measurement:
    """A second of the descent: 20 shots of four beams."""
    return measure_whole(build_model(load("descent.yaml", {"duration_s": "1"})))


def measure_protocol(rounds: int) -> list[Cost]:
    """Median times of all jobs."""
    with tempfile.TemporaryDirectory() as folder:
        jobs = protocol_jobs(CompiledCodec(default_interface(), flown(), Path(folder)), flown())
        calls = [call for job in jobs for call in (job.ours, job.compiled) if call is not None]
        times_s = iter(
            [time_s / _CALLS for time_s in median_times_s([partial(_often, c) for c in calls], rounds)]
        )
        return [
            Cost(job.name, next(times_s), None if job.compiled is None else next(times_s)) for job in jobs
        ]


def _often(job: Callable[[], object]) -> None:
    for _ in range(_CALLS):
        job()


def protocol_jobs(codec: CompiledCodec, block: Measurement) -> list[Job]:
    """A shot of four beams as a packet and as the sets on CAN, built and decoded; each CRC over that packet."""
    interface, shot, beam_count = codec.interface, block.one(0), block.range_m.shape[1]
    encoder, receiver = Encoder(Wire(), False, False, beam_count), SerialReceiver(interface)
    (frame,) = encoder.packets(shot)
    assert isinstance(frame, bytes)
    jobs = [
        Job("packet, built", lambda: list(encoder.packets(shot)), lambda: codec.encode(shot)),
        Job(_BLOCK, lambda: list(encoder.packets(block)), lambda: codec.encode(block)),
        Job("packet, checked and decoded", lambda: receiver.receive(frame), lambda: codec.decode(frame)),
    ]
    for can_set in _SETS:
        wire = Wire(can_messages="core" if can_set == "fd" else can_set)
        jobs += _on_can(interface, can_set, Encoder(wire, True, can_set == "fd", beam_count), shot)
    covered = frame[: codec.packet_length - interface.link.crc_length]
    return jobs + [
        Job(f"{crc.name}, {len(covered)} bytes", partial(crc.function, covered)) for crc in CRCS.values()
    ]


def _on_can(interface: Interface, can_set: CanSet, encoder: Encoder, shot: Measurement) -> list[Job]:
    receiver = CanReceiver(interface)
    (frames,) = encoder.packets(shot)

    def receive() -> object:
        for can_id, data, is_fd, _ in frames:
            messages = receiver.receive(can_id, data, is_fd)
        return messages

    return [
        Job(f"CAN {can_set}, {len(frames)} frames, built", lambda: list(encoder.packets(shot))),
        Job(f"CAN {can_set}, decoded", receive),
    ]


class CompiledCodec:
    """Encoder and decoder of the packets of one interface in C; the device is unit 0, tracking, on a byte link.

    Args:
        interface: with space packets, a CRC of 16 bits and COBS, as the default.
        measurement: shots with the columns, their types and the number of beams that are encoded.
        folder: for the library.
    """

    def __init__(self, interface: Interface, measurement: Measurement, folder: Path) -> None:
        self.interface = interface
        packet = interface.packet
        assert packet.beam is not None
        assert interface.link.crc is not None
        beam_count = measurement.range_m.shape[1]
        fields = [each.field for each in (*packet.header.placed, *packet.beam.placed)]
        self._names = [each.name for each in fields if _is_column(measurement, each.name)]
        self._names += [name for name in ("time_ns", "shot") if name not in self._names]
        header = interface.link.header.length
        self.packet_length = header + packet.header.length + beam_count * packet.beam.length + 2
        (frame,) = Encoder(Wire(), False, False, beam_count).packets(measurement.one(0))
        assert isinstance(frame, bytes)
        (folder / "lidar.h").write_text(lidar_icd.c_header(interface))
        first = interface.link.framing.decode(frame.strip(b"\0"))[:header]
        (folder / "codec.c").write_text(self._source(measurement, beam_count, first))
        library = folder / "codec.so"
        compiler = ["cc", "-O3", "-march=native", "-ffp-contract=off", "-shared", "-fPIC"]
        subprocess.run([*compiler, "-I", folder, "-o", library, folder / "codec.c"], check=True)
        self._library = ctypes.CDLL(str(library))
        self._frame = ctypes.create_string_buffer(2 * self.packet_length)
        self._columns = (ctypes.c_void_p * len(self._names))()

    def encode(self, measurement: Measurement) -> list[bytes]:
        """The framed packets of a measurement."""
        for k, name in enumerate(self._names):
            self._columns[k] = getattr(measurement, name).ctypes.data
        packets = []
        for row in range(len(measurement)):
            length = self._library.encode(self._columns, ctypes.c_long(row), self._frame)
            packets.append(ctypes.string_at(self._frame, length))
        return packets

    def decode(self, frame: bytes) -> int:
        """Decode a frame; the number of beams that are valid in range."""
        return int(self._library.decode(frame, len(frame)))

    def _source(self, measurement: Measurement, beam_count: int, first: bytes) -> str:
        packet = self.interface.packet
        assert packet.beam is not None
        crc = self.interface.link.crc
        assert crc is not None
        pointers = []
        for k, name in enumerate(self._names):
            column = getattr(measurement, name)
            row = "row" if column.ndim == 1 else f"row * {beam_count}"
            pointers.append(
                f"    const {_c_type(column)} *const {name} = (const {_c_type(column)} *)columns[{k}] + {row};"
            )
        header_values = {"mode": _MODE_TRACK, "laser_on": 1, "clock_locked": 1, "beam_count": beam_count}
        header_values |= {"interface_version": self.interface.version, "time_ns": "first_ns"}
        header_values |= {
            "due_ns": "due_ns[0]",
            "shot": "shot[0]",
            "shot_counter": "shot[0]",
            "pattern": "pattern[0]",
        }
        beam_values = {name: f"{name}[b]" for name in self._names if name not in header_values}
        beam_values["time_offset_s"] = "(time_ns[b] - first_ns) * 1e-9"
        lines = [*_writes(packet.header, header_values, "at"), f"    at += {packet.header.length};"]
        lines.append(f"    for (int b = 0; b < {beam_count}; b++, at += {packet.beam.length}) {{")
        lines += [*_writes(packet.beam, beam_values, "at"), "    }"]
        return _SOURCE.format(
            table=", ".join(str(word) for word in _crc_table(crc)),
            start=crc.start,
            length=self.packet_length,
            beams=beam_count,
            header=", ".join(str(byte) for byte in first),
            pointers="\n".join(pointers),
            writes="\n".join(lines),
        )


_SOURCE = """#include <math.h>
#include <string.h>
#include "lidar.h"

static const uint16_t crc_table[256] = {{{table}}};

static int64_t steps(double value, double per_unit, int64_t lowest, int64_t highest, int64_t none, int nearest) {{
    const double scaled = value * per_unit + 0.5;
    if (scaled >= (double)lowest && scaled < (double)(highest + 1)) return (int64_t)floor(scaled);
    if (nearest && value == value) return scaled < (double)lowest ? lowest : highest;
    return none;
}}

static int64_t whole(int64_t value, int64_t lowest, int64_t highest, int64_t none, int nearest) {{
    if (value >= lowest && value <= highest) return value;
    return nearest ? (value < lowest ? lowest : highest) : none;
}}

static inline uint64_t ticks(int64_t ns) {{
    return (uint64_t)((((__int128)ns << 24) + 500000000) / 1000000000);
}}

/* Or `word` into the big-endian bits of a block of zeros. */
static inline void put(uint8_t *block, unsigned first_bit, unsigned bits, uint64_t word) {{
    for (unsigned end = first_bit + bits; bits > 0;) {{
        const unsigned used = (end - 1) % 8 + 1, take = used < bits ? used : bits;
        block[(end - 1) / 8] |= (uint8_t)((word & ((1u << take) - 1u)) << (8 - used));
        word >>= take, bits -= take, end -= take;
    }}
}}

int encode(const void *const *columns, long row, uint8_t *frame) {{
{pointers}
    uint8_t packet[{length}] = {{{header}}};
    uint8_t *at = packet + sizeof (uint8_t[]){{{header}}};
    int64_t first_ns = time_ns[0];
    for (int b = 1; b < {beams}; b++)
        if (time_ns[b] < first_ns) first_ns = time_ns[b];
    packet[2] = (uint8_t)(0xC0u | (shot[0] >> 8 & 0x3F)), packet[3] = (uint8_t)shot[0];
{writes}
    unsigned crc = {start};
    for (int k = 0; k < {length} - 2; k++) crc = (crc << 8 ^ crc_table[(crc >> 8 ^ packet[k]) & 0xFF]) & 0xFFFF;
    at[0] = (uint8_t)(crc >> 8), at[1] = (uint8_t)crc;
    return (int)lidar_frame(frame, packet, {length});
}}

int decode(const uint8_t *frame, int length) {{
    static lidar_receiver receiver;
    int valid = -1;
    for (int k = 0; k < length; k++) {{
        lidar_feed(&receiver, frame[k]);
        while (lidar_next(&receiver)) {{
            unsigned unit;
            lidar_measurement shot;
            if (!lidar_read_measurement(receiver.packet, receiver.packet_length, &unit, &shot)) continue;
            valid = 0;
            for (unsigned b = 0; b < shot.beam_count; b++) valid += shot.beams[b].range_valid;
        }}
    }}
    return valid;
}}
"""


def _is_column(measurement: Measurement, name: str) -> bool:
    return isinstance(getattr(measurement, name, None), np.ndarray)


def _c_type(column: Any) -> str:
    dtype = column.dtype
    if dtype.kind == "f":
        return "double"
    return f"{'int' if dtype.kind == 'i' else 'uint'}{8 * dtype.itemsize}_t"


def _writes(layout: Layout, values: dict[str, Any], block: str) -> list[str]:
    return [
        f"    put({block}, {placed.first_bit}, {placed.field.codec.bits}, "
        f"(uint64_t)({_expression(placed.field.codec, values.get(placed.field.name))}));"
        for placed in layout.placed
    ]


def _expression(codec: Codec, value: Any) -> str:
    """The raw number of a value in C."""
    if isinstance(codec, Constant):
        return str(codec.code)
    if isinstance(codec, Flag):
        return f"({value}) != 0"
    if isinstance(codec, Counter):
        return f"{value}"
    if isinstance(codec, Time):
        return f"ticks({value})"
    assert isinstance(codec, Number)
    limits = f"{codec.lowest}, {codec.highest}, {codec.none or 0}, {int(codec.nearest)}"
    if codec.whole:
        return f"whole(({value}) - {codec.offset}, {limits})"
    return f"steps({value}, {codec.steps_per_unit!r}, {limits})"


def _crc_table(crc: Crc) -> list[int]:
    assert (crc.bits, crc.reflected, crc.final_xor) == (16, False, 0)
    table = []
    for byte in range(256):
        register = byte << 8
        for _ in range(8):
            register = (register << 1 & 0xFFFF) ^ (crc.polynomial if register & 0x8000 else 0)
        table.append(register)
    return table


def main() -> None:
    """Print the times of all jobs."""
    costs = measure_protocol(ROUNDS)
    print("| | us | in C, called from Python, us |\n|---|---|---|")
    for cost in costs:
        compiled = "" if cost.compiled_s is None else f"{cost.compiled_s * 1e6:.2f}"
        print(f"| {cost.name} | {cost.time_s * 1e6:.2f} | {compiled} |")
    built = next(cost for cost in costs if cost.name == _BLOCK)
    assert built.compiled_s is not None
    print(f"ratio: {built.compiled_s / built.time_s:.3g} (time of an encoder in C to ours, {built.name})")


if __name__ == "__main__":
    command_line(__doc__).parse_args()
    main()
