"""Generate the encoder in C of commands and other messages of the host: functions for byte links and, where these have
identifiers, for CAN."""

from __future__ import annotations

from lidar_icd.c.decoder import block_text, c_type, crc_lines, may_be_missing, shipped_text
from lidar_protocol.definitions import CommandDefinition, HostMessageDefinition, Interface
from lidar_protocol.fields import Constant, Counter, Flag, Number, Real, Time
from lidar_protocol.headers import PlainHeader, SpacePacketHeader
from lidar_protocol.layout import Layout, PlacedField


def commands_text(interface: Interface) -> str:
    """Functions that encode the commands of an interface; empty if it has none."""
    if interface.commands is None:
        return ""
    commands = interface.commands.commands
    longest = interface.link.framing.longest_on_line(interface.longest_command)
    # With the delimiters before and after it.
    room = f"#define LIDAR_LONGEST_COMMAND {longest}u"
    put = shipped_text(f"put_{interface.byte_order}.h")
    parts = [room, put, shipped_text("put_values.h"), _seal(interface)]
    for command in commands:
        parts += [_pack("", command, command.packet), _encode(command)]
        if interface.can is not None and command.can is not None and command.can_id is not None:
            can_id = f"0x{interface.can.id_base + command.can_id:X}u"
            define = f"#define LIDAR_CAN_ID_{command.name.upper()} {can_id}"
            parts.append(f"{define}\n{_pack('can_', command, command.can)}")
    if interface.commands.messages:
        longest = interface.link.framing.longest_on_line(interface.longest_host_message)
        parts.append(f"#define LIDAR_LONGEST_MESSAGE {longest}u")
    for message in interface.commands.messages:
        parts += [block_text(f"message_{message.name}", message.packet), *_message(interface, message)]
    return "\n\n".join(parts)


def _seal(interface: Interface) -> str:
    link = interface.link
    header = link.header
    lines = _space_packet(header) if isinstance(header, SpacePacketHeader) else _plain(header)
    body = "\n".join(f"    {line}" for line in [*lines, *_crc(interface)])
    return f"""/* Complete the packet of a command around its body, and frame it; returns the number of bytes. */
static inline size_t lidar_seal(
    uint8_t *to, unsigned to_unit, uint64_t sequence, uint8_t *packet, size_t length) {{
{body}
    return lidar_frame(to, packet, length);
}}"""


def _space_packet(header: SpacePacketHeader) -> list[str]:
    words = (
        f"0x{header.identification('command', 0):X}u + to_unit",
        "0xC000u | (sequence & 0x3FFFu)",
        "length - 7u",
    )
    lines = ["const uint64_t words[3] = {" + ", ".join(words) + "};"]
    lines += ["for (size_t k = 0u; k < 3u; k++) {"]
    lines += ["    packet[2u * k] = (uint8_t)(words[k] >> 8);"]
    return [*lines, "    packet[2u * k + 1u] = (uint8_t)words[k];", "}"]


def _plain(header: PlainHeader) -> list[str]:
    known = {
        "unit": "to_unit",
        "sequence": "sequence",
        "length": "length",
        "message": f"{header.messages['command']}u",
    }
    lines = ["lidar_clear(packet, LIDAR_HEADER_BYTES);"]
    if "unit" not in header.layout.names:
        lines.append("(void)to_unit;")
    if "sequence" not in header.layout.names:
        lines.append("(void)sequence;")
    for field, bit in header.layout.placed:
        codec = field.codec
        word = f"0x{codec.code:X}u" if isinstance(codec, Constant) else known[field.name]
        lines.append(f"lidar_put(packet, {bit}u, {codec.bits}u, {word});")
    return lines


def _crc(interface: Interface) -> list[str]:
    link = interface.link
    if link.crc is None:
        return []
    lines = [f"uint{link.crc.bits}_t crc = LIDAR_CRC_START;", *crc_lines(link)]
    for k in range(link.crc_length):
        from_end = link.crc_length - k
        shift = 8 * (from_end - 1 if link.byte_order == "big" else k)
        lines.append(f"packet[length - {from_end}u] = (uint8_t)(crc >> {shift});")
    return lines


def _encode(command: CommandDefinition) -> str:
    name = command.name
    names = "".join(f", {placed.field.key}" for placed in _arguments(command.packet))
    return f"""static inline size_t lidar_encode_{name}(
    uint8_t *to, unsigned to_unit{_parameters(command.packet)}) {{
    uint8_t packet[LIDAR_HEADER_BYTES + LIDAR_COMMAND_{name.upper()}_BYTES + LIDAR_CRC_BYTES];
    if (to_unit >= LIDAR_UNITS || !lidar_pack_{name}(packet + LIDAR_HEADER_BYTES{names}))
        return 0u;
    return lidar_seal(to, to_unit, (uint64_t)sequence, packet, sizeof packet);
}}"""


