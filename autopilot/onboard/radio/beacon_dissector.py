"""Wireshark's dissector of beacons, a Lua script generated from the beacon's layout.

A payload is dissected as a beacon if its first bytes are possible: the version, the phase, the flags and the
count of distances. All other payloads of the port, such as those of another application, are shown as data,
so that Wireshark does not guess a protocol from their bytes.
"""

from collections.abc import Iterator
from textwrap import dedent

import numpy as np

from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.radio import beacon as wire

FILE_NAME = "coflight_beacon.lua"
PREFIX = "coflight_beacon"
"""Name of the protocol in display filters; a field's name follows after a dot, that of a distance after
``.range.``."""
LENGTH_ERROR = f"{PREFIX}.length_error"
"""Filter of the expert information on payloads whose length is not that of their count of distances."""
FLAGS = {"start": wire.HAS_START, "fix": wire.HAS_FIX, "gps_error": wire.HAS_GPS_ERROR}
"""Bits of the flags by the last part of their filter, after ``.flags.``."""
_FLAG_OF = {"motion_start_ms": wire.HAS_START, "fix_": wire.HAS_FIX, "error_": wire.HAS_GPS_ERROR}
"""Bit without which a field is unknown, by the beginning of its name."""
_KINDS = {"u1": "uint8", "u2": "uint16", "u4": "uint32", "u8": "uint64", "f4": "float"}
_UNITS = {"_m_s": "m/s", "_m": "m", "_mm": "mm", "_ms": "ms", "_us": "us"}
_WORDS = {
    "n": "north", "e": "east", "d": "down", "h": "horizontal", "v": "vertical", "std": "standard deviation",
    "vel": "velocity", "fix": "GPS position", "error": "GPS error", "seq": "sequence number",
    "count": "number of ranges", "start": "motion start",
}  # fmt: skip
_TEXTS = {
    "time_us": "Time of the odometry", "motion_start_ms": "Motion start", "fix_ms": "GPS position, time",
    "gps_error": "GPS error", "peer": "Peer UAV", "time_ms": "Time of the measurement",
}  # fmt: skip
"""Names that do not follow from `_WORDS`."""
_RULES = """
local function is_beacon(payload)
  if payload:len() < LEADING_BYTES then return false end
  for _, check in ipairs(leading) do
    local value = payload(check.at, 1):uint()
    if value < check.least or value > check.most then return false end
  end
  return true
end

local function add_fields(tree, payload, begin, fields, flags)
  for _, each in ipairs(fields) do
    if begin + each.at + each.size > payload:len() then return end
    local item = tree:add_le(each.field, payload(begin + each.at, each.size))
    if each.unit then item:append_text(" " .. each.unit) end
    local value = each.most and payload(begin + each.at, each.size):le_uint()
    if value and value == each.most then item:append_text(" or more") end
    if each.needs and math.floor(flags / each.needs) % 2 == 0 then
      item:append_text(" (unknown)")
    elseif each.unstated and value == 0 then
      item:append_text(" (not stated)")
    end
    for _, flag in ipairs(each.flags or {}) do item:add_le(flag, payload(begin + each.at, each.size)) end
  end
end

function beacon.dissector(payload, packet, tree)
  local size = payload:reported_len()
  if not is_beacon(payload) then
    Dissector.get("data"):call(payload, packet, tree)
    return size
  end
  local station, count = payload(STATION_AT, 1):uint(), payload(COUNT_AT, 1):uint()
  local ranges = count .. (count == 1 and " range" or " ranges")
  packet.cols.protocol = "coflight"
  packet.cols.info = "beacon of UAV " .. station .. ", " .. ranges
  local root = tree:add(beacon, payload(), "coflight beacon of UAV " .. station .. ", " .. ranges)
  local flags = payload(FLAGS_AT, 1):uint()
  add_fields(root, payload, 0, header_fields, flags)
  for k = 0, count - 1 do
    local begin = HEADER_BYTES + k * RANGE_BYTES
    if begin + RANGE_BYTES > payload:len() then break end
    local peer = payload(begin + PEER_AT, 1):uint()
    local part = root:add(beacon, payload(begin, RANGE_BYTES), "Range to UAV " .. peer)
    add_fields(part, payload, begin, range_fields, flags)
  end
  local expected = HEADER_BYTES + count * RANGE_BYTES
  if size ~= expected then
    root:add_proto_expert_info(
      length_error, size .. " bytes; a beacon with " .. ranges .. " has " .. expected .. " bytes")
  end
  return size
end

DissectorTable.get("udp.port"):add(PORT, beacon)
"""


