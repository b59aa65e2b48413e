"""Generate the decoder in C: functions that check a packet and read each kind of packet of a device."""

from __future__ import annotations

from importlib.resources import files

from lidar_protocol.crc import Crc
from lidar_protocol.definitions import ByteLink, Interface
from lidar_protocol.fields import Constant, Counter, Field, Flag, Number, Real, Time
from lidar_protocol.headers import Kind, PlainHeader, SpacePacketHeader
from lidar_protocol.layout import Layout, PlacedField


def shipped_text(name: str) -> str:
    """Text of a C file of this package."""
    return (files("lidar_icd.c") / name).read_text(encoding="utf-8").rstrip()


def comment_text(text: str) -> str:
    """Escape a text for a comment."""
    return text.replace("*/", "* /")


def block_text(name: str, layout: Layout) -> str:
    """Struct of the values of a block, and the function that fills it."""
    members = "\n".join(f"    {line}" for placed in layout.placed for line in _members(placed.field))
    sets = "\n".join(f"    {line}" for placed in layout.placed for line in _assignments(placed))
    return f"""#define LIDAR_{name.upper()}_BYTES {layout.length}u

typedef struct {{
{members}
}} lidar_{name};

static inline void lidar_unpack_{name}(const uint8_t *block, lidar_{name} *to) {{
{sets}
}}"""


def _members(field: Field) -> list[str]:
    comment = f" /* {comment_text(field.unit)} */" if field.unit else ""
    lines = [f"{c_type(field)} {field.key};{comment}"]
    if may_be_missing(field):
        lines.append(f"bool has_{field.key};")
    return lines


def c_type(field: Field) -> str:
    """C type of a field's value."""
    match field.codec:
        case Flag():
            return "bool"
        case Time():
            return "int64_t"
        case Number(whole=False) | Real(bits=32):
            return "lidar_real"
        case Real():
            return "double"
        case Number(whole=True):
            return "int64_t" if field.codec.signed or field.codec.offset else "uint64_t"
    return "uint64_t"


def may_be_missing(field: Field) -> bool:
    """Whether a field has a member that says if it has a value."""
    codec = field.codec
    return isinstance(codec, Real) or (isinstance(codec, Number) and not codec.is_full)


def _assignments(placed: PlacedField) -> list[str]:
    field, bit = placed
    codec, to = field.codec, f"to->{field.key}"
    bits = f"lidar_bits(block, {bit}u, {codec.bits}u)"
    match codec:
        case Flag():
            return [f"{to} = {bits} != 0u;"]
        case Time():
            return [f"{to} = lidar_nanoseconds({bits});"]
        case Counter() | Constant():
            return [f"{to} = {bits};"]
        case Real():
            low, high = codec.limits
            call = f"lidar_float((uint32_t){bits})" if codec.bits == 32 else f"lidar_double({bits})"
            value = f"(double){to}" if codec.bits == 32 else to
            return [f"{to} = {call};", f"to->has_{field.key} = {value} >= {low!r} && {value} <= {high!r};"]
        case Number():
            return _number(field, codec, bits)
    raise AssertionError(codec)


def _number(field: Field, codec: Number, bits: str) -> list[str]:
    to = f"to->{field.key}"
    kind, suffix = ("int64_t", "") if codec.signed else ("uint64_t", "u")
    raw = f"lidar_signed({bits}, {codec.bits}u)" if codec.signed else bits
    if codec.whole:
        value = f"(int64_t)raw + {codec.offset}" if codec.offset else "raw"
    else:
        value = f"(lidar_real)raw / (lidar_real){codec.steps_per_unit!r}"
    lines = [f"{{ const {kind} raw = {raw};"]
    if may_be_missing(field):
        low = f"raw >= {_literal(codec.lowest, suffix)}"
        high = f"raw <= {_literal(codec.highest, suffix)}"
        in_range = high if not codec.signed and codec.lowest == 0 else f"{low} && {high}"
        lines.append(f"  to->has_{field.key} = {in_range};")
    return [*lines, f"  {to} = {value}; }}"]


def _literal(value: int, suffix: str) -> str:
    if value == -(2**63):
        return "INT64_MIN"
    return f"{value}{suffix.upper()}LL"


def decoder_text(interface: Interface) -> str:
    """Functions that check a packet and read each kind."""
    replies = (_reply(kind, layout) for kind, layout in interface.replies.items())
    return "\n\n".join([_check(interface), _measurement(interface), *replies])


def _check(interface: Interface) -> str:
    lines: list[str] = []
    link = interface.link
    if link.crc is not None:
        lines += _crc_check(link, link.crc)
    header = link.header
    lines += (
        _ccsds_lines(header, interface)
        if isinstance(header, SpacePacketHeader)
        else _plain_lines(header, interface)
    )
    body = "\n".join(f"    {line}" for line in lines)
    return f"""/* The kind of a valid packet of this interface, whose unit is set; otherwise LIDAR_NOTHING. */
static inline lidar_kind lidar_check(const uint8_t *packet, size_t length, unsigned *unit) {{
    if (length <= LIDAR_HEADER_BYTES + LIDAR_CRC_BYTES)
        return LIDAR_NOTHING;
{body}
    return LIDAR_NOTHING;
}}"""


