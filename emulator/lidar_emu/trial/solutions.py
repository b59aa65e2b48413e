"""What the navigation of a flight computer stated: its solutions, as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.errors import Finding, InputError, listed
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.recording.readers import HostMessages
from lidar_emu.trajectory.table import read_csv
from lidar_protocol import Interface


class Trust(IntEnum):
    """What a navigation did with a value of a beam: names and codes of `trust` in the default interface."""

    NOT_JUDGED = 0
    USED = 1
    INVALID = 2
    GATED = 3
    INCONSISTENT = 4
    UNTIMELY = 5
    EXCLUDED = 6


REJECTED = (Trust.GATED, Trust.INCONSISTENT, Trust.UNTIMELY, Trust.EXCLUDED)
"""What a navigation does with a value that it could have used."""
_NAMES = {trust.name.lower(): trust for trust in Trust}
_TRUST_FIELDS = ("range_trust", "speed_trust")


class Solutions(NamedTuple):
    """Solutions in the order of their times of validity; NaN where the navigation stated no value.

    Positions and velocities are those of the body frame's origin in the site frame, east, north and up.
    """

    time_s: FloatArray
    """(n,) Time of validity, scenario time."""
    arrived_s: FloatArray
    """(n,) When the solution had arrived, scenario time; NaN if that is unknown."""
    altitude_m: FloatArray
    """(n,) Height above the ground straight below."""
    sigma_altitude_m: FloatArray
    """(n,) Its standard deviation, as the navigation states it."""
    position_site_m: FloatArray
    """(n, 3)"""
    sigma_position_m: FloatArray
    """(n, 3)"""
    velocity_site_mps: FloatArray
    """(n, 3)"""
    sigma_velocity_mps: FloatArray
    """(n, 3)"""
    range_trust: NDArray[np.int8]
    """(n, beams) A code of `Trust`."""
    speed_trust: NDArray[np.int8]
    """(n, beams) A code of `Trust`."""


_AXES = ("east", "north", "up")
_LARGEST = 1e12
COLUMNS = (
    "time_s",
    "arrived_s",
    *(f"{sigma}altitude_m" for sigma in ("", "sigma_")),
    *(f"{sigma}position_{axis}_m" for sigma in ("", "sigma_") for axis in _AXES),
    *(f"{sigma}velocity_{axis}_mps" for sigma in ("", "sigma_") for axis in _AXES),
)
"""Columns of a log of solutions; with `range_trust_0`, `speed_trust_0`, ... of the beams, words or codes of `Trust`."""


def trust_of_codes(interface: Interface, where: str) -> dict[str, dict[int, Trust]]:
    """What the codes of an interface mean, by the names of its enumerations, for each field of trust that it has.

    Args:
        interface: the interface in which a navigation answers.
        where: source of the interface, for the error message.

    Raises:
        InputError: it has no navigation message with a time, or codes of trust whose names are unknown.
    """
    messages = interface.commands.messages_by_name if interface.commands else {}
    if "navigation" not in messages or "time_ns" not in messages["navigation"].arguments:
        found = Finding("no message navigation with time_ns")
        raise InputError(where, "host_messages", found, "define it, or grade a log with --solutions")
    found_codes = {}
    for placed in messages["navigation"].packet.placed:
        name, enumeration = placed.field.name, placed.field.enumeration or ""
        if name in _TRUST_FIELDS:
            codes = interface.enumerations.get(enumeration, {})
            if "used" not in codes or not codes.keys() <= _NAMES.keys():
                stated = Finding(f"values of {name} are {listed(codes) or 'numbers without names'}")
                remedy = f"must be an enumeration with used, and no names but {listed(_NAMES)}"
                raise InputError(where, "host_messages.navigation", stated, remedy)
            found_codes[name] = {code: _NAMES[word] for word, code in codes.items()}
    return found_codes


def sent_solutions(sent: HostMessages, trusts: Mapping[str, Mapping[int, Trust]]) -> Solutions:
    """Solutions that the navigation sent during a recorded flight.

    Their times are on the device's clock; its offset at each arrival converts
    them to scenario time.

    Args:
        sent: messages `navigation`.
        trusts: meanings of the codes of trust, as from `trust_of_codes`.
    """
    values = {name: value for name, value in sent.values.items() if value.ndim == 1}
    for name, meanings in trusts.items():
        codes = sent.values[name].reshape(len(sent), -1)
        trust = np.full(codes.shape, Trust.NOT_JUDGED)
        for code, meaning in meanings.items():
            trust[codes == code] = meaning
        values |= {f"{name}_{beam}": trust[:, beam] for beam in range(trust.shape[1])}
    ahead_ns = sent.device_ns - sent.time_ns
    values["time_s"] = (values.pop("time_ns") - ahead_ns) * 1e-9
    values["arrived_s"] = sent.time_ns * 1e-9
    return from_columns(values)


def read_solutions(path: Path) -> Solutions:
    """Read a log of solutions, a CSV file whose header has names of `COLUMNS`.

    Raises:
        InputError: it cannot be read, or lacks `time_s`, or both altitude and velocity.
    """
    table = read_csv(str(path))
    if "time_s" not in table.header or not {"altitude_m", "velocity_up_mps"} & set(table.header):
        remedy = f"must have time_s, and altitude_m or velocities; known: {listed(COLUMNS)}"
        raise InputError(str(path), None, Finding(f"columns {listed(table.header)}"), remedy)
    return from_columns(
        {name: _numbers(path, name, table.cells(place)) for place, name in enumerate(table.header)}
    )


def _numbers(path: Path, name: str, cells: Sequence[str]) -> FloatArray:
    words = {"": np.nan} | {name: float(trust) for name, trust in _NAMES.items()}
    try:
        return np.array([words[cell] if cell in words else float(cell) for cell in cells])
    except ValueError as error:
        raise InputError(
            str(path), name, Finding(str(error)), "cells must be numbers, words of trust, or empty"
        ) from None


def from_columns(columns: Mapping[str, NDArray[Any]]) -> Solutions:
    """Solutions of columns by the names of `COLUMNS`, in the order of their times, without those that have none."""
    time_s = np.asarray(columns["time_s"], dtype=np.float64)
    order = np.argsort(time_s, kind="stable")[: np.count_nonzero(np.isfinite(time_s))]

    def column(name: str) -> FloatArray:
        value = np.asarray(columns.get(name, np.full(len(time_s), np.nan)), dtype=np.float64)[order]
        return np.where(np.abs(value) < _LARGEST, value, np.nan)

    def vector(name: str) -> FloatArray:
        return np.stack([column(name.format(axis)) for axis in _AXES], axis=1)

    def trust(quantity: str) -> NDArray[np.int8]:
        names = [name for name in columns if name.startswith(f"{quantity}_trust_")]
        codes = np.zeros((len(order), len(names)), dtype=np.int8)
        for beam in range(len(names)):
            code = column(f"{quantity}_trust_{beam}")
            codes[:, beam] = np.where((code >= 0) & (code <= max(Trust)), code, Trust.NOT_JUDGED)
        return codes

    return Solutions(
        column("time_s"),
        column("arrived_s"),
        column("altitude_m"),
        column("sigma_altitude_m"),
        vector("position_{}_m"),
        vector("sigma_position_{}_m"),
        vector("velocity_{}_mps"),
        vector("sigma_velocity_{}_mps"),
        trust("range"),
        trust("speed"),
    )