def dissector(port: int) -> str:
    """Return the Lua script for datagrams to a UDP port: ``wireshark -X lua_script:FILE CAPTURE``."""
    header, ranges = wire.HEADER, wire.RANGE
    at = {name: offset for name, _, offset in _placed(header)}
    leading = {
        "version": (wire.VERSION, wire.VERSION),
        "phase": (min(FlightPhase), max(FlightPhase)),
        "flags": (0, sum(FLAGS.values())),
        "count": (0, wire.MAX_RANGES),
    }
    checks = [
        f"  {{at = {at[name]}, least = {least:d}, most = {most:d}}},  -- {name}"
        for name, (least, most) in leading.items()
    ]
    head = f"""
        -- Wireshark dissector of coflight's beacons, version {wire.VERSION}, generated from their layout:
        --   wireshark -X lua_script:{FILE_NAME} radio.pcapng
        local PORT = {port}
        local HEADER_BYTES, RANGE_BYTES = {header.itemsize}, {ranges.itemsize}
        local STATION_AT, FLAGS_AT, COUNT_AT = {at["station"]}, {at["flags"]}, {at["count"]}
        local LEADING_BYTES = {1 + max(at[name] for name in leading)}
        local PEER_AT = {next(offset for name, _, offset in _placed(ranges) if name == "peer")}
        local beacon = Proto("{PREFIX}", "coflight beacon")
        local length_error = ProtoExpert.new("{LENGTH_ERROR}", "Length is not that of the number of ranges",
          expert.group.MALFORMED, expert.severity.ERROR)
    """
    phases = ", ".join(f'[{phase:d}] = "{phase.name.lower().replace("_", " ")}"' for phase in FlightPhase)
    flags = [
        f'local has_{name} = ProtoField.bool("{PREFIX}.flags.{name}", "{_text(name)} known", 8, nil, {bit})'
        for name, bit in FLAGS.items()
    ]
    parts = [
        dedent(head).strip(),
        f"local phases = {{{phases}}}",
        *flags,
        "local leading = {",
        *checks,
        "}",
        *_table("header_fields", header, PREFIX),
        *_table("range_fields", ranges, f"{PREFIX}.range"),
        f"local all_fields = {{{', '.join(f'has_{name}' for name in FLAGS)}}}",
        "for _, fields in ipairs({header_fields, range_fields}) do",
        "  for _, each in ipairs(fields) do table.insert(all_fields, each.field) end",
        "end",
        "beacon.fields = all_fields",
        "beacon.experts = {length_error}",
    ]
    return "\n".join(parts) + "\n" + _RULES


def _placed(layout: np.dtype[np.void]) -> Iterator[tuple[str, np.dtype[np.generic], int]]:
    """Yield name, type and offset in bytes of each field."""
    for name, (kind, offset, *_) in (layout.fields or {}).items():
        yield name, kind, offset


def _table(title: str, layout: np.dtype[np.void], prefix: str) -> Iterator[str]:
    """Yield the lines of a table of fields: offset, size, field and, for some, unit and flags."""
    yield f"local {title} = {{"
    for name, kind, offset in _placed(layout):
        unit = next((unit for suffix, unit in _UNITS.items() if name.endswith(suffix)), "")
        arguments = f'"{prefix}.{name}", "{_text(name)}"'
        if name == "phase":
            arguments += ", base.DEC, phases"
        more = f', unit = "{unit}"' if unit else ""
        more += f", most = {wire.MOST_MM}" if unit == "mm" else ""
        if prefix == PREFIX:
            needs = next((bit for begin, bit in _FLAG_OF.items() if name.startswith(begin)), 0)
            more += f", needs = {needs}" if needs else ""
            more += ", unstated = true" if name.startswith("fix_std_") else ""
        if name == "flags":
            more = f", flags = {{{', '.join(f'has_{flag}' for flag in FLAGS)}}}"
        field = f"ProtoField.{_KINDS[kind.str[1:]]}({arguments})"
        yield f"  {{at = {offset}, size = {kind.itemsize}, field = {field}{more}}},"
    yield "}"


def _text(name: str) -> str:
    """Return the name of a field or flag in words, without its unit."""
    if name in _TEXTS:
        return _TEXTS[name]
    for suffix in _UNITS:
        if name.endswith(suffix):
            name = name.removesuffix(suffix)
            break
    words = " ".join(_WORDS.get(word, word) for word in name.split("_"))
    return words[0].upper() + words[1:]
