-- Wireshark dissector of the interface $name, version $version. Generated; do not edit.
--
--   tshark -X lua_script:lidar.lua -r flight.pcap
--   Wireshark: copy it to the folder of personal Lua plugins (Help, About, Folders).
--
-- Datagrams and CAN frames that are of this interface are recognised. Bytes of a serial line have no port to recognise
-- them by: -d rtacser.data,$protocol, or "Decode As" in the menu; so too $protocol for TCP.
-- A field without a value is shown as "none" and has the filter name NAME.none instead of NAME.

local interface = $interface

local protocol = Proto("$protocol", interface.title)
local can_protocol = interface.can and Proto("${protocol}_can", interface.title .. ", CAN")
local fields, can_fields = {}, {}
local expert = {
    crc = ProtoExpert.new("$protocol.bad_crc", "The CRC does not match", expert.group.CHECKSUM, expert.severity.ERROR),
    length = ProtoExpert.new("$protocol.bad_length", "The length is not that of the message",
        expert.group.MALFORMED, expert.severity.ERROR),
    framing = ProtoExpert.new("$protocol.bad_framing", "The framing is invalid",
        expert.group.MALFORMED, expert.severity.ERROR),
    foreign = ProtoExpert.new("$protocol.foreign", "Not a packet of this interface",
        expert.group.UNDECODED, expert.severity.WARN),
    part = ProtoExpert.new("$protocol.incomplete", "Bytes that belong to no complete frame",
        expert.group.UNDECODED, expert.severity.NOTE),
}
protocol.experts = { expert.crc, expert.length, expert.framing, expert.foreign, expert.part }

---------------------------------------------------------------------------------------------- fields

local function field_of(abbreviation, field)
    local name, meaning = field.key, field.meaning
    if field.kind == "flag" then
        return ProtoField.bool(abbreviation, name, base.NONE, nil, nil, meaning)
    elseif field.kind == "scaled" or field.kind == "real" then
        return ProtoField.double(abbreviation, name, meaning)
    elseif field.kind == "time" then
        return ProtoField.uint64(abbreviation, name, base.DEC, nil, nil, meaning)
    elseif field.bits <= 32 and not field.offset then
        local kind = field.signed and ProtoField.int32 or ProtoField.uint32
        return kind(abbreviation, name, base.DEC, field.words, nil, meaning)
    end
    field.wide = (field.signed or field.offset) and Int64 or UInt64
    local kind = field.wide == Int64 and ProtoField.int64 or ProtoField.uint64
    return kind(abbreviation, name, base.DEC, nil, nil, meaning)
end

