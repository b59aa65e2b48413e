"""What the documents say of each framing: a new framing is described here, and nowhere else in this package.

A text has, for C, the shipped files that find and frame packets, in order (`c_files`), the length in bytes of the
longest frame from the device (`c_longest_frame`), and constants and functions for the bytes before a packet
(`c_head`); a section of the interface document (`markdown`, of the longest frame's length in bytes); constants of the
dissector (`wireshark`, of the longest packet's length in bytes); and for COSMOS the protocol that it has, as module and
class (`cosmos_base`), the shipped file of what is added to that (`cosmos_file`), and the constants of that file
(`cosmos`, of the longest packet's length in bytes).
"""

from __future__ import annotations

from dataclasses import dataclass

from lidar_protocol.framing import Framing, Stuffed, Synced


@dataclass(frozen=True)
class _StuffedText:
    framing: Stuffed
    c_head = ""
    cosmos_file = "cosmos_stuffed.txt"

    def cosmos(self, longest: int) -> str:  # noqa: ARG002
        return ""

    def wireshark(self, longest: int) -> dict[str, str | int | bool]:  # noqa: ARG002
        return {"kind": self.framing.kind}

    def _delimited(self, longest: int) -> str:
        delimiter = self.framing.delimiter.hex()
        return f"""Ignore empty frames: each frame has a delimiter (`{delimiter}`) of its own before it, so that noise
before it cannot corrupt it. No frame from the device is longer than {longest} bytes without its delimiters."""


class _CobsText(_StuffedText):
    c_files = "cobs.h", "stuffed_receiver.h"
    cosmos_base = "cobs_protocol", "CobsProtocol"
    c_longest_frame = "(LIDAR_LONGEST_PACKET + 1u + (LIDAR_LONGEST_PACKET - 1u) / 254u)"

    def markdown(self, longest: int) -> str:
        return f"""Each packet is encoded with COBS (consistent overhead byte stuffing), which removes all zeros, and
sent between two zero bytes, the delimiters. COBS adds one byte, and one more for each further 254 bytes.

To decode, collect bytes up to a zero. Read a code byte c and copy the c - 1 bytes after it; if c is less than 255 and
the frame has more bytes, append a zero; repeat to the end of the frame. Drop a frame that ends inside a run, or whose
packet is invalid; the next frame starts after the next zero.
{self._delimited(longest)}"""


class _SlipText(_StuffedText):
    c_files = "slip.h", "stuffed_receiver.h"
    cosmos_base = "slip_protocol", "SlipProtocol"
    c_longest_frame = "(2u * LIDAR_LONGEST_PACKET)"

    def markdown(self, longest: int) -> str:
        return f"""Each packet is encoded with SLIP (RFC 1055): `c0` becomes `db dc`, and `db` becomes `db dd`. It is
sent between two bytes `c0`, the delimiters.

To decode, collect bytes up to a `c0`, and reverse the two substitutions. Drop a frame with another byte after a `db`,
or whose packet is invalid; the next frame starts after the next `c0`.
{self._delimited(longest)}"""


@dataclass(frozen=True)
class _SyncedText:
    framing: Synced
    c_files = ("sync_receiver.h",)
    cosmos_base = "burst_protocol", "BurstProtocol"
    cosmos_file = "cosmos_sync.txt"
    c_longest_frame = "(LIDAR_SYNC_BYTES + LIDAR_LENGTH_BYTES + LIDAR_LONGEST_PACKET)"

    def markdown(self, longest: int) -> str:
        framing = self.framing
        size = {1: "u8", 2: "u16", 4: "u32"}[framing.length_bytes]
        if framing.counts == "packet":
            counted = "the number of bytes that follow it"
        else:
            counted = "the number of bytes of the frame, sync word and length included"
        order = "" if framing.length_bytes == 1 else f" ({framing.byte_order}-endian)"
        return f"""Each packet follows the sync word `{framing.sync.hex(" ")}` and a {size}{order}:
{counted}.

To decode, find the sync word, then read the length and that number of bytes. If the length is impossible or the packet
is invalid, the sync word was a coincidence in the data or the frame is damaged: resume at the second byte of that
sync word, not after the frame.
No frame from the device is longer than {longest} bytes."""

    def wireshark(self, longest: int) -> dict[str, str | int | bool]:
        framing = self.framing
        return {
            "kind": "sync",
            "sync": framing.sync.hex(),
            "length_bytes": framing.length_bytes,
            "big_endian": framing.byte_order == "big",
            "uncounted": framing.uncounted,
            "longest": longest,
        }

    def cosmos(self, longest: int) -> str:
        framing = self.framing
        return f"""SYNC = bytes.fromhex("{framing.sync.hex()}")
HEAD_LENGTH = {framing.head_length}
ORDER = "{framing.byte_order}"
UNCOUNTED = {framing.uncounted}
LONGEST = {framing.longest_frame(longest)}
"""

    @property
    def c_head(self) -> str:
        framing = self.framing
        sync = ", ".join(f"0x{byte:02X}u" for byte in framing.sync)
        shifts = [
            8 * (framing.length_bytes - 1 - k if framing.byte_order == "big" else k)
            for k in range(framing.length_bytes)
        ]
        stated = " | ".join(
            f"(size_t)head[LIDAR_SYNC_BYTES + {k}u] << {shift}" for k, shift in enumerate(shifts)
        )
        written = "\n".join(
            f"    head[LIDAR_SYNC_BYTES + {k}u] = (uint8_t)((length + {framing.uncounted}u) >> {shift});"
            for k, shift in enumerate(shifts)
        )
        return f"""#define LIDAR_SYNC_BYTES {len(framing.sync)}u
#define LIDAR_LENGTH_BYTES {framing.length_bytes}u
static const uint8_t lidar_sync[LIDAR_SYNC_BYTES] = {{{sync}}};

static inline bool lidar_may_be_sync(const uint8_t *data, size_t length) {{
    size_t same = 0u;
    while (same < length && same < LIDAR_SYNC_BYTES && data[same] == lidar_sync[same])
        same++;
    return same == length || same == LIDAR_SYNC_BYTES;
}}

/* Stated length of the packet; 0 if impossible. */
static inline size_t lidar_stated_length(const uint8_t *head) {{
    const size_t stated = {stated};
    return stated > {framing.uncounted}u ? stated - {framing.uncounted}u : 0u;
}}

static inline void lidar_head(uint8_t *head, size_t length) {{
    lidar_move(head, lidar_sync, LIDAR_SYNC_BYTES);
{written}
}}"""


FramingText = _CobsText | _SlipText | _SyncedText


def framing_text(framing: Framing) -> FramingText:
    """The text of a framing."""
    if isinstance(framing, Synced):
        return _SyncedText(framing)
    return _CobsText(framing) if framing.kind == "cobs" else _SlipText(framing)
