"""The folder of a campaign: its description, its finished batches, and a lock that admits one process at a time."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from lidar_emu._version import __version__
from lidar_emu.campaign.batch import part_path
from lidar_emu.campaign.read import PreparedCampaign
from lidar_emu.errors import Finding, InputError, reason_of
from lidar_emu.files import read_bytes, whole_file
from lidar_emu.recording.provenance import hashed_files

_TABLES = ("runs", "beams")
_STATED = "campaign.json"
_MOST_BYTES = 10_000_000


@contextmanager
def campaign_folder(folder: Path, prepared: PreparedCampaign, batch_runs: int) -> Iterator[None]:
    """Create the folder, or continue one that holds part of the same campaign, and lock it meanwhile.

    Raises:
        InputError: the folder holds something else, cannot be created, or is in use by another process.
    """
    stated = _statement(prepared, batch_runs)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / _STATED).exists() and any(entry.name != ".lock" for entry in folder.iterdir()):
            raise InputError("--out", None, Finding(f"{folder} holds other files"), _ALLOWED)
        lock = FileLock(folder / ".lock").acquire(blocking=False)
    except Timeout:
        raise InputError(
            "--out", None, Finding(f"{folder} is in use"), "must be one campaign command at a time"
        ) from None
    except (OSError, ValueError) as error:
        reason = Finding(f"{folder}: {reason_of(error)}")
        raise InputError("--out", None, reason, "must be a writable folder") from None
    with lock:
        _claim(folder, stated)
        _sweep(folder)
        try:
            yield
        finally:
            _sweep(folder)


_ALLOWED = "must be a new or empty folder, or the folder of the same campaign, which is then continued"


def _claim(folder: Path, stated: dict[str, Any]) -> None:
    path = folder / _STATED
    if path.exists():
        try:
            before = json.loads(read_bytes(path, _MOST_BYTES, _ALLOWED))
        except (ValueError, RecursionError):
            before = None
        if before != stated:
            raise InputError("--out", None, Finding(f"{folder} {_difference(before, stated)}"), _ALLOWED)
    for table in _TABLES:
        (folder / table).mkdir(exist_ok=True)
    if not path.exists():
        with whole_file(path) as file:
            file.write(json.dumps(stated, indent=2).encode() + b"\n")


def _sweep(folder: Path) -> None:
    """Delete partial files left by processes that died."""
    for table in _TABLES:
        for left_over in (folder / table).glob(".part-*"):
            left_over.unlink(missing_ok=True)


def _difference(before: Any, stated: dict[str, Any]) -> str:
    if not isinstance(before, dict):
        return f"has a {_STATED} that cannot be read"
    return f"holds another campaign (different: {', '.join(_differing(before, stated))})"


def _differing(before: Any, stated: Any) -> Iterator[str]:
    """Yield the dotted keys of values that differ, descending where both are mappings."""
    for key in dict.fromkeys((*stated, *before)):
        then, now = before.get(key), stated.get(key)
        if isinstance(then, dict) and isinstance(now, dict):
            yield from (f"{key}.{below}" for below in _differing(then, now))
        elif then != now:
            yield key


def _statement(prepared: PreparedCampaign, batch_runs: int) -> dict[str, Any]:
    """Describe everything that determines the contents of the folder's files."""
    campaign = json.loads(prepared.campaign.model_dump_json())
    return {
        "lidar_emu": __version__,
        "name": campaign["name"],
        "campaign": campaign,
        "runs_per_file": batch_runs,
        "first_run": json.loads(prepared.first.model_dump_json()),
        "files_sha256": dict(hashed_files(prepared.first)),
    }


def finished_batches(folder: Path, batches: int) -> set[int]:
    """Numbers of the batches with stored runs."""
    return {number for number in range(batches) if part_path(folder, "runs", number).exists()}