-- Register the fields of a layout under the name of its block.
local function register(block, layout, into, of)
    for _, field in ipairs(layout and layout.fields or {}) do
        local abbreviation = of .. "." .. block .. "." .. field.key
        field.proto = field_of(abbreviation, field)
        field.none = ProtoField.new(field.key .. ": none", abbreviation .. ".none", ftypes.NONE)
        into[#into + 1] = field.proto
        into[#into + 1] = field.none
    end
end

local kind_field = ProtoField.string("$protocol.kind", "kind")
local unit_field = ProtoField.uint32("$protocol.unit", "unit")
local sequence_field = ProtoField.uint32("$protocol.sequence_count", "sequence count")
local crc_field = ProtoField.uint32("$protocol.crc", "CRC", base.HEX)
local beam_field = ProtoField.uint32("$protocol.beam", "beam")
for _, field in ipairs({ kind_field, unit_field, sequence_field, crc_field, beam_field }) do
    fields[#fields + 1] = field
end
register("header", interface.header.layout, fields, "$protocol")
register("shot", interface.shot, fields, "$protocol")
register("beam", interface.beam, fields, "$protocol")
register("acknowledge", interface.acknowledge, fields, "$protocol")
register("housekeeping", interface.housekeeping, fields, "$protocol")
register("command", interface.command_header, fields, "$protocol")
for _, command in pairs(interface.commands or {}) do
    register("command_" .. command.name, command.layout, fields, "$protocol")
end
protocol.fields = fields

------------------------------------------------------------------------------------------ whole numbers

-- Bits of a block as a whole number; more than 53 of them as low and high 32 bits.
local function part_of(block, first_bit, bits)
    local value = 0
    if interface.big_endian then
        local bit, last = first_bit, first_bit + bits
        while bit < last do
            local take = math.min(8 - bit % 8, last - bit)
            local byte = block:byte(math.floor(bit / 8) + 1)
            local shifted = math.floor(byte / 2 ^ (8 - bit % 8 - take))
            value = value * 2 ^ take + shifted % 2 ^ take
            bit = bit + take
        end
    else
        local bit, scale = first_bit, 1
        while bit < first_bit + bits do
            local take = math.min(8 - bit % 8, first_bit + bits - bit)
            local byte = block:byte(math.floor(bit / 8) + 1)
            value = value + math.floor(byte / 2 ^ (bit % 8)) % 2 ^ take * scale
            scale, bit = scale * 2 ^ take, bit + take
        end
    end
    return value
end

local function halves(block, field)
    local first, high_bits = field.bit, field.bits - 32
    if interface.big_endian then
        return part_of(block, first + high_bits, 32), part_of(block, first, high_bits)
    end
    return part_of(block, first, 32), part_of(block, first + 32, high_bits)
end

local function wide_number(block, field)
    local low, high = halves(block, field)
    local half = 2 ^ (field.bits - 33)
    if field.signed then
        return Int64.new(low, high < half and high or high + 2 ^ 32 - 2 * half)
    end
    return UInt64.new(low, high)
end

local function is_outside(raw, field)
    local low, high = field.lowest, field.highest
    if low == nil then
        return false
    elseif type(low) == "string" then
        local read = field.signed and Int64.fromhex or UInt64.fromhex
        low, high = read(low), read(high)
    end
    return raw < low or high < raw
end

-- Nanoseconds from the epoch of a time code of seconds and 2^-24 s, rounded to the nearest.
local function nanoseconds(block, field)
    local seconds_bit = interface.big_endian and field.bit or field.bit + 24
    local fraction_bit = interface.big_endian and field.bit + 32 or field.bit
    local ticks = UInt64.new(part_of(block, fraction_bit, 24), 0)
    local rest = (ticks * UInt64.new(1000000000, 0) + UInt64.new(2 ^ 23, 0)):rshift(24)
    return UInt64.new(part_of(block, seconds_bit, 32), 0) * UInt64.new(1000000000, 0) + rest
end

local function real_number(tvb, field)
    local range = tvb(math.floor(field.bit / 8), field.bits / 8)
    local value = interface.big_endian and range:float() or range:le_float()
    return field.lowest <= value and value <= field.highest and value or nil
end

-- Value of a field, nil for none; and whether it has the code for a beam that is absent.
local function value_of(tvb, block, field)
    if field.kind == "real" then
        return real_number(tvb, field), false
    elseif field.kind == "time" then
        return nanoseconds(block, field), false
    end
    local raw = field.bits > 53 and wide_number(block, field) or part_of(block, field.bit, field.bits)
    if field.kind == "flag" then
        return raw ~= 0, false
    elseif field.bits <= 53 and field.signed and raw >= 2 ^ (field.bits - 1) then
        raw = raw - 2 ^ field.bits
    end
    if is_outside(raw, field) then
        return nil, field.absent ~= nil and raw == field.absent
    elseif field.kind == "scaled" then
        return raw / field.steps_per_unit, false
    elseif field.offset and type(raw) == "userdata" then
        return Int64.new(raw:lower(), raw:higher()) + Int64(field.offset), false
    end
    return field.offset and raw + field.offset or raw, false
end

------------------------------------------------------------------------------------------------- blocks

-- Numbers of Lua 5.4 that are whole have to be given as such.
local function whole(value)
    return math.tointeger and type(value) == "number" and math.tointeger(value) or value
end

local function text_of(field, value)
    local text = field.kind == "scaled" and string.format("%.10g", value) or tostring(whole(value))
    if field.words then
        text = (field.words[value] or "unknown") .. " (" .. text .. ")"
    end
    return field.key .. ": " .. text .. (field.unit and " " .. field.unit or "")
end

-- Show a block of fields; returns their values by name.
local function show(layout, tvb, first, tree)
    local range = tvb(first, layout.length):tvb()
    local block, values = range:raw(), {}
    for _, field in ipairs(layout.fields) do
        local start = math.floor(field.bit / 8)
        local place = range(start, math.floor((field.bit + field.bits - 1) / 8) - start + 1)
        local value, absent = value_of(range, block, field)
        values[field.key] = value
        if value == nil then
            tree:add(field.none, place):set_text(field.key .. (absent and ": absent" or ": none"))
        else
            local given = field.kind == "whole" and whole(value) or value
            if field.wide and type(given) == "number" then
                given = field.wide(given)
            end
            local item = tree:add(field.proto, place, given)
            if field.kind ~= "flag" then
                item:set_text(text_of(field, value))
            end
        end
    end
    return values
end

---------------------------------------------------------------------------------------------------- CRC

local function crc_of(bytes)
    local crc, register = interface.crc, interface.crc.start
    local width = 8 * crc.length
    for k = 1, #bytes do
        local byte = bytes:byte(k)
        if crc.reflected then
            register = bit.bxor(bit.rshift(register, 8), crc.table[bit.band(bit.bxor(register, byte), 255) + 1])
        else
            local top = bit.band(bit.bxor(bit.rshift(register, width - 8), byte), 255)
            register = bit.bxor(bit.lshift(register, 8), crc.table[top + 1])
        end
        if width < 32 then
            register = bit.band(register, 2 ^ width - 1)
        end
    end
    return bit.bxor(register, crc.final_xor) % 2 ^ 32
end

local function stated_crc(bytes)
    local length, value = interface.crc.length, 0
    for k = 1, length do
        local place = interface.crc.big_endian and #bytes - length + k or #bytes - k + 1
        value = value * 256 + bytes:byte(place)
    end
    return value
end

local function crc_matches(bytes, head)
    local covered = bytes:sub(1, -1 - interface.crc.length)
    if interface.crc.covered == "body" then
        covered = covered:sub(interface.header.length + 1)
    elseif interface.crc.covered == "frame" then
        covered = head .. covered
    end
    return crc_of(covered) == stated_crc(bytes)
end

------------------------------------------------------------------------------------------------ packets

local function origin_of_space_packet(bytes)
    local identification = bytes:byte(1) * 256 + bytes:byte(2)
    local count = bytes:byte(3) * 256 + bytes:byte(4)
    for first, kind in pairs(interface.header.kinds) do
        if first <= identification and identification < first + interface.units and count >= 0xC000 then
            return kind, identification - first, count % 0x4000, bytes:byte(5) * 256 + bytes:byte(6) + 7
        end
    end
end

local function origin_of_plain_packet(tvb, bytes)
    local values = {}
    for _, field in ipairs(interface.header.layout.fields) do
        values[field.key] = value_of(tvb, bytes, field)
    end
    local kind = interface.header.kinds[values.message]
    if values.message == nil then
        _, kind = next(interface.header.kinds)
    end
    local unit = values.unit or 0
    if kind ~= nil and unit < interface.units then
        return kind, unit, values.sequence, values.length
    end
end

-- Kind, unit, sequence count and stated length of a packet; nil if it is not of this interface.
local function origin_of(tvb, bytes)
    if interface.header.kind == "ccsds" then
        return origin_of_space_packet(bytes)
    end
    return origin_of_plain_packet(tvb, bytes)
end

local function show_measurement(tvb, first, length, tree)
    local header, beam = interface.shot, interface.beam
    local rest = length - header.length
    local fits = rest == 0
    if beam and rest >= 0 then
        fits = rest > 0 and rest % beam.length == 0
    end
    if rest < 0 or not fits then
        return nil
    end
    local values = show(header, tvb, first, tree)
    local beams = beam and rest / beam.length or 0
    if values.beam_count ~= nil and values.beam_count ~= beams and beam then
        return nil
    end
    for k = 0, beams - 1 do
        local place = first + header.length + k * beam.length
        show(beam, tvb, place, tree:add(beam_field, tvb(place, beam.length), whole(k)))
    end
    return values.shot and "shot " .. tostring(whole(values.shot)) or "shot"
end

local function show_command(tvb, first, length, tree)
    local header = interface.command_header
    if length < header.length then
        return nil
    end
    local block, code = tvb(first, header.length):raw(), nil
    for _, field in ipairs(header.fields) do
        if field.key == "command" then
            code = value_of(tvb(first, header.length):tvb(), block, field)
        end
    end
    local command = interface.commands[code]
    if command == nil then
        show(header, tvb, first, tree)
        return "command " .. tostring(whole(code)) .. ", unknown"
    elseif length ~= command.layout.length then
        return nil
    end
    show(command.layout, tvb, first, tree)
    return "command " .. command.name
end

local function show_body(kind, tvb, first, length, tree)
    if kind == "measurement" then
        return show_measurement(tvb, first, length, tree)
    elseif kind == "command" and interface.command_header then
        return show_command(tvb, first, length, tree)
    end
    local layout = interface[kind]
    if layout == nil or layout.length ~= length then
        return nil
    end
    show(layout, tvb, first, tree)
    return kind
end

-- Show a packet without its framing; `head` holds the bytes of its frame before it. Returns its summary.
local function show_packet(tvb, head, root)
    local bytes = tvb:raw()
    local tree = root:add(protocol, tvb())
    local crc_length = interface.crc and interface.crc.length or 0
    local first = interface.header.length
    local length = #bytes - first - crc_length
    if length <= 0 then
        tree:add_proto_expert_info(expert.length)
        return "too short"
    end
    if interface.crc then
        local item = tree:add(crc_field, tvb(#bytes - crc_length, crc_length), whole(stated_crc(bytes)))
        if not crc_matches(bytes, head) then
            item:add_proto_expert_info(expert.crc)
            return "bad CRC"
        end
    end
    local kind, unit, sequence, stated = origin_of(tvb, bytes)
    if kind == nil then
        tree:add_proto_expert_info(expert.foreign)
        return "foreign"
    end
    local place = tvb(0, first)
    tree:add(kind_field, place, kind)
    tree:add(unit_field, place, whole(unit))
    if sequence ~= nil then
        tree:add(sequence_field, place, whole(sequence))
    end
    local summary = (stated == nil or stated == #bytes) and show_body(kind, tvb, first, length, tree)
    if not summary then
        tree:add_proto_expert_info(expert.length)
        return "bad length"
    end
    tree:append_text(", " .. summary)
    return summary
end

------------------------------------------------------------------------------------------------- frames

local function unstuffed_cobs(frame)
    local parts, position = {}, 1
    while position <= #frame do
        local code = frame:byte(position)
        if position + code - 1 > #frame then
            return nil
        end
        parts[#parts + 1] = frame:sub(position + 1, position + code - 1)
        position = position + code
        if code < 255 and position <= #frame then
            parts[#parts + 1] = "\0"
        end
    end
    return table.concat(parts)
end

local function unstuffed_slip(frame)
    local invalid = false
    local data = frame:gsub("\219(.?)", function(code)
        invalid = invalid or (code ~= "\220" and code ~= "\221")
        return code == "\220" and "\192" or "\219"
    end)
    return not invalid and data or nil
end

local function show_stuffed(packet, at, name, root)
    if packet == nil then
        root:add(protocol, at):add_proto_expert_info(expert.framing)
        return "bad framing"
    end
    if packet == "" then
        root:add(protocol, at):add_proto_expert_info(expert.length)
        return "too short"
    end
    return show_packet(ByteArray.new(packet, true):tvb(name), "", root)
end

-- Frames between delimiters. Returns summaries, and where a frame begins that has not ended.
local function show_delimited(tvb, root)
    local cobs = interface.framing.kind == "cobs"
    local delimiter, unstuff = cobs and "\0" or "\192", cobs and unstuffed_cobs or unstuffed_slip
    local bytes, found, start = tvb:raw(), {}, 1
    while true do
        local finish = bytes:find(delimiter, start, true)
        if finish == nil then
            return found, start - 1
        elseif finish > start then
            local packet = unstuff(bytes:sub(start, finish - 1))
            found[#found + 1] = show_stuffed(packet, tvb(start - 1, finish - start), "Packet", root)
        end
        start = finish + 1
    end
end

local function unsigned(bytes, big_endian)
    local value = 0
    for k = 1, #bytes do
        value = value * 256 + bytes:byte(big_endian and k or #bytes - k + 1)
    end
    return value
end

-- Frames that start with a sync word and their length.
local function show_synced(tvb, root)
    local framing, bytes, found, start = interface.framing, tvb:raw(), {}, 1
    local sync = framing.sync:gsub("%x%x", function(digits) return string.char(tonumber(digits, 16)) end)
    while true do
        local begin = bytes:find(sync, start, true)
        if begin == nil then
            return found, math.max(start - 1, #bytes - #sync + 1)
        end
        local head_end = begin + #sync + framing.length_bytes
        if head_end > #bytes + 1 then
            return found, begin - 1
        end
        local length = unsigned(bytes:sub(begin + #sync, head_end - 1), framing.big_endian) - framing.uncounted
        if length <= 0 or length > framing.longest then
            start = begin + 1
        elseif head_end + length - 1 > #bytes then
            return found, begin - 1
        else
            local summary = show_packet(tvb(head_end - 1, length):tvb(), bytes:sub(begin, head_end - 1), root)
            found[#found + 1] = summary
            start = summary == "bad CRC" and begin + 1 or head_end + length
        end
    end
end

function protocol.dissector(tvb, pinfo, root)
    local show_frames = interface.framing.kind == "sync" and show_synced or show_delimited
    local found, rest = show_frames(tvb, root)
    if rest < tvb:len() then
        if pinfo.can_desegment > 0 then
            pinfo.desegment_offset, pinfo.desegment_len = rest, DESEGMENT_ONE_MORE_SEGMENT
        else
            root:add(protocol, tvb(rest)):add_proto_expert_info(expert.part)
        end
    end
    pinfo.cols.protocol = "$protocol"
    if #found > 0 then
        pinfo.cols.info = table.concat(found, ", ")
    end
end

-- Whether a datagram is one whole frame with the right CRC.
local function is_ours(tvb, pinfo, root)
    local bytes, packet, head = tvb:raw(), nil, ""
    if interface.crc == nil then
        return false
    elseif interface.framing.kind == "sync" then
        local first = #interface.framing.sync / 2 + interface.framing.length_bytes
        head, packet = bytes:sub(1, first), bytes:sub(first + 1)
    elseif interface.framing.kind == "cobs" then
        packet = unstuffed_cobs(bytes:match("^%z*([^%z]+)%z+$$") or "\255")
    else
        packet = unstuffed_slip(bytes:match("^\192*([^\192]+)\192+$$") or "\219")
    end
    if packet == nil or #packet <= interface.header.length + interface.crc.length or not crc_matches(packet, head) then
        return false
    end
    protocol.dissector(tvb, pinfo, root)
    return true
end

protocol:register_heuristic("udp", is_ours)
-- Which of these tables there are depends on the version of Wireshark.
for _, name in ipairs({ "udp.port", "tcp.port", "rtacser.data" }) do
    pcall(function() DissectorTable.get(name):add_for_decode_as(protocol) end)
end

---------------------------------------------------------------------------------------------------- CAN

if can_protocol then
    local messages, can = {}, interface.can
    local id_field = Field.new("can.id")
    local slot_field = ProtoField.uint32("${protocol}_can.beam", "beam")
    local can_unit_field = ProtoField.uint32("${protocol}_can.unit", "unit")
    can_fields[1], can_fields[2] = slot_field, can_unit_field
    for _, message in ipairs(can.messages) do
        register(message.name, message.layout, can_fields, "${protocol}_can")
        for slot = 0, (message.slots or 1) - 1 do
            messages[message.id + slot] = { message = message, slot = message.slots and slot }
        end
    end
    can_protocol.fields = can_fields

    local function entry_of(tvb)
        local offset = (id_field() and id_field().value or -1) - can.base
        local unit = math.floor(offset / can.stride)
        local entry = messages[offset % can.stride]
        if unit >= 0 and unit < interface.units and entry and entry.message.layout.length == tvb:len() then
            return entry, unit
        end
    end

    local function show_frame(tvb, pinfo, root)
        local entry, unit = entry_of(tvb)
        if entry == nil then
            return false
        end
        local name = entry.message.name .. (entry.slot and " " .. entry.slot or "")
        local tree = root:add(can_protocol, tvb()):append_text(", " .. name)
        tree:add(can_unit_field, tvb(0, 0), whole(unit))
        if entry.slot then
            tree:add(slot_field, tvb(0, 0), entry.slot)
        end
        show(entry.message.layout, tvb, 0, tree)
        pinfo.cols.protocol = "${protocol}_can"
        pinfo.cols.info = name
        return true
    end

    can_protocol.dissector = show_frame
    can_protocol:register_heuristic("can", show_frame)
    pcall(function() DissectorTable.get("can.subdissector"):add_for_decode_as(can_protocol) end)
end
