"""The scenario keys on which a recorded geometry depends.

The file is an uncompressed `.npz`, which numpy opens directly. It holds the entry `about`, JSON text, and for each
block of shots the arrays of `Pointing`, of the axes' hits and of the beamlets' hits, named `BLOCK.PART.FIELD`. Blocks
are written in order and the table of contents last, so that a truncated file is detected.
"""

from __future__ import annotations

import json
import tokenize
import weakref
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from math import prod
from pathlib import Path
from typing import Annotated, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, TypeAdapter

from lidar_emu.beams.edges import CutBeams, Cuts
from lidar_emu.beams.pointing import Pointing
from lidar_emu.errors import Finding, InputError
from lidar_emu.files import check_file
from lidar_emu.scenario.faults.beams import Misalignment
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scene.ray_hits import Hits

FORMAT, VERSION = "lidar-emu geometry", 4
BLOCK_SHOTS = 1024

_ABOUT = "about"
_COMPLETE = "use a complete file from lidar-emu simulate --geometry-out"
_SHOTS_AXIS = {"beams": 1, "vehicle": 1, "at_chirps": 2}
"""Index of the shots axis in the fields of `Pointing` that do not begin with it."""
_RANGE_BYTES = 8
"""Size of the range of a ray in the file."""
_UNREADABLE = (
    *(OSError, ValueError, KeyError, TypeError, EOFError, RecursionError),
    *(zipfile.BadZipFile, zlib.error, SyntaxError, tokenize.TokenError),
)


_Count = Annotated[int, Field(gt=0, lt=2**63)]


@dataclass(frozen=True)
class GeometryMetadata:
    """The metadata of a geometry file, its entry `about`."""

    shots: _Count
    beams: _Count
    beamlets: _Count
    """Rays per beam with recorded hits; 1: the axis alone."""
    moving: bool
    """Whether hits include surface velocities."""
    edges: bool
    """Whether cells of beamlets may be cut."""
    name: str
    """Name of the scenario."""
    conditions: dict[str, Any]
    """Keys and values on which the geometry depends, see `conditions`."""


class GeometryWriter:
    """Writes the geometry of a flight, a block of shots at a time."""

    def __init__(self, file: BinaryIO, metadata: GeometryMetadata) -> None:
        self._metadata = metadata
        self._blocks = 0
        self._archive = zipfile.ZipFile(file, "w", zipfile.ZIP_STORED)
        entry = {"format": FORMAT, "version": VERSION, "block_shots": BLOCK_SHOTS, **asdict(metadata)}
        self._write(_ABOUT, np.array(json.dumps(entry)))

    def add(
        self, pointing: Pointing, axis_hits: Hits, beamlet_hits: Hits, cut_beams: CutBeams | None
    ) -> None:
        """Write the next `BLOCK_SHOTS` shots, or the rest; `beamlet_hits` (rays,) of a single beamlet are left out."""
        parts: dict[str, Pointing | Hits | Cuts] = {"pointing": pointing, "axis": axis_hits}
        if self._metadata.beamlets > 1:
            parts["beamlets"] = beamlet_hits.shaped((*axis_hits.range_m.shape, self._metadata.beamlets))
        if self._metadata.edges:
            none = Cuts.unfilled(0, self._metadata.beamlets), Hits.empty(0, self._metadata.moving)
            parts["cuts"], parts["cut_hits"] = cut_beams or none
        for part, arrays in parts.items():
            for field, array in arrays._asdict().items():
                self._write(f"{self._blocks}.{part}.{field}", array)
        self._blocks += 1

    def close(self) -> None:
        """Write the table of contents; a file without one cannot be read."""
        self._archive.close()

    def _write(self, name: str, array: NDArray[Any]) -> None:
        with self._archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
            np.lib.format.write_array(entry, array, allow_pickle=False)


