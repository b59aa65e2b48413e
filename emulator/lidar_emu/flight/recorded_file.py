"""The file of a recorded geometry; docs/geometry.md describes it.

An uncompressed `.npz`, which numpy reads as it is: `about`, JSON text, and for each block of shots the arrays of
`Pointing`, of the axes' hits and of the beamlets' hits, named `BLOCK.PART.FIELD`. It is written block by block; its
table of contents comes last, so that a file that was cut is known as such.
"""

from __future__ import annotations

import json
import weakref
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from math import prod
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from lidar_emu.errors import Finding, InputError
from lidar_emu.flight.pointing import Pointing
from lidar_emu.scene.ray_hits import Hits

FORMAT, VERSION = "lidar-emu geometry", 1
BLOCK_SHOTS = 1024

_ABOUT = "about"
_SHOTS_AXIS = {"beams": 1, "vehicle": 1}
"""Of the fields of `Pointing` whose first axis is not that of shots."""
_UNREADABLE = (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error)


@dataclass(frozen=True)
class About:
    """What a file says of itself."""

    shots: int
    beams: int
    beamlets: int
    """Rays of each beam whose hits are there; 1: the axis alone."""
    moving: bool
    """Whether hits tell of velocities."""
    name: str
    """Of the scenario that was flown."""
    conditions: dict[str, Any]
    """What the geometry depends on, see `conditions`."""


class GeometryWriter:
    """Writes blocks of shots as they come."""

    def __init__(self, file: BinaryIO, about: About) -> None:
        self._about = about
        self._blocks = 0
        self._archive = zipfile.ZipFile(file, "w", zipfile.ZIP_STORED)
        told = {"format": FORMAT, "version": VERSION, "block_shots": BLOCK_SHOTS, **asdict(about)}
        self._write(_ABOUT, np.array(json.dumps(told)))

    def add(self, pointing: Pointing, axis_hits: Hits, beamlet_hits: Hits) -> None:
        """The next `BLOCK_SHOTS` shots, or what is left; `beamlet_hits` (rays,) of a single beamlet are left out."""
        parts: dict[str, Pointing | Hits] = {"pointing": pointing, "axis": axis_hits}
        if self._about.beamlets > 1:
            parts["beamlets"] = beamlet_hits.shaped((*axis_hits.range_m.shape, self._about.beamlets))
        for part, arrays in parts.items():
            for field, array in arrays._asdict().items():
                self._write(f"{self._blocks}.{part}.{field}", array)
        self._blocks += 1

    def close(self) -> None:
        """Write the table of contents, without which nothing can be read."""
        self._archive.close()

    def _write(self, name: str, array: NDArray[Any]) -> None:
        with self._archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
            np.lib.format.write_array(entry, array, allow_pickle=False)


class GeometryFile:
    """A file that was written by `GeometryWriter`.

    Raises:
        InputError: it is none, was cut, is damaged, or of another version; also when it is read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.is_file():
            raise InputError(str(path), None, Finding("no such file"), "allowed: what --geometry-out wrote")
        with self._readable():
            stream = path.open("rb")
            weakref.finalize(self, stream.close)
            self._archive: Any = np.load(stream, allow_pickle=False)
            told = json.loads(str(self._archive[_ABOUT]))
            if told["format"] != FORMAT:
                raise ValueError(told["format"])
        if told["version"] != VERSION or told["block_shots"] < 1:
            allowed = f"allowed: version {VERSION}; record it again"
            raise InputError(str(path), "version", told["version"], allowed)
        self._block_shots: int = told["block_shots"]
        with self._readable():
            self.about = About(**{name: told[name] for name in About.__dataclass_fields__})
        self._latest: dict[str, tuple[int, Any]] = {}

    def pointing(self, shot: NDArray[np.int64]) -> Pointing:
        """Of these shots, in rising order."""
        pointing: Pointing = self._rows("pointing", shot)
        return pointing

    def axis_hits(self, shot: NDArray[np.int64]) -> Hits:
        """(shots, beams) Of the beams' axes."""
        hits: Hits = self._rows("axis", shot)
        return hits

    def beamlet_hits(self, shot: NDArray[np.int64], hits: Hits) -> Hits:
        """Fill `hits` (rays,) of the beamlets, one beam after another, where the file has more than one a beam."""
        arrays: tuple[NDArray[Any], ...] = hits
        for values, recorded in zip(arrays, self._rows("beamlets", shot), strict=True):
            values[:] = recorded.reshape(values.shape)
        return hits

    def _rows(self, part: str, shot: NDArray[np.int64]) -> Any:
        pieces = []
        for number in np.unique(shot // self._block_shots).tolist():
            block = self._block(part, number)
            rows = shot[shot // self._block_shots == number] - number * self._block_shots
            pieces.append([_taken(field, array, rows) for field, array in block._asdict().items()])
        joined = zip(block._fields, zip(*pieces, strict=True), strict=True)
        return type(block)(*(np.concatenate(each, _SHOTS_AXIS.get(field, 0)) for field, each in joined))

    def _block(self, part: str, number: int) -> Any:
        """A part of a block, kept until another one is asked for."""
        latest, block = self._latest.get(part, (-1, None))
        if latest != number:
            like = self._unfilled(part, number)
            with self._readable():
                arrays = [self._archive[f"{number}.{part}.{field}"] for field in like._fields]
                # Kernels trust them.
                if [(a.dtype, a.shape) for a in arrays] != [(a.dtype, a.shape) for a in like]:
                    raise ValueError(part)
            block = type(like)(*arrays)
            self._latest[part] = number, block
        return block

    def _unfilled(self, part: str, number: int) -> Any:
        """Arrays of the kind and shape that a part of a block has."""
        first, about = number * self._block_shots, self.about
        shot = np.arange(first, min(first + self._block_shots, about.shots), dtype=np.int64)
        if part == "pointing":
            return Pointing.unfilled(shot, about.beams)
        each = (about.beamlets,) if part == "beamlets" else ()
        shape = (len(shot), about.beams, *each)
        return Hits.empty(prod(shape), about.moving).shaped(shape)

    @contextmanager
    def _readable(self) -> Iterator[None]:
        try:
            yield
        except _UNREADABLE:
            found = Finding("no recorded geometry, or one that was cut or damaged")
            allowed = "allowed: a whole file from lidar-emu simulate --geometry-out"
            raise InputError(str(self.path), None, found, allowed) from None


def _taken(field: str, array: NDArray[Any], rows: NDArray[np.int64]) -> NDArray[Any]:
    """Some of the shots of a field; of one that is left empty nothing."""
    return np.take(array, rows, _SHOTS_AXIS.get(field, 0)) if array.size else array
