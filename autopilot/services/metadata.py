"""Parameter metadata files for stations: QGroundControl's JSON metadata, and MAVProxy's packed values.

The metadata are xz-compressed JSON, announced by COMPONENT_METADATA: a general file that refers to the file
of the parameters. They are generated on the first request; `@PARAM/param.pck` whenever it is opened.
"""

import json
import lzma
import struct
from functools import cache

from autopilot.mavlink.codec import Message
from autopilot.mavlink.crc import crc32
from autopilot.mavlink.dialect import ComponentMetadata
from autopilot.parameters import parameter_docs
from autopilot.parameters.table import ROWS, ParameterSet, Row, Settings
from autopilot.services.files import Contents, FileStore
from autopilot.services.parameter import value_bytes

COMPONENT_METADATA: int = ComponentMetadata.id
GENERAL_PATH = "/etc/extras/component_general.json.xz"
PARAMETERS_PATH = "/etc/extras/parameters.json.xz"
PACKED_PATH = "@PARAM/param.pck"
_PARAMETER = 1
"""COMP_METADATA_TYPE_PARAMETER"""
_VERSION = 1
_FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 3, "dict_size": 1 << 16}]
"""A small dictionary for small decoders; 5 % larger than the best preset, in a tenth of its time."""
_PACKED, _PACKED_WITH_DEFAULTS = 0x671B, 0x671C
_INT32, _FLOAT = 3, 4
_HAS_DEFAULT = 0x10
_MOST_DECIMALS = 7


def add_files(files: FileStore, parameters: ParameterSet) -> None:
    """Add the files of a vehicle with these parameters."""
    files.add(GENERAL_PATH, lambda _query: Contents(compressed(general())))
    files.add(PARAMETERS_PATH, lambda _query: Contents(compressed(parameters_json())))
    files.add(PACKED_PATH, lambda query: packed(parameters, query))


def message(now_us: int) -> Message:
    """COMPONENT_METADATA at a time since the start."""
    return ComponentMetadata(
        time_boot_ms=now_us // 1_000, file_crc=crc32(general()), uri=f"mftp://{GENERAL_PATH}"
    )


@cache
def general() -> bytes:
    """The general file, before compression."""
    uri = f"mftp://{PARAMETERS_PATH}"
    entry = {"type": _PARAMETER, "uri": uri, "fileCrc": crc32(parameters_json())}
    return json.dumps({"version": _VERSION, "metadataTypes": [entry]}).encode()


@cache
def parameters_json() -> bytes:
    """Metadata of all parameters, before compression."""
    defaults = ParameterSet(Settings())
    rows = [_described(row, defaults.get(row.name)) for row in ROWS]
    return json.dumps({"version": _VERSION, "parameters": rows}, separators=(",", ":")).encode()


@cache
def compressed(data: bytes) -> bytes:
    """Compress as xz with the checksum that small decoders support."""
    return lzma.compress(data, format=lzma.FORMAT_XZ, check=lzma.CHECK_CRC32, filters=_FILTERS)


def packed(parameters: ParameterSet, query: str = "") -> Contents:
    """Values in MAVProxy's packed format; each name is stored without the prefix it shares with the last one.

    ``query`` is of the form ``withdefaults=1&start=10&count=5``; defaults are included where values differ.
    """
    options = dict(option.split("=", 1) for option in query.split("&") if "=" in option)
    with_defaults = options.get("withdefaults") == "1"
    start = min(_count(options.get("start", ""), 0), len(ROWS))
    rows = ROWS[start : start + _count(options.get("count", ""), len(ROWS))]
    defaults = ParameterSet(Settings())
    data = struct.pack("<HHH", _PACKED_WITH_DEFAULTS if with_defaults else _PACKED, len(rows), len(ROWS))
    before = ""
    for row in rows:
        value = value_bytes(row.is_integer, parameters.get(row.name))
        default = value_bytes(row.is_integer, defaults.get(row.name))
        has_default = with_defaults and default != value
        common = next(
            (place for place, pair in enumerate(zip(row.name, before, strict=False)) if pair[0] != pair[1]),
            min(len(row.name), len(before)),
        )
        suffix = row.name[common:].encode()
        kind = (_INT32 if row.is_integer else _FLOAT) | (_HAS_DEFAULT if has_default else 0)
        data += struct.pack("<BB", kind, len(suffix) - 1 << 4 | common) + suffix + value
        data += default if has_default else b""
        before = row.name
    return Contents(data)


def _count(text: str, otherwise: int) -> int:
    return int(text) if text.isdecimal() and len(text) < 6 else otherwise


def _described(row: Row, default: float) -> dict[str, object]:
    described: dict[str, object] = {
        "name": row.name,
        "type": "Int32" if row.is_integer else "Float",
        "group": parameter_docs.group(row),
        "category": "Standard",
        "shortDesc": parameter_docs.meaning(row),
        "default": _number(row, default),
        "min": _number(row, row.minimum),
        "max": _number(row, row.maximum),
    }
    if row.unit:
        described["units"] = row.unit
    if not row.is_integer:
        described["decimalPlaces"] = max(_decimals(default), _decimals(row.minimum))
    if row.name == "EKF2_GPS_DELAY":
        described["rebootRequired"] = True
    return described


def _number(row: Row, value: float) -> float:
    """Round a float to the decimal that represents its float32."""
    return round(value) if row.is_integer else float(f"{value:.7g}")


def _decimals(value: float) -> int:
    return len(f"{value:.{_MOST_DECIMALS}f}".rstrip("0").partition(".")[2])
