"""The datagrams against the offsets of docs/live-truth.md, a C compiler, and arbitrary bytes."""

from __future__ import annotations

import shutil
import struct
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidar_emu.trajectory.live_datagram import Answer, AnsweredPacket, Truth, Verdict, answers, sequence_of

HEADER = Path(__file__).resolve().parents[2] / "examples" / "lidar_truth.h"
WHOLE = Truth(
    7, 1_500_000_000, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), (7.0, 8.0, 9.0), (0.5, -0.5, 0.5, -0.5), (10.0, 11.0, 12.0),
    True,
)  # fmt: skip

PRINT_OFFSETS = """
#include <stddef.h>
#include <stdio.h>
#include "lidar_truth.h"
int main(void) {
    struct lidar_truth t = {0};
    lidar_truth_begin(&t, 7, 1500000000);
    for (int k = 0; k < 3; ++k) {
        t.position_site_m[k] = 1 + k; t.velocity_site_mps[k] = 4 + k; t.acceleration_site_mps2[k] = 7 + k;
        t.body_rate_radps[k] = 10 + k;
    }
    t.flags = LIDAR_TRUTH_ACCELERATION_KNOWN | LIDAR_TRUTH_LAST;
    for (int k = 0; k < 4; ++k) t.site_from_body[k] = k % 2 ? -0.5 : 0.5;
    fwrite(&t, sizeof t, 1, stdout);
    return 0;
}
"""


def test_the_fields_lie_where_the_page_reports() -> None:
    data = WHOLE.to_bytes()
    assert len(data) == 152
    assert data[:4] == b"LETR"
    assert struct.unpack_from("<HHI", data, 4) == (1, 3, 7)
    assert struct.unpack_from("<q", data, 16) == (1_500_000_000,)
    assert struct.unpack_from("<9d", data, 24) == tuple(float(k) for k in range(1, 10))
    assert struct.unpack_from("<4d", data, 96) == WHOLE.site_from_body
    assert struct.unpack_from("<3d", data, 128) == WHOLE.body_rate_radps
    assert Truth.from_bytes(data) == WHOLE


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_c_structure_is_the_datagram(tmp_path: Path) -> None:
    source, program = tmp_path / "offsets.c", tmp_path / "offsets"
    source.write_text(PRINT_OFFSETS)
    options = ["-std=c99", "-Wall", "-Wextra", "-Werror", f"-I{HEADER.parent}"]
    subprocess.run(["cc", *options, str(source), "-o", str(program)], check=True)
    assert subprocess.run([str(program)], check=True, capture_output=True).stdout == WHOLE.to_bytes()


def test_an_unknown_acceleration_is_none() -> None:
    unknown = WHOLE._replace(acceleration_site_mps2=None)
    assert Truth.from_bytes(unknown.to_bytes()) == unknown


@given(st.binary(max_size=200))
def test_any_bytes_are_refused_or_read(data: bytes) -> None:
    assert Truth.from_bytes(data) is None
    assert sequence_of(data) >= 0


@pytest.mark.parametrize("place", [0, 4])
def test_another_magic_or_version_is_refused(place: int) -> None:
    data = bytearray(WHOLE.to_bytes())
    data[place] ^= 0xFF
    assert Truth.from_bytes(bytes(data)) is None


@given(st.lists(st.binary(max_size=9000), max_size=30))
def test_an_answer_comes_back_whole_in_datagrams_that_udp_carries(payloads: list[bytes]) -> None:
    packets = [AnsweredPacket(k, 10 * k, k % 5, payload) for k, payload in enumerate(payloads)]
    parts = [Answer.from_bytes(part.to_bytes()) for part in answers(Verdict.ACCEPTED, 3, 5, packets)]
    assert [packet for part in parts for packet in part.packets] == packets
    assert [part.more for part in parts] == list(reversed(range(len(parts))))
    assert all(len(part.to_bytes()) < 65507 for part in parts)


@given(st.binary(max_size=100))
def test_what_is_no_answer_is_said_to_be_none(data: bytes) -> None:
    with pytest.raises(ValueError, match="not an answer"):
        Answer.from_bytes(data)
