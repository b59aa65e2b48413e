"""Interfaces of every kind, drawn by chance; and what their fields are on the wire, computed bit by bit."""

from __future__ import annotations

import json
import struct
from fractions import Fraction

from hypothesis import strategies as st

from lidar_protocol.crc import CRCS

SCALES = ["0.001", "0.01", "0.5", "0.00025", "3", "1e-6"]
VERDICTS = ["accepted", "unknown", "malformed", "bad_sequence", "out_of_state", "out_of_range"]


def toml(value):
    """A value as TOML, inline."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return value if value in SCALES else json.dumps(value)


def document(tree):
    """A tree as TOML: its top level as tables."""
    text = []
    for name, table in tree.items():
        if isinstance(table, list):
            text.append("\n".join(f"[[{name}]]\n{lines(entry)}" for entry in table))
        else:
            text.append(f"[{name}]\n{lines(table)}")
    return "\n".join(text) + "\n"


def lines(table):
    return "\n".join(f"{key} = {toml(item)}" for key, item in table.items())


@st.composite
def numbers(draw, name):
    """A field that holds a number, whole or scaled, with or without codes and limits."""
    signed, whole = draw(st.booleans()), draw(st.booleans())
    bits = draw(st.integers(2, 64 if whole else 48))
    entry = {"name": name, "type": f"{'i' if signed else 'u'}{bits}"}
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    if draw(st.booleans()):
        entry["none"] = low if signed else high
    if not whole:
        entry["scale"] = draw(st.sampled_from(SCALES))
    elif bits <= 32 and draw(st.booleans()):
        entry["offset"] = draw(st.integers(-1000, 1000))
    if draw(st.booleans()):
        entry["outside"] = "nearest"
    return entry


@st.composite
def fields(draw, prefix, most=6):
    """A list of fields and spare bits; floating-point numbers start at a byte."""
    entries, bit = [], 0
    for k in range(draw(st.integers(1, most))):
        name = f"{prefix}{k}"
        kind = draw(
            st.sampled_from(["number", "number", "bool", "f32", "f64", "cuc", "counter", "constant", "spare"])
        )
        if kind == "number":
            entry = draw(numbers(name))
        elif kind == "counter":
            entry = {"name": name, "type": f"u{draw(st.integers(1, 64))}", "wraps": True}
        elif kind == "constant":
            bits = draw(st.integers(1, 32))
            entry = {"name": name, "type": f"u{bits}", "constant": draw(st.integers(0, (1 << bits) - 1))}
        elif kind == "spare":
            entry = {"spare": draw(st.integers(1, 20))}
        else:
            entry = {"name": name, "type": kind}
        if kind in ("f32", "f64") and bit % 8:
            entries.append({"spare": 8 - bit % 8})
            bit += 8 - bit % 8
        entries.append(entry)
        bit += bits_of(entry)
    if not any("name" in entry for entry in entries):
        entries.append({"name": f"{prefix}x", "type": "bool"})
    return entries


def bits_of(entry):
    """How many bits a field takes."""
    if "spare" in entry:
        return entry["spare"]
    return {"bool": 1, "cuc": 56}.get(entry["type"]) or int(entry["type"][1:])


@st.composite
def trees(draw):
    """A whole definition, as a tree."""
    order = draw(st.sampled_from(["big", "little"]))
    units = draw(st.sampled_from([1, 4]))
    framing = draw(framings())
    over = ["packet", "body"] + (["frame"] if framing["kind"] == "sync" else [])
    beams = draw(st.booleans())
    header = [
        {"name": "shot", "type": "u32", "wraps": True},
        {"name": "range_m", "beam": 1, "type": "u24", "scale": "0.01", "none": 0xFFFFFF},
        *draw(fields("h")),
    ]
    if beams and draw(st.booleans()):
        header.insert(0, {"name": "beam_count", "type": "u8"})
    return {
        "interface": {"name": "drawn", "version": 1, "units": units, "byte_order": order, "epoch": "then"},
        "enumerations": {"verdict": {word: k for k, word in enumerate(VERDICTS)}},
        "framing": framing,
        "crc": {
            "kind": draw(st.sampled_from(["none", *CRCS])),
            "over": draw(st.sampled_from(over)),
            "byte_order": draw(st.sampled_from(["big", "little"])),
        },
        "header": draw(headers(order)),
        "packet": {
            "header": header,
            **({"maximum_beams": 9, "beam": draw(fields("b"))} if beams else {}),
        },
        "command_header": [{"name": "command", "type": "u8"}, {"name": "sequence", "type": "u8"}],
        "commands": {"first": {"code": 1}, "second": {"code": 7, "fields": draw(fields("c"))}},
        "acknowledge": [
            {"name": "sequence", "type": "u8"},
            {"name": "verdict", "type": "u8", "values": "verdict"},
        ],
        "housekeeping": draw(fields("k")),
    }


@st.composite
def framings(draw):
    """COBS, SLIP, or a sync word and a length."""
    kind = draw(st.sampled_from(["cobs", "slip", "sync"]))
    if kind != "sync":
        return {"kind": kind}
    word = draw(st.sampled_from(["1ACFFC1D", "EB90", "A5", "AAAA", "00"]))
    counts = draw(st.sampled_from(["packet", "frame"]))
    return {
        "kind": kind,
        "sync": word,
        "length": draw(st.sampled_from(["u16", "u32"])),
        "length_counts": counts,
    }


@st.composite
def headers(draw, order):  # noqa: ARG001
    """A space packet's header, or a plain one with its fields in any order."""
    if draw(st.booleans()):
        return {
            "kind": "ccsds",
            "apid": {"measurement": 0x10, "housekeeping": 0x20, "acknowledge": 0x30, "command": 0x10},
        }
    chosen = [
        {"name": "message", "type": draw(st.sampled_from(["u4", "u8", "u16"]))},
        {"name": "unit", "type": draw(st.sampled_from(["u2", "u8"]))},
    ]
    extra = [
        {"name": "sequence", "type": draw(st.sampled_from(["u3", "u8", "u16"]))},
        {"name": "length", "type": "u16"},
        {"name": "magic", "type": "u8", "constant": 0x5A},
    ]
    chosen += draw(st.lists(st.sampled_from(extra), unique_by=lambda entry: entry["name"]))
    return {
        "kind": "plain",
        "fields": draw(st.permutations(chosen)),
        "message": {"measurement": 1, "housekeeping": 2, "acknowledge": 3, "command": 9},
    }