def _pack(prefix: str, command: CommandDefinition, layout: Layout) -> str:
    length = f"LIDAR_{prefix.upper()}COMMAND_{command.name.upper()}_BYTES"
    puts = " &&\n        ".join(_put(placed, placed.field.key) for placed in _arguments(layout))
    return f"""#define {length} {layout.length}u

static inline bool lidar_pack_{prefix}{command.name}(uint8_t *block{_parameters(layout)}) {{
    lidar_clear(block, {length});
{_fixed(layout, command)}    return {puts};
}}"""


def _fixed(layout: Layout, command: CommandDefinition) -> str:
    return "".join(
        f"    lidar_put(block, {placed.first_bit}u, {placed.field.codec.bits}u, {code}u);\n"
        for placed in layout.placed
        if (code := _code(placed, command)) is not None
    )


def _message(interface: Interface, message: HostMessageDefinition) -> list[str]:
    """Functions that encode a message from the structure that its decoder fills."""
    name, can = message.name, interface.can
    struct = f"const lidar_message_{name} *from"
    frame = f"""static inline size_t lidar_encode_{name}(uint8_t *to, unsigned to_unit, {struct}) {{
    uint8_t packet[LIDAR_HEADER_BYTES + LIDAR_MESSAGE_{name.upper()}_BYTES + LIDAR_CRC_BYTES];
    if (to_unit >= LIDAR_UNITS || !lidar_pack_message_{name}(packet + LIDAR_HEADER_BYTES, from))
        return 0u;
    return lidar_seal(to, to_unit, from->sequence, packet, sizeof packet);
}}"""
    texts = [_pack_from(f"message_{name}", struct, message, message.packet), frame]
    for part in message.can_parts:
        can_id = can.can_id(0, part) if can else 0
        defines = [
            f"#define LIDAR_CAN_ID_{part.name.upper()} 0x{can_id:X}u",
            f"#define LIDAR_CAN_{part.name.upper()}_BYTES {part.layout.length}u",
        ]
        texts.append("\n".join([*defines, "", _pack_from(f"can_{part.name}", struct, message, part.layout)]))
    return texts


def _pack_from(name: str, struct: str, message: HostMessageDefinition, layout: Layout) -> str:
    puts = " &&\n        ".join(_put_member(placed) for placed in _arguments(layout))
    return f"""static inline bool lidar_pack_{name}(uint8_t *block, {struct}) {{
    lidar_clear(block, LIDAR_{name.upper()}_BYTES);
{_fixed(layout, message)}    return {puts};
}}"""


def _put_member(placed: PlacedField) -> str:
    """Put a member, or the code for no value if it has none."""
    codec, key = placed.field.codec, placed.field.key
    put = _put(placed, f"from->{key}")
    if not may_be_missing(placed.field):
        return put
    if not isinstance(codec, Number) or codec.none is None:
        return f"from->has_{key} &&\n        {put}"
    none = f"0x{codec.none % (1 << codec.bits):X}u"
    place = f"block, {placed.first_bit}u, {codec.bits}u"
    return f"(from->has_{key} ? {put}\n            : lidar_put_bits({place}, {none}))"


def _code(placed: PlacedField, command: CommandDefinition) -> int | None:
    if placed.field.name == "command":
        return command.code
    codec = placed.field.codec
    return codec.code if isinstance(codec, Constant) else None


def _arguments(layout: Layout) -> list[PlacedField]:
    own = [placed for placed in layout.placed if placed.field.name != "command"]
    return [placed for placed in own if not isinstance(placed.field.codec, Constant)]


def _parameters(layout: Layout) -> str:
    return "".join(f", {c_type(placed.field)} {placed.field.key}" for placed in _arguments(layout))


def _put(placed: PlacedField, value: str) -> str:
    codec = placed.field.codec
    place = f"block, {placed.first_bit}u, {codec.bits}u"
    match codec:
        case Flag() | Counter():
            return f"lidar_put_bits({place}, {value})"
        case Time():
            return f"lidar_put_time(block, {placed.first_bit}u, {value})"
        case Real():
            low, high = codec.lowest, codec.highest
            return (
                f"lidar_put_{'float' if codec.bits == 32 else 'double'}({place}, {value}, {low!r}, {high!r})"
            )
        case Number(whole=False):
            limits = f"{float(codec.lowest)!r}, {float(codec.highest + 1)!r}"
            return f"lidar_put_steps({place}, {value} * (lidar_real){codec.steps_per_unit!r}, {limits})"
        case Number():
            low, high = codec.lowest + codec.offset, codec.highest + codec.offset
            if c_type(placed.field) == "uint64_t":
                return f"lidar_put_unsigned({place}, {value}, {low}ULL, {high}ULL)"
            least = "INT64_MIN" if low == -(2**63) else f"{low}LL"
            return f"lidar_put_signed({place}, {value}, {least}, {min(high, 2**63 - 1)}LL, {codec.offset})"
    raise AssertionError(codec)
