"""Wireshark's dissection of beacons by the generated Lua script. It takes 10 s, a flight among them.

Without tshark these tests are skipped; tests/unit/harness/records compares script and layout.
"""

import contextlib
import json
import shutil
import struct
import subprocess

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
from beacons import Beacon, decode, encode
from netsim_pcapng import blocks, datagram, transmission
from paths import SCENARIOS

from autopilot.onboard.client.own_state import Fix
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.radio import beacon as wire
from autopilot.onboard.radio.beacon_dissector import FILE_NAME, FLAGS, LENGTH_ERROR, PREFIX, dissector
from harness.launch.one_process import fly
from harness.records.run_folder import RunFolder
from harness.scenario.scenario_file import load
from netsim.capture.pcapng_writer import Capture
from netsim.model.config import RadioConfig
from netsim.wire.messages import DEFAULT_PORT

pytestmark = [
    pytest.mark.multiprocess,
    pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed (apt: tshark)"),
]

UDP_PAYLOAD_AT = 60
"""Offset in the MPDU: 802.11 24, LLC/SNAP 8, IPv4 20, UDP 8."""
EPOCH_UNIX_US = 1_767_225_600_000_000
FULL = Beacon(
    station=3,
    seq=2**32 - 1,
    time_us=2**40 + 1,
    phase=FlightPhase.ON_STATION,
    odometry_ned_m=(1.5, -2.25, 3.125),
    vel_ned_m_s=(0.1, -0.2, 0.3),
    motion_start_ms=77_000,
    fix=Fix(76_000, (10.1, -20.2, -30.3), 1.5, 2.5),
    gps_error=wire.GpsError((0.4, 0.5, -0.6), 1.25),
    distances=tuple(
        wire.Distance(peer, 70_000 + peer, 8.1 * peer + 1, 0.026) for peer in (0, 1, 2, 4, 5, 6, 7)
    ),
)
BARE = Beacon(
    station=200,
    seq=0,
    time_us=0,
    phase=FlightPhase.WAITING,
    odometry_ned_m=(0.0, 0.0, 0.0),
    vel_ned_m_s=(0.0, 0.0, 0.0),
)


def tshark(path, script, *arguments):
    command = ["tshark", "-n", "-X", f"lua_script:{script}", "-r", str(path), *arguments]
    result = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    assert "Lua" not in result.stderr
    return result.stdout


def dissected(path, script):
    """Return for each packet with a UDP payload the last protocol, the columns, and whether it is flagged."""
    fields = ("frame.protocols", "_ws.col.Protocol", "_ws.col.Info", LENGTH_ERROR, "_ws.lua.error")
    options = [option for field in fields for option in ("-e", field)]
    text = tshark(path, script, "-Y", "udp", "-T", "fields", *options)
    rows = [line.split("\t") for line in text.splitlines()]
    assert not any(error for *_, error in rows)
    return [(row[0].rpartition(":")[2], row[1], row[2], row[3] != "") for row in rows]


def beacons_of(path, script):
    """Return for each beacon {filter: [(shown, bytes)]}, in the order of packets."""
    text = tshark(path, script, "-Y", PREFIX, "-T", "json", "-x", "-J", f"{PREFIX} frame")
    found = []
    for packet in json.loads(text, object_pairs_hook=tuple):
        shown, raw = {}, {}
        for name, value in leaves(packet):
            if name.startswith(f"{PREFIX}."):
                if name.endswith("_raw"):
                    raw.setdefault(name.removesuffix("_raw"), []).append(bytes.fromhex(value[0].zfill(2)))
                else:
                    shown.setdefault(name, []).append(value)
        assert shown.keys() == raw.keys()
        found.append({name: list(zip(shown[name], raw[name], strict=True)) for name in shown})
    return found


def leaves(pairs):
    """Yield (name, value) of all fields below nested objects, which are tuples of pairs."""
    for name, value in pairs:
        if isinstance(value, tuple):
            yield from leaves(value)
        else:
            yield name, value


def labels_of(path, script):
    """Return for each beacon the lines of its dissection."""
    text = tshark(path, script, "-Y", PREFIX, "-O", PREFIX)
    return [
        [line.strip() for line in packet.splitlines()] for packet in text.split("coflight beacon of UAV ")[1:]
    ]


def compare(fields, payload):
    """Compare all fields of a beacon with the layout of `autopilot.onboard.radio.beacon`."""
    assert decode(payload) is not None
    header = np.frombuffer(payload, wire.HEADER, 1)
    ranges = np.frombuffer(payload, wire.RANGE, offset=wire.HEADER_BYTES)
    expected = {f"{PREFIX}.{name}": header[name] for name in wire.HEADER.names}
    expected |= {f"{PREFIX}.range.{name}": ranges[name] for name in wire.RANGE.names if len(ranges)}
    bits = {f"{PREFIX}.flags.{name}": bit for name, bit in FLAGS.items()}
    assert fields.keys() == expected.keys() | bits.keys()
    for name, values in expected.items():
        assert [value for _, value in fields[name]] == [value.tobytes() for value in values]
        # Wireshark shows single precision with six digits
        numbers = [f"{v:.6g}" if values.dtype.kind == "f" else str(v) for v in values.tolist()]
        assert [float(shown) for shown, _ in fields[name]] == [float(number) for number in numbers]
    for name, bit in bits.items():
        ((shown, _),) = fields[name]
        assert shown == str(int(bool(header["flags"][0] & bit)))


