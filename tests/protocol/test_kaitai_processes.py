"""The classes that remove the stuffing in code of Kaitai Struct do what this project's decoders do."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from importlib.resources import files
from itertools import chain, product
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from waiting import LIMIT_S

from lidar_icd.kaitai.lidar_cobs import LidarCobs
from lidar_icd.kaitai.lidar_slip import LidarSlip
from lidar_protocol import cobs, slip
from lidar_protocol.errors import DecodeError

KINDS = {"cobs": (LidarCobs().decode, cobs), "slip": (LidarSlip().decode, slip)}
LENGTHS = 0, 1, 2, 253, 254, 255, 256, 507, 508, 509
SPECIAL = b"\0\1\2\xc0\xdb\xdc\xdd\xff"
MAIN = """#include <iostream>
#include <iterator>
#include "lidar_{kind}.h"

/* Decode the frames on the input, each behind its length in two bytes, and write each behind its length. */
int main() {{
    const std::string all((std::istreambuf_iterator<char>(std::cin)), std::istreambuf_iterator<char>());
    lidar_{kind}_t process;
    for (std::size_t place = 0; place < all.size();) {{
        const std::size_t length = static_cast<unsigned char>(all[place]) * 256u
            + static_cast<unsigned char>(all[place + 1]);
        const std::string decoded = process.decode(all.substr(place + 2, length));
        std::cout.put(static_cast<char>(decoded.size() >> 8)).put(static_cast<char>(decoded.size())) << decoded;
        place += 2 + length;
    }}
}}
"""


def expected(decode: Callable[[bytes], bytes], stuffed: bytes) -> bytes:
    try:
        return decode(stuffed)
    except DecodeError:
        return b""


@pytest.mark.parametrize("kind", KINDS)
@given(data=st.data())
def test_any_bytes(kind: str, data: st.DataObject) -> None:
    decode, own = KINDS[kind]
    special = st.sampled_from(SPECIAL)
    stuffed = bytes(data.draw(st.lists(special | st.integers(0, 255)))).replace(own.DELIMITER, b"")
    assert decode(stuffed) == expected(own.decode, stuffed)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("length", LENGTHS)
def test_runs_of_every_length(kind: str, length: int) -> None:
    decode, own = KINDS[kind]
    for packet in (b"\1" * length, b"\1" * length + b"\0", b"\0" + b"\xdb" * length):
        assert decode(own.encode(packet)) == packet


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("c++") is None, reason="not installed: c++")
@pytest.mark.parametrize("kind", KINDS)
def test_the_header_for_cpp_decodes_the_same(kind: str, tmp_path: Path) -> None:
    decode, own = KINDS[kind]
    shutil.copy(str(files("lidar_icd.kaitai") / f"lidar_{kind}.h"), tmp_path)
    (tmp_path / "main.cpp").write_text(MAIN.format(kind=kind))
    flags = "-std=c++98", "-Wall", "-Wextra", "-Werror", "-pedantic"
    subprocess.run(["c++", *flags, "-o", "decode", "main.cpp"], cwd=tmp_path, check=True, timeout=LIMIT_S)
    short = (bytes(each) for each in product(set(SPECIAL) - {own.DELIMITER[0]}, repeat=4))
    cases = [*short, *(own.encode(b"\1" * length + b"\0") for length in LENGTHS), b""]
    done = subprocess.run(
        [tmp_path / "decode"],
        input=b"".join(chain.from_iterable((len(case).to_bytes(2, "big"), case) for case in cases)),
        capture_output=True,
        check=True,
        timeout=LIMIT_S,
    )
    decoded = [decode(case) for case in cases]
    assert done.stdout == b"".join(len(each).to_bytes(2, "big") + each for each in decoded)
