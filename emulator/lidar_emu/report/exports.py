"""Export of a measurement for other tools: tables, arrays and point clouds."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.geometry_file import BLOCK_SHOTS, GeometryMetadata, GeometryWriter, conditions
from lidar_emu.echo.echoes import EchoModel
from lidar_emu.errors import Finding, InputError
from lidar_emu.files import check_destination, check_extra, check_suffix, whole_file
from lidar_emu.measurement import TABLE, Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.recording.captures import (
    RAW_IP,
    RTAC_SERIAL,
    SOCKETCAN,
    PcapWriter,
    can_record,
    serial_record,
    udp_record,
    write_log,
)
from lidar_emu.recording.traffic import Traffic
from lidar_emu.scenario.load import require_known_flight
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.transports.can_frames import unpack_frames
from lidar_emu.transports.spec import Kind
from lidar_protocol.definitions import ByteLink
from lidar_protocol.framing import LinkCounters
from lidar_protocol.headers import SpacePacketHeader
from lidar_protocol.packet import check_length

_PLY_VERTEX = np.dtype(
    [
        ("x", "<f8"),
        ("y", "<f8"),
        ("z", "<f8"),
        ("range_m", "<f4"),
        ("closing_speed_mps", "<f4"),
        ("beam", "u1"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
    ]
)
_GROUP_ROWS = 1 << 16
_PLY_TYPES = {"f8": "double", "f4": "float", "u1": "uchar"}
_DARK_TO_BRIGHT_RGB = np.array(
    [
        (68, 1, 84),
        (71, 45, 123),
        (59, 82, 139),
        (44, 114, 142),
        (33, 145, 140),
        (40, 174, 128),
        (94, 201, 98),
        (173, 220, 48),
        (253, 231, 37),
    ],
    dtype=float,
)
"""Evenly spaced stops of matplotlib's viridis, which needs no matplotlib here."""


def check_export_path(path: Path) -> None:
    """Check the path of an export before a long run.

    Raises:
        InputError: the suffix is unknown, the folder is missing or read-only, or `.parquet` lacks the extra `tables`.
    """
    check_suffix(path, _WRITERS)
    if path.suffix == ".parquet":
        check_extra(str(path), path.suffix, "pyarrow", "tables")
    check_destination(path)


def export(blocks: Iterable[Measurement], path: Path) -> None:
    """Write shots, block by block in order, in the format that the suffix of `path` names.

    `.csv`, `.npz` and `.parquet` hold the columns of `Measurement.table()`, one row per shot and beam. Missing
    values are empty cells in CSV, NaN in NPZ and nulls in Parquet. CSV has booleans as 1 and 0, and floats with all
    their digits. `.ply` holds the points with a valid range (binary, site frame: east, north, up in metres). CSV and
    Parquet are written as the blocks come; the other formats need all of them in memory.

    Raises:
        InputError: see `check_export_path`; or the suffix is `.ply` and the run is a bench pattern.
        RunError: writing failed.
    """
    check_export_path(path)
    if path.suffix == ".ply":
        whole = _whole(blocks)
        if np.isnan(whole.position_site_m).all():
            found = Finding("a bench pattern")
            raise InputError(str(path), None, found, "must be a flight: a bench pattern has no points")
        blocks = [whole]
    with whole_file(path) as file:
        _WRITERS[path.suffix](blocks, file)


def _write_csv(blocks: Iterable[Measurement], file: BinaryIO) -> None:
    text = io.TextIOWrapper(file, encoding="ascii", newline="")
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(TABLE)
    for block in blocks:
        rows.writerows(zip(*map(_cells, block.table().values()), strict=True))
    # Otherwise the wrapper would close the caller's file.
    text.detach()


def _cells(column: NDArray[np.generic]) -> list[object]:
    """Convert a column to Python values; the csv module writes floats by `repr` and None as an empty cell."""
    if column.dtype == np.bool_:
        return list(column.astype(np.uint8).tolist())
    if not np.issubdtype(column.dtype, np.floating):
        return list(column.tolist())
    return [None if value != value else value for value in column.tolist()]


def _write_npz(blocks: Iterable[Measurement], file: BinaryIO) -> None:
    columns: dict[str, Any] = {**_whole(blocks).table()}
    np.savez_compressed(file, **columns)