@st.composite
def values(draw, entries):
    """A value for each field, and the bits that stand for it."""
    given, bits = {}, {}
    for entry in entries:
        if "name" in entry:
            key = f"{entry['name']}_{entry['beam']}" if "beam" in entry else entry["name"]
            given[key], bits[key] = draw(value(entry))
    return given, bits


@st.composite
def value(draw, entry):
    """A value that the field can hold exactly, and its bits as a number."""
    kind, width = entry["type"], bits_of(entry)
    if kind == "bool":
        flag = draw(st.booleans())
        return flag, int(flag)
    if kind in ("f32", "f64"):
        number = draw(st.floats(width=width, allow_nan=False, allow_infinity=False))
        return number, int.from_bytes(struct.pack(">f" if width == 32 else ">d", number), "big")
    if kind == "cuc":
        seconds = draw(st.integers(0, 2**32 - 1))
        return seconds * 10**9 + 500_000_000, seconds << 24 | 1 << 23
    if "constant" in entry:
        return entry["constant"], entry["constant"]
    if "wraps" in entry:
        number = draw(st.integers(0, 2**64))
        return number, number % (1 << width)
    low, high = (-(1 << width - 1), (1 << width - 1) - 1) if kind[0] == "i" else (0, (1 << width) - 1)
    if "none" in entry:
        low, high = low + (entry["none"] == low), high - (entry["none"] == high)
        if draw(st.booleans()):
            return None, entry["none"] % (1 << width)
    raw = draw(st.integers(low, high))
    physical = float(raw * Fraction(entry["scale"])) if "scale" in entry else raw + entry.get("offset", 0)
    return physical, raw % (1 << width)


def block(entries, bits, order):
    """The bytes of a block: from its fields' bits, one bit after the other."""
    stream = []
    for entry in entries:
        if "spare" in entry:
            stream += [0] * entry["spare"]
            continue
        key = f"{entry['name']}_{entry['beam']}" if "beam" in entry else entry["name"]
        own = [bits[key] >> k & 1 for k in range(bits_of(entry))]  # lowest first
        stream += own if order == "little" else own[::-1]
    stream += [0] * (-len(stream) % 8)
    weights = range(8) if order == "little" else range(7, -1, -1)
    return bytes(
        sum(bit << weight for bit, weight in zip(stream[k : k + 8], weights, strict=True))
        for k in range(0, len(stream), 8)
    )


def same(back, given, entry):
    """Whether a value has come back."""
    if entry["type"] in ("f32", "f64"):
        return back == given
    if "wraps" in entry:
        return back == given % (1 << bits_of(entry))
    if back is None or given is None:
        return back is given
    return back == given or abs(back - given) <= 1e-12 * abs(given)