class GeometryFile:
    """A file written by `GeometryWriter`.

    Raises:
        InputError: the file is missing, truncated, damaged, of another format or another version; all methods that
            read from it raise this as well.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        check_file(path, _COMPLETE)
        with self._readable():
            stream = path.open("rb")
            weakref.finalize(self, stream.close)
            self._size_bytes = path.stat().st_size
            self._archive: Any = np.load(stream, allow_pickle=False)
            about = str(self._array(_ABOUT))
            entry = json.loads(about)
            if entry["format"] != FORMAT:
                raise ValueError(entry["format"])
            version = entry["version"]
        if version != VERSION:
            remedy = f"must be {VERSION}: record the geometry again"
            raise InputError(str(path), "version", version, remedy)
        with self._readable():
            self._block_shots = TypeAdapter(_Count).validate_python(entry["block_shots"], strict=True)
            self.metadata = TypeAdapter(GeometryMetadata).validate_json(about, strict=True)
            rays = self.metadata.shots * self.metadata.beams * self.metadata.beamlets
            if rays * _RANGE_BYTES > self._size_bytes:
                raise ValueError(rays)
        self._latest: dict[str, tuple[int, Any]] = {}

    def pointing(self, shot: NDArray[np.int64]) -> Pointing:
        """Read the beams of these shots, given in ascending order."""
        pointing: Pointing = self._rows("pointing", shot)
        return pointing

    def axis_hits(self, shot: NDArray[np.int64]) -> Hits:
        """Read the hits of the beam axes, (shots, beams)."""
        hits: Hits = self._rows("axis", shot)
        return hits

    def beamlet_hits(self, shot: NDArray[np.int64], hits: Hits) -> Hits:
        """Fill `hits` (rays,) of the beamlets, grouped by beam, from a file with more than one beamlet per beam."""
        arrays: tuple[NDArray[Any], ...] = hits
        for values, recorded in zip(arrays, self._rows("beamlets", shot), strict=True):
            values[:] = recorded.reshape(values.shape)
        return hits

    def cut_beams(self, shot: NDArray[np.int64]) -> CutBeams | None:
        """Read the beams of these shots with cells that are cut."""
        beams, columns = self.metadata.beams, 2 * self.metadata.beamlets
        cuts_of, hits_of = [], []
        for number in np.unique(shot // self._block_shots).tolist():
            cuts, hits = self._block("cuts", number), self._block("cut_hits", number)
            cut_shot = number * self._block_shots + cuts.beam // beams
            chosen = np.isin(cut_shot, shot)
            if not chosen.any():
                continue
            row = np.searchsorted(shot, cut_shot[chosen])
            cuts_of.append((row * beams + cuts.beam[chosen] % beams, cuts.weight[chosen], cuts.place[chosen]))
            hits_of.append(hits.shaped((len(chosen), columns)).chosen(chosen))
        if not cuts_of:
            return None
        cuts = Cuts(*map(np.concatenate, zip(*cuts_of, strict=True)))
        hits = Hits(*map(np.concatenate, zip(*hits_of, strict=True)))
        return cuts, hits.shaped((len(cuts.beam) * columns,))

    def _rows(self, part: str, shot: NDArray[np.int64]) -> Any:
        pieces = []
        for number in np.unique(shot // self._block_shots).tolist():
            block = self._block(part, number)
            rows = shot[shot // self._block_shots == number] - number * self._block_shots
            pieces.append(
                [
                    np.take(array, rows, _SHOTS_AXIS.get(field, 0)) if array.size else array
                    for field, array in block._asdict().items()
                ]
            )
        fields = zip(block._fields, zip(*pieces, strict=True), strict=True)
        return type(block)(*(np.concatenate(arrays, _SHOTS_AXIS.get(field, 0)) for field, arrays in fields))

    def _block(self, part: str, number: int) -> Any:
        latest, block = self._latest.get(part, (-1, None))
        if latest != number:
            like = self._unfilled(part, number)
            with self._readable():
                arrays = [self._array(f"{number}.{part}.{field}") for field in like._fields]
                # Kernels do not check types and shapes.
                if [(a.dtype, a.shape) for a in arrays] != [(a.dtype, a.shape) for a in like]:
                    raise ValueError(part)
            block = type(like)(*arrays)
            self._latest[part] = number, block
        return block

    def _array(self, name: str) -> NDArray[Any]:
        """Read an entry; entries are not compressed, so that none is larger than the file."""
        if self._archive.zip.getinfo(f"{name}.npy").file_size > self._size_bytes:
            raise ValueError(name)
        array: NDArray[Any] = self._archive[name]
        return array

    def _unfilled(self, part: str, number: int) -> Any:
        first, metadata = number * self._block_shots, self.metadata
        shot = np.arange(first, min(first + self._block_shots, metadata.shots), dtype=np.int64)
        if part == "pointing":
            return Pointing.unfilled(shot, metadata.beams, follows_chirps=True)
        if part in ("cuts", "cut_hits"):
            with self._readable():
                cut = len(self._array(f"{number}.cuts.beam"))
            cuts = Cuts.unfilled(cut, metadata.beamlets)
            return cuts if part == "cuts" else Hits.empty(cuts.weight.size, metadata.moving)
        rays = (metadata.beamlets,) if part == "beamlets" else ()
        shape = (len(shot), metadata.beams, *rays)
        return Hits.empty(prod(shape), metadata.moving).shaped(shape)

    @contextmanager
    def _readable(self) -> Iterator[None]:
        try:
            yield
        except _UNREADABLE:
            found = Finding("no recorded geometry, or a truncated or damaged file")
            raise InputError(str(self.path), None, found, _COMPLETE) from None


_OF_LIGHT = ("name", "surface.lommel_seeliger_share", "atmosphere", "sunlight_w_per_m2_um")
"""Keys of a site that do not affect its geometry. Reflectance counts as geometry: it is recorded with each hit."""

_ABSENT = "nothing"


def conditions(scenario: FlightScenario) -> dict[str, Any]:
    """List the keys and JSON values on which a scenario's geometry depends.

    A file counts by its name without its folder: the recording holds the geometry of its contents at that time.
    """
    instrument, tree = scenario.instrument, scenario.model_dump(mode="json")
    tilts = {place: fault for place, fault in enumerate(scenario.faults) if isinstance(fault, Misalignment)}
    parts = {
        "timing": {"rate_hz": scenario.timing.rate_hz},
        "instrument": {
            "waveform": {
                "wavelength_m": instrument.waveform.wavelength_m,
                "segment_time_s": instrument.waveform.segment_time_s,
                "fft_length / sample_rate_hz": instrument.waveform.record_time_s,
            },
            "optics": {"waist_radius_m": instrument.optics.waist_radius_m},
            "detection": {"looks": instrument.detection.looks},
        },
        "scanner": tree["scanner"],
        "mounting": tree["mounting"],
        "trajectory": tree["trajectory"],
        "site": tree["site"],
        "faults": {str(place): fault.model_dump(mode="json") for place, fault in tilts.items()},
    }
    if any(fault.probability < 1 for fault in tilts.values()):
        parts["seed"] = scenario.seed  # determines when they act
    of_light = tuple(f"site.{key}" for key in _OF_LIGHT)
    return {key: value for key, value in _leaves(parts) if not key.startswith(of_light)}


def require_same(scenario: FlightScenario, recorded: dict[str, Any], file: str) -> None:
    """Refuse a scenario with a different geometry.

    Raises:
        InputError: names the first key that differs.
    """
    current = conditions(scenario)
    for key in [*current, *(key for key in recorded if key not in current)]:
        here, there = current.get(key, _ABSENT), recorded.get(key, _ABSENT)
        if here != there:
            if here is _ABSENT:
                raise InputError(scenario.name, key, Finding("missing"), f"state {there}, as in {file}")
            remedy = f"leave it out, as in {file}" if there is _ABSENT else f"must be {there}, as in {file}"
            raise InputError(scenario.name, key, here, remedy)


def _leaves(tree: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(tree, list) and any(isinstance(item, dict) for item in tree):
        tree = {str(place): item for place, item in enumerate(tree)}
    if isinstance(tree, dict):
        for name, value in tree.items():
            yield from _leaves(value, f"{key}.{name}" if key else name)
    elif tree is not None:
        is_file = key.endswith(".file") and isinstance(tree, str)
        yield key, Path(tree).name if is_file else tree