def _write_parquet(blocks: Iterable[Measurement], file: BinaryIO) -> None:
    import pyarrow as pa
    import pyarrow.parquet

    writer = None
    for part in _larger(blocks):
        # `from_pandas` turns NaN into null, so that queries skip missing values.
        table = pa.table({name: pa.array(column, from_pandas=True) for name, column in part.table().items()})
        writer = writer or pyarrow.parquet.ParquetWriter(file, table.schema)
        writer.write_table(table)
    if writer is not None:
        writer.close()


def _larger(blocks: Iterable[Measurement]) -> Iterator[Measurement]:
    """Join blocks to groups of rows: readers of Parquet load some columns of a whole group."""
    group: list[Measurement] = []
    for block in blocks:
        group.append(block)
        if sum(each.fired.size for each in group) >= _GROUP_ROWS:
            yield _whole(group)
            group.clear()
    if group:
        yield _whole(group)


def _whole(blocks: Iterable[Measurement]) -> Measurement:
    return Measurement.concatenate(list(blocks))


def _write_ply(blocks: Iterable[Measurement], file: BinaryIO) -> None:
    measurement = _whole(blocks)
    vertices = _vertices(measurement)
    properties = (
        f"property {_PLY_TYPES[_PLY_VERTEX[name].str[1:]]} {name}" for name in _PLY_VERTEX.names or ()
    )
    header = (
        "ply",
        "format binary_little_endian 1.0",
        "comment site frame: x east, y north, z up, in metres",
        f"element vertex {len(vertices)}",
        *properties,
        "end_header\n",
    )
    file.write("\n".join(header).encode())
    file.write(vertices.tobytes())


def _vertices(measurement: Measurement) -> NDArray[np.void]:
    """(points,) Vertices of type `_PLY_VERTEX`, ordered by shot and beam."""
    valid = measurement.range_valid
    vertices = np.empty(np.count_nonzero(valid), dtype=_PLY_VERTEX)
    vertices["x"], vertices["y"], vertices["z"] = measurement.point_site_m[valid].T
    vertices["range_m"] = measurement.range_m[valid]
    vertices["closing_speed_mps"] = measurement.closing_speed_mps[valid]
    vertices["beam"] = np.nonzero(valid)[1]
    vertices["red"], vertices["green"], vertices["blue"] = dark_to_bright_rgb(measurement.range_m[valid]).T
    return vertices


def dark_to_bright_rgb(values: FloatArray, span: tuple[float, float] | None = None) -> NDArray[np.uint8]:
    """(points, 3) Red, green and blue, from dark at the least value to bright at the greatest.

    Args:
        values: (points,)
        span: least and greatest value; None: the least and greatest of the points.
    """
    if values.size == 0:
        return np.empty((0, 3), dtype=np.uint8)
    least, greatest = (values.min(), values.max()) if span is None else span
    share = (values - least) / max(greatest - least, np.finfo(float).tiny)
    stops = np.linspace(0, 1, len(_DARK_TO_BRIGHT_RGB))
    channels = [np.interp(share, stops, channel) for channel in _DARK_TO_BRIGHT_RGB.T]
    return np.stack(channels, axis=1).round().astype(np.uint8)


_WRITERS: dict[str, Callable[[Iterable[Measurement], BinaryIO], None]] = {
    ".csv": _write_csv,
    ".npz": _write_npz,
    ".parquet": _write_parquet,
    ".ply": _write_ply,
}
SUFFIXES = tuple(_WRITERS)
"""Suffixes of the files that `export` writes."""


_CAPTURE, _PACKETS, _LOGS = ".pcap", ".ccsds", (".log", ".asc", ".blf")
WIRE_SUFFIXES = (_CAPTURE, _PACKETS, *_LOGS)


def check_wire_file(path: Path, option: str = "--to") -> None:
    """Check the path of an export.

    Raises:
        InputError: the file cannot be written, or its suffix is unknown.
    """
    check_destination(path, option)
    if path.suffix.lower() not in WIRE_SUFFIXES:
        raise InputError(
            option,
            None,
            str(path),
            f"must end with {_CAPTURE}, {_PACKETS} or, for a CAN bus, {', '.join(_LOGS)}",
        )