def crc_lines(link: ByteLink) -> list[str]:
    """Lines that compute the CRC of a packet, from its start value."""
    start = "LIDAR_HEADER_BYTES" if link.covered == "body" else "0u"
    lines = []
    if link.covered == "frame":
        lines += ["uint8_t head[LIDAR_SYNC_BYTES + LIDAR_LENGTH_BYTES];", "lidar_head(head, length);"]
        lines += ["crc = lidar_crc(crc, head, sizeof head);"]
    return [*lines, f"crc = lidar_crc(crc, packet + {start}, length - LIDAR_CRC_BYTES - {start});"]


def _crc_check(link: ByteLink, crc: Crc) -> list[str]:
    lines = [f"uint{crc.bits}_t crc = LIDAR_CRC_START;", "uint32_t stated = 0u;", *crc_lines(link)]
    place = "length - LIDAR_CRC_BYTES + k" if link.byte_order == "big" else "length - 1u - k"
    lines += ["for (size_t k = 0u; k < LIDAR_CRC_BYTES; k++)", f"    stated = stated << 8 | packet[{place}];"]
    return [*lines, "if (stated != crc)", "    return LIDAR_NOTHING;"]


def _ccsds_lines(header: SpacePacketHeader, interface: Interface) -> list[str]:
    lines = [
        "const unsigned identification = (unsigned)packet[0] << 8 | packet[1];",
        "if (((size_t)packet[4] << 8 | packet[5]) + 7u != length || packet[2] < 0xC0u)",
        "    return LIDAR_NOTHING;",
    ]
    kinds: list[Kind] = ["measurement", *interface.replies]
    for kind in kinds:
        first = header.identification(kind, 0)
        lines += [
            f"if (identification >= 0x{first:X}u && identification < 0x{first:X}u + LIDAR_UNITS) {{",
            f"    *unit = identification - 0x{first:X}u;",
            f"    return LIDAR_{kind.upper()};",
            "}",
        ]
    return lines


def _plain_lines(header: PlainHeader, interface: Interface) -> list[str]:
    places = {placed.field.name: placed for placed in header.layout.placed}

    def bits(name: str) -> str:
        return f"lidar_bits(packet, {places[name].first_bit}u, {places[name].field.codec.bits}u)"

    lines: list[str] = []
    unit = f"(unsigned){bits('unit')}" if "unit" in places else "0u"
    lines.append(f"*unit = {unit};")
    checks = []
    if "unit" in places and interface.units < 1 << places["unit"].field.codec.bits:
        checks.append("*unit >= LIDAR_UNITS")
    if "length" in places:
        checks.append(f"{bits('length')} != length")
    for name, placed in places.items():
        if isinstance(placed.field.codec, Constant):
            checks.append(f"{bits(name)} != 0x{placed.field.codec.code:X}u")
    if checks:
        lines += [f"if ({' || '.join(checks)})", "    return LIDAR_NOTHING;"]
    kinds: list[Kind] = ["measurement", *interface.replies]
    for kind in kinds:
        if "message" in places:
            lines.append(f"if ({bits('message')} == {header.messages[kind]}u)")
        lines.append(f"    return LIDAR_{kind.upper()};")
    return lines


def _reply(kind: Kind, layout: Layout) -> str:
    version = _version_check(layout, "to->")
    return f"""static inline bool lidar_read_{kind}(
    const uint8_t *packet, size_t length, unsigned *unit, lidar_{kind} *to) {{
    if (lidar_check(packet, length, unit) != LIDAR_{kind.upper()} ||
        length != LIDAR_HEADER_BYTES + LIDAR_{kind.upper()}_BYTES + LIDAR_CRC_BYTES)
        return false;
    lidar_unpack_{kind}(packet + LIDAR_HEADER_BYTES, to);
    return {version};
}}"""


def _version_check(layout: Layout, to: str) -> str:
    return (
        f"{to}interface_version == LIDAR_INTERFACE_VERSION" if "interface_version" in layout.names else "true"
    )


def _measurement(interface: Interface) -> str:
    packet = interface.packet
    version = _version_check(packet.header, "to->shot.")
    head = "LIDAR_HEADER_BYTES + LIDAR_SHOT_BYTES + LIDAR_CRC_BYTES"
    if packet.beam is None:
        rest = f"    to->beam_count = 0u;\n    return length == {head} && {version};"
        beams = ""
    else:
        count = " || to->shot.beam_count != to->beam_count" if "beam_count" in packet.header.names else ""
        beams = "    lidar_beam beams[LIDAR_MAXIMUM_BEAMS];\n"
        rest = f"""    to->beam_count = (length - ({head})) / LIDAR_BEAM_BYTES;
    if (length != {head} + to->beam_count * LIDAR_BEAM_BYTES ||
        to->beam_count == 0u || to->beam_count > LIDAR_MAXIMUM_BEAMS{count})
        return false;
    for (size_t k = 0u; k < to->beam_count; k++)
        lidar_unpack_beam(packet + LIDAR_HEADER_BYTES + LIDAR_SHOT_BYTES + k * LIDAR_BEAM_BYTES, &to->beams[k]);
    return {version};"""
    return f"""typedef struct {{
    lidar_shot shot;
    size_t beam_count;
{beams}}} lidar_measurement;

static inline bool lidar_read_measurement(
    const uint8_t *packet, size_t length, unsigned *unit, lidar_measurement *to) {{
    if (lidar_check(packet, length, unit) != LIDAR_MEASUREMENT || length < {head})
        return false;
    lidar_unpack_shot(packet + LIDAR_HEADER_BYTES, &to->shot);
{rest}
}}"""
