"""Cyclic redundancy checks, by the names of the catalogue of parametrised CRC algorithms.

The standard library computes the polynomials that it has in C: a fraction of a microsecond for a packet. The others
use a table in Python, about 0.1 us per byte.
"""

from __future__ import annotations

import binascii
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Final


@dataclass(frozen=True)
class Crc:
    """Parameters of a CRC algorithm."""

    name: str
    bits: int
    polynomial: int
    start: int
    reflected: bool
    """Input and output are reflected: bytes are processed from their least significant bit."""
    final_xor: int
    check: int
    """CRC of the ASCII text 123456789."""

    @property
    def length(self) -> int:
        """Length of the CRC in bytes."""
        return self.bits // 8

    @property
    def function(self) -> Callable[[bytes], int]:
        """Function from data to CRC."""
        match self.name:
            case "crc16_ccitt_false":
                return lambda data: binascii.crc_hqx(data, 0xFFFF)
            case "crc16_xmodem":
                return lambda data: binascii.crc_hqx(data, 0)
            case "crc16_x25":
                return _x25
            case "crc32":
                return binascii.crc32
        return self.by_table

    def by_table(self, data: bytes) -> int:
        """Compute the CRC of `data` byte by byte."""
        table, crc, down = table_of(self), self.start, self.bits - 8
        if self.reflected:
            for byte in data:
                crc = crc >> 8 ^ table[(crc ^ byte) & 0xFF]
            return crc ^ self.final_xor
        mask = (1 << self.bits) - 1
        for byte in data:
            crc = crc << 8 & mask ^ table[crc >> down ^ byte]
        return crc ^ self.final_xor


_REFLECTED: Final = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
"""Bytes with reversed order of bits."""


def _x25(data: bytes) -> int:
    """CRC-16/X-25: CRC-16/CCITT-FALSE over reflected bytes, reflected and inverted."""
    crc = binascii.crc_hqx(data.translate(_REFLECTED), 0xFFFF)
    return (_REFLECTED[crc & 0xFF] << 8 | _REFLECTED[crc >> 8]) ^ 0xFFFF


@cache
def table_of(crc: Crc) -> tuple[int, ...]:
    """Table of the register after each byte."""
    return tuple(_reflected_entry(crc, byte) if crc.reflected else _entry(crc, byte) for byte in range(256))


def _entry(crc: Crc, byte: int) -> int:
    top, mask, register = 1 << crc.bits - 1, (1 << crc.bits) - 1, byte << crc.bits - 8
    for _ in range(8):
        register = (register << 1 ^ (crc.polynomial if register & top else 0)) & mask
    return register


def _reflected_entry(crc: Crc, byte: int) -> int:
    polynomial, register = int(f"{crc.polynomial:0{crc.bits}b}"[::-1], 2), byte
    for _ in range(8):
        register = register >> 1 ^ (polynomial if register & 1 else 0)
    return register


CRCS: Final = {
    crc.name: crc
    for crc in (
        Crc("crc8", 8, 0x07, 0, False, 0, 0xF4),
        Crc("crc16_ccitt_false", 16, 0x1021, 0xFFFF, False, 0, 0x29B1),
        Crc("crc16_xmodem", 16, 0x1021, 0, False, 0, 0x31C3),
        Crc("crc16_modbus", 16, 0x8005, 0xFFFF, True, 0, 0x4B37),
        Crc("crc16_x25", 16, 0x1021, 0xFFFF, True, 0xFFFF, 0x906E),
        Crc("crc32", 32, 0x04C11DB7, 0xFFFFFFFF, True, 0xFFFFFFFF, 0xCBF43926),
        Crc("crc32c", 32, 0x1EDC6F41, 0xFFFFFFFF, True, 0xFFFFFFFF, 0xE3069283),
    )
}
"""Algorithms that an interface definition can name."""