def write_wire_file(traffic: Traffic, path: Path) -> str:
    """Write packets with their times in UTC, and return a line that says how many.

    A `.pcap` has nanosecond times, and holds SocketCAN frames, datagrams or the bytes of a serial line. `.log`, `.asc`
    and `.blf` hold the frames of a CAN bus. `.ccsds` holds space packets one after another, without framing and times;
    a packet that does not have the length that it states is left out, because no reader would find the next one.

    Raises:
        InputError: the file is a log of a CAN bus, and the traffic is not; or it is for space packets, and the traffic
            has none.
        RunError: writing failed.
    """
    suffix, count = path.suffix.lower(), len(traffic.packets)
    if suffix == _PACKETS:
        link = _link_of_space_packets(traffic, path)
        with whole_file(path) as file:
            whole = _write_packets(traffic, link, file)
        left_out = f", {count - whole} left out: damaged" if whole < count else ""
        return f"{path}: {whole} packets{left_out}"
    packets = ((traffic.start_ns + time_ns, payload) for time_ns, payload in traffic.packets)
    if suffix == _CAPTURE:
        with whole_file(path) as file:
            _write_capture(traffic, packets, file)
    elif traffic.is_can:
        write_log(path, packets)
    else:
        found = Finding("a log of a CAN bus for a run without one")
        raise InputError(str(path), None, found, f"write a file {_CAPTURE}")
    return f"{path}: {count} packets"


def _link_of_space_packets(traffic: Traffic, path: Path) -> ByteLink:
    if traffic.recording is None or traffic.is_can:
        found = Finding("traffic of CAN" if traffic.is_can else "a capture, which does not say its framing")
        raise InputError(str(path), None, found, "must be a recording of a byte link")
    link = traffic.recording.interface.link
    if not isinstance(link.header, SpacePacketHeader):
        raise InputError(
            str(path), None, Finding("packets with a custom header"), "must be a recording of space packets"
        )
    return link


def _write_packets(traffic: Traffic, link: ByteLink, file: BinaryIO) -> int:
    longest = max(len(payload) for _, payload in traffic.packets)
    reader = link.framing.reader(longest, partial(check_length, link), LinkCounters())
    return sum(file.write(packet) > 0 for _, payload in traffic.packets for packet in reader.receive(payload))


def _write_capture(traffic: Traffic, packets: Iterable[tuple[int, bytes]], file: BinaryIO) -> None:
    if traffic.is_can:
        writer = PcapWriter(file, SOCKETCAN)
        for time_ns, payload in packets:
            for frame in unpack_frames(payload):
                writer.write(time_ns, can_record(frame))
        return
    port = None if traffic.recording is None else traffic.recording.port
    if port is not None and port.kind is Kind.UDP:
        writer = PcapWriter(file, RAW_IP)
        for time_ns, payload in packets:
            writer.write(time_ns, udp_record(port.path, payload))
        return
    writer = PcapWriter(file, RTAC_SERIAL)
    for time_ns, payload in packets:
        writer.write(time_ns, serial_record(time_ns, payload))


def record_geometry(scenario: FlightScenario, path: Path) -> GeometryMetadata:
    """Write the geometry of a flight, a block at a time.

    All beamlets of the instrument are written, including those that the plan leaves out: another instrument may need
    them. Where the plan samples the footprint by more, all of these are.

    Returns:
        The metadata of the file.

    Raises:
        InputError: the flight cannot be built, is live, or `path` cannot be written.
        RunError: writing failed on the way.
    """
    require_known_flight(scenario)
    model = FlightModel(scenario)
    beamlets = max(model.plan.beamlets, scenario.instrument.optics.beamlets)
    flight = model.flight
    metadata = GeometryMetadata(
        shots=flight.shot_count,
        beams=model.beam_count,
        beamlets=beamlets,
        moving=flight.has_moving_objects,
        name=scenario.name,
        conditions=conditions(scenario),
    )
    echo_model = EchoModel(scenario.instrument, scenario.site, flight, beamlets)
    state = model.initial_state
    with whole_file(path) as file:
        writer = GeometryWriter(file, metadata)
        for first in range(0, flight.shot_count, BLOCK_SHOTS):
            shot = np.arange(first, min(first + BLOCK_SHOTS, flight.shot_count), dtype=np.int64)
            pointing, state = model.aim(shot, state, follows_chirps=True)
            axis_hits = flight.cast(pointing)
            writer.add(pointing, axis_hits, echo_model.cast_beamlets(pointing, axis_hits))
        writer.close()
    return metadata