def payloads(path):
    """Return the UDP payloads of a capture's data frames, in the order of packets."""
    found = []
    for kind, body in blocks(path.read_bytes()):
        if kind == 6:
            (size,) = struct.unpack_from("<I", body, 12)
            packet = body[20 : 20 + size]
            frame = packet[int.from_bytes(packet[2:4], "little") :]
            if frame[0] == 0x08:
                found.append(frame[UDP_PAYLOAD_AT:-4])
    return found


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    path = tmp_path_factory.mktemp("lua") / "coflight_beacon.lua"
    path.write_text(dissector(DEFAULT_PORT))
    return path


def written(path, contents):
    with contextlib.closing(Capture(path, config=RadioConfig(bandwidth_mhz=20))) as capture:
        for number, content in enumerate(contents):
            capture.append(transmission(datagram(content, sequence=number + 1), number * 10_000_000))
    return path


def test_beacons_of_a_flight_equal_those_of_the_decoder(tmp_path):
    """Two seconds after the radios are first used all have measured distances."""
    scenario = load(SCENARIOS / "article.toml", ["agents=3", "radio.capture=true"])
    fly(scenario, tmp_path / "run", until_s=4.5)
    folder = RunFolder(tmp_path / "run")
    contents = payloads(folder.capture)
    found = beacons_of(folder.capture, folder.path / FILE_NAME)
    assert len(found) == len(contents) > 50
    for fields, content in zip(found, contents, strict=True):
        compare(fields, content)
    assert max(len(content) for content in contents) == wire.HEADER_BYTES + 2 * wire.RANGE_BYTES
    rows = dissected(folder.capture, folder.path / FILE_NAME)
    assert rows == [
        (
            PREFIX,
            "coflight",
            f"beacon of UAV {content[1]}, {content[4]} ranges".replace(" 1 ranges", " 1 range"),
            False,
        )
        for content in contents
    ]
    times = tshark(folder.capture, folder.path / FILE_NAME, "-T", "fields", "-e", "frame.time_epoch").split()
    starts_ns = sorted(pq.read_table(folder.radio).to_pydict()["start_ns"])
    assert [int(each.replace(".", "")) for each in times] == [
        1_000 * EPOCH_UNIX_US + start_ns for start_ns in starts_ns
    ]


def test_fields_have_names_units_and_marks_if_unknown(tmp_path, script):
    beacons = (FULL, BARE)
    path = written(tmp_path / "radio.pcapng", map(encode, beacons))
    for fields, beacon in zip(beacons_of(path, script), beacons, strict=True):
        compare(fields, encode(beacon))
    known, unknown = labels_of(path, script)
    assert known[0] == "3, 7 ranges"
    assert {
        "Velocity north: 0.1 m/s",
        "GPS position standard deviation horizontal: 1500 mm",
        "Time of the odometry: 1099511627777 us",
        "Phase: on station (5)",
        "Range to UAV 7",
        "Distance: 57.7 m",
    } < set(known)
    assert not any("unknown" in line for line in known)
    groups = ("motion_start", "fix_", "error_")
    count = sum(name.startswith(groups) for name in wire.HEADER.names)
    assert sum(line.endswith(" (unknown)") for line in unknown) == count == 11
    assert "Motion start: 0 ms (unknown)" in unknown


def test_accuracies_that_are_not_stated_or_at_their_most_are_marked(tmp_path, script):
    beacon = msgspec.structs.replace(
        FULL,
        fix=Fix(76_000, (10.1, -20.2, -30.3), None, None),
        gps_error=wire.GpsError((0.4, 0.5, 0.6), 99.0),
    )
    (lines,) = labels_of(written(tmp_path / "radio.pcapng", [encode(beacon)]), script)
    for axis in ("horizontal", "vertical"):
        assert f"GPS position standard deviation {axis}: 0 mm (not stated)" in lines
    assert "GPS error standard deviation: 65535 mm or more" in lines
    assert sum("(not stated)" in line or "or more" in line for line in lines) == 3


def test_a_beacon_of_any_other_length_is_flagged(tmp_path, script):
    """From the five bytes that make it a beacon on, every truncation and extension; shorter ones are data."""
    whole = encode(FULL)
    contents = [whole[:size] for size in range(len(whole) + 1)] + [whole + b"\x00"]
    rows = dissected(written(tmp_path / "radio.pcapng", contents), script)
    named = "beacon of UAV 3, 7 ranges"
    for content, row in zip(contents[1:], rows[1:], strict=True):
        if len(content) < 5:
            assert row[0] == "data"
        else:
            assert row == (PREFIX, "coflight", named, content != whole)
    assert rows[0][3] is False


def test_other_payloads_are_data_whatever_wireshark_guesses(tmp_path, script):
    """Among them other versions, impossible first bytes, and a Thrift call, which Wireshark guesses."""
    draws = np.random.default_rng(4)
    call = b"\x80\x01\x00\x01\x00\x00\x00\x04ping" + b"\x00\x00\x00\x01" + b"\x00"
    whole = encode(FULL)
    contents = [
        call,
        bytes([wire.VERSION - 1]) + whole[1:],
        bytes([wire.VERSION + 1]) + whole[1:],
        whole[:2] + bytes([max(FlightPhase) + 1]) + whole[3:],
        whole[:3] + bytes([8]) + whole[4:],
        whole[:4] + bytes([wire.MAX_RANGES + 1]) + whole[5:],
        *(b"\xff" + draws.bytes(draws.integers(300)) for _ in range(100)),
    ]
    path = written(tmp_path / "radio.pcapng", contents)
    empty = tmp_path / "empty.lua"
    empty.write_text("")
    assert dissect_protocols(path, empty)[0] == "thrift"
    assert dissect_protocols(path, script) == ["data"] * len(contents)


def dissect_protocols(path, script):
    text = tshark(path, script, "-Y", "udp", "-T", "fields", "-e", "frame.protocols")
    return [line.rpartition(":")[2] for line in text.splitlines()]
