"""Contents of a vehicle's files: the component metadata, and the packed parameters."""

import json
import lzma
import struct

import pytest
from ftp_client import Downloader
from lossy import play

from autopilot.mavlink.codec import Encoder, Parser
from autopilot.mavlink.crc import crc32
from autopilot.parameters.table import ROWS, ParameterSet, Settings
from autopilot.services import metadata
from autopilot.services.files import FileStore
from autopilot.services.ftp import FtpService


def vehicle_files():
    files, parameters = FileStore(), ParameterSet(Settings())
    metadata.add_files(files, parameters)
    return files, parameters


def read_whole(files, path):
    station = Downloader(path.encode(), session=3)
    play(FtpService(files), station, packed=True)
    assert station.done
    return station.content


def test_the_metadata_are_found_from_the_message_and_describe_every_parameter():
    files, parameters = vehicle_files()
    message = metadata.message(1_234_567)
    (received,) = Parser().push(Encoder(system=1, component=1).encode(message))
    assert received.time_boot_ms == 1_234
    general_text = lzma.decompress(read_whole(files, received.uri.removeprefix("mftp://")))
    assert crc32(general_text) == received.file_crc
    general = json.loads(general_text)
    assert general["version"] == 1
    (entry,) = general["metadataTypes"]
    text = lzma.decompress(read_whole(files, entry["uri"].removeprefix("mftp://")))
    assert (entry["type"], entry["fileCrc"]) == (1, crc32(text))
    described = json.loads(text)
    assert described["version"] == 1
    assert [row["name"] for row in described["parameters"]] == [row.name for row in ROWS]
    for row, about in zip(ROWS, described["parameters"], strict=True):
        assert about["type"] == ("Int32" if row.is_integer else "Float")
        assert about["min"] <= about["default"] <= about["max"]
        assert about["default"] == pytest.approx(parameters.get(row.name), rel=1e-6)
        assert about["shortDesc"]
        assert about["group"]


def unpacked(data):
    """Decode the packed parameters by the format's description: (name, value, default or None) of each."""
    magic, count, total = struct.unpack_from("<HHH", data)
    assert magic in {0x671B, 0x671C}
    values, at, name = [], 6, ""
    while at < len(data):
        kind, lengths = data[at], data[at + 1]
        suffix = (lengths >> 4) + 1
        name = name[: lengths & 15] + data[at + 2 : at + 2 + suffix].decode()
        at += 2 + suffix
        code = {3: "<i", 4: "<f"}[kind & 15]
        numbers = [struct.unpack_from(code, data, at)[0]]
        at += 4
        if kind >> 4:
            assert magic == 0x671C
            numbers.append(struct.unpack_from(code, data, at)[0])
            at += 4
        values.append((name, *numbers))
    assert len(values) == count
    return total, values


def test_the_packed_parameters_have_the_values_at_the_time_of_opening():
    files, parameters = vehicle_files()
    parameters.set("MPC_XY_P", 1.25)
    total, values = unpacked(read_whole(files, "@PARAM/param.pck?withdefaults=1"))
    assert total == len(ROWS)
    assert [value[0] for value in values] == [row.name for row in ROWS]
    for name, value, *_ in values:
        assert value == pytest.approx(parameters.get(name), rel=1e-6)
    assert [value for value in values if len(value) > 2] == [("MPC_XY_P", 1.25, pytest.approx(0.95))]
    _, part = unpacked(read_whole(files, "@PARAM/param.pck?start=10&count=5"))
    assert [value[0] for value in part] == [row.name for row in ROWS[10:15]]
    for query in ("start=99999999", "count=-1", "start=x&=&", "%", "withdefaults"):
        unpacked(files.open(f"@PARAM/param.pck?{query}").data)
