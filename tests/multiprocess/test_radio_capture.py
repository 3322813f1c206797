"""Wireshark's dissection of a capture. It takes 4 s, most of them starts of tshark.

Without tshark these tests are skipped; tests/unit/netsim/capture reads the bytes of captures.
"""

import contextlib
import math
import os
import shutil
import subprocess
from collections import Counter

import numpy as np
import pytest

from netsim.capture.pcapng_writer import Capture
from netsim.emulator.emulator import Emulator
from netsim.ftm.elements import Request, Status
from netsim.model.config import RadioConfig
from netsim.wire.addresses import GROUP_ADDRESS, ipv4_address, mac_address
from netsim.wire.messages import Broadcast, FtmRequest, TxBatch
from netsim.wire.packets import SentPacket

pytestmark = [
    pytest.mark.multiprocess,
    pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed (apt: tshark)"),
]

STATIONS = 5
PLACES_NED_M = np.array([(0.0, 12.0 * i, -10.0) for i in range(STATIONS)])
STEP_US = 4_000
END_US = 600_000
EPOCH_UNIX_US = 1_767_225_600_000_000
"""2026-01-01 00:00 UTC."""
PAYLOAD = b"coflight beacon "
SUBTYPES = {"rts": 0x1B, "cts": 0x1C, "ack": 0x1D, "data": 0x20, "ftm_request": 0x0D, "ftm": 0x0D}
"""Type and subtype of every kind in Wireshark's combined number."""
COMMENT, NOTE = str(0x00100000), str(0x00400000)
"""Severities of Wireshark's expert information, below warnings and errors."""
CHECK = ("wlan.check_checksum:TRUE", "ip.check_checksum:TRUE", "udp.check_checksum:TRUE")


class Run:
    """Five stations broadcast at nearly the same times, with RTS and CTS, and range to each other."""

    def __init__(self, folder):
        self.path, self.receivers_path = folder / "radio.pcapng", folder / "receivers.pcapng"
        self.transmissions = []
        config = RadioConfig(queue_lifetime_us=50_000, log_receptions=True)
        of_receivers = RadioConfig(queue_lifetime_us=50_000, capture="receivers")
        with (
            contextlib.closing(Capture(self.path, config=config, comment="seed 5")) as capture,
            contextlib.closing(
                Capture(
                    self.receivers_path, config=of_receivers, vehicles=STATIONS, epoch_unix_us=EPOCH_UNIX_US
                )
            ) as capture_of_receivers,
        ):

            def take(transmission):
                self.transmissions.append(transmission)
                capture.append(transmission)
                capture_of_receivers.append(transmission)

            self.emulator = Emulator(
                config=config, stations=STATIONS, seed=np.random.SeedSequence(5), on_transmission=take
            )
            self._fly()
        self.transmissions.sort(key=lambda t: (t.start_ns, t.source))

    def _fly(self):
        for station in range(STATIONS):
            items = []
            for number in range(30):
                at_us = 20_000 * number
                items.append(
                    Broadcast(
                        seq=2 * number,
                        at_us=at_us,
                        payload=PAYLOAD * (1 + number % 8),
                        port=4000 + number % 2,
                    )
                )
                peer = (station + 1 + number % (STATIONS - 1)) % STATIONS
                items.append(FtmRequest(seq=2 * number + 1, at_us=at_us + 2_500 * station, peer=peer))
            self.emulator.submit(TxBatch(station=station, now_us=0, items=tuple(items)))
        for at_us in range(0, END_US, STEP_US):
            self.emulator.advance(
                to_us=at_us + STEP_US,
                at_us=at_us,
                pos_ned_m=PLACES_NED_M,
                vel_ned_m_s=np.zeros_like(PLACES_NED_M),
            )


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return Run(tmp_path_factory.mktemp("capture"))


def tshark(path, *fields, condition="", preferences=CHECK):
    """Return rows of fields of the packets that match a condition; absent fields are empty."""
    command = ["tshark", "-n", "-r", str(path), "-T", "fields"]
    for preference in preferences:
        command += ["-o", preference]
    if condition:
        command += ["-Y", condition]
    for field in fields:
        command += ["-e", field]
    result = subprocess.run(
        command, capture_output=True, text=True, check=True, timeout=120, env=os.environ | {"TZ": "UTC"}
    )
    return [line.split("\t") for line in result.stdout.splitlines()]


def test_no_packet_is_malformed(run):
    """Wireshark reports comments and retries, and no warnings or errors."""
    assert tshark(run.path, "frame.number", "_ws.expert.message", condition="_ws.malformed") == []
    remarks = tshark(
        run.path, "frame.comment", "wlan.fc.retry", "_ws.expert.severity", condition="_ws.expert"
    )
    assert len(remarks) > 20
    for comment, retry, severities in remarks:
        expected = {COMMENT} if comment else set()
        assert set(severities.split(",")) == (expected | {NOTE} if retry == "1" else expected)


def test_every_transmission_has_its_kind_time_and_valid_checksums(run):
    rows = tshark(
        run.path, "frame.time_epoch", "radiotap.timestamp.ts", "wlan.fc.type_subtype", "frame.len",
        "radiotap.length", "wlan.fcs.status", "ip.checksum.status", "udp.checksum.status",
    )  # fmt: skip
    counted = Counter()
    for kind, count in run.emulator.counters.frames_sent.items():
        counted[SUBTYPES[kind]] += count
        assert count > 20
    assert Counter(int(row[2], 0) for row in rows) == counted
    times_ns = [int(row[0].replace(".", "")) for row in rows]
    assert times_ns == [t.start_ns for t in run.transmissions]
    assert times_ns == [int(row[1]) for row in rows]
    assert [int(row[3]) - int(row[4]) for row in rows] == [t.frame.frame_bytes for t in run.transmissions]
    good = [["1", "1", "1"] if t.frame.kind == "data" else ["1", "", ""] for t in run.transmissions]
    assert [row[5:] for row in rows] == good


def test_payloads_addresses_and_retries_match_the_frames(run):
    rows = tshark(
        run.path, "udp.payload", "udp.srcport", "udp.dstport", "ip.id", "ip.src", "ip.dst", "wlan.sa",
        "wlan.da", "wlan.fc.retry", condition="wlan.fc.type_subtype == 32",
    )  # fmt: skip
    sent = [t.frame for t in run.transmissions if t.frame.kind == "data"]
    assert len(rows) == len(sent)
    for row, frame in zip(rows, sent, strict=True):
        assert row == [
            frame.body.payload.hex(),
            str(frame.body.port),
            str(frame.body.port),
            f"0x{frame.seq:04x}",
            f"10.1.0.{frame.source}",
            "10.255.255.255",
            f"02:00:00:00:00:{frame.source:02x}",
            "ff:ff:ff:ff:ff:ff",
            "0",
        ]
    rows = tshark(run.path, "wlan.ta", "wlan.seq", "wlan.fc.retry", condition="wlan.fc.type_subtype == 13")
    first = set()
    for sender, sequence, retry in rows:
        assert retry == str(int((sender, sequence) in first))
        first.add((sender, sequence))
    assert 0 < sum(retry == "1" for _, _, retry in rows) < len(rows) / 2


def test_a_vht_frame_is_an_a_mpdu_of_its_own(run):
    """Each has one MPDU, which is the last, in a subframe with the EOF bit, and a reference number."""
    for path in (run.path, run.receivers_path):
        rows = tshark(
            path, "radiotap.present.ampdu", "radiotap.present.vht", "radiotap.ampdu.reference",
            "radiotap.ampdu.flags.lastknown", "radiotap.ampdu.flags.last", "radiotap.ampdu.flags.eof",
            "radiotap.ampdu.flags.delim_crc_error", "radiotap.vht.mcs.0", "radiotap.vht.nss.0",
            "radiotap.vht.bw", "wlan.fc.type_subtype",
        )  # fmt: skip
        vht = [row for row in rows if row[1] == "1"]
        assert {int(row[10], 0) for row in vht} == {13}  # ranging
        assert {tuple(row[3:10]) for row in vht} == {("1", "1", "1", "0", "0", "1", "4")}
        assert len({row[2] for row in vht}) == len(vht) > 20
        assert {tuple(row[:1] + row[2:10]) for row in rows if row[1] != "1"} == {("0", *[""] * 8)}
    assert tshark(run.path, "frame.number", condition="_ws.malformed") == []


def test_wireshark_computes_the_same_durations_and_gaps(run):
    """Durations of non-HT frames follow from rate and length; Wireshark's for VHT are rough estimates.

    With TSFT where the MPDU begins, every CTS follows its RTS after SIFS, 16 us, and the propagation delay
    of up to 48 m, 0.16 us; Wireshark counts whole microseconds, which may add one.
    """
    rows = tshark(
        run.path, "wlan_radio.phy", "wlan_radio.duration", "wlan_radio.start_tsf", "wlan_radio.ifs",
        preferences=("wlan_radio.tsf_at_end:FALSE",),
    )  # fmt: skip
    durations = gaps = 0
    before = None
    for (phy, duration_us, start_us, gap_us), sent in zip(rows, run.transmissions, strict=True):
        assert phy == ("8" if sent.frame.mode.vht else "5")
        if phy == "5":
            assert int(duration_us) * 1_000 == sent.end_ns - sent.start_ns
            assert int(start_us) == sent.start_ns // 1_000
            durations += 1
        # of two RTS within aCCATime the first may be answered, at a shorter gap after the second
        answered = before is not None and before.source == sent.frame.destination
        if answered and (before.frame.kind, sent.frame.kind) == ("rts", "cts"):
            assert 16 <= int(gap_us) <= 17
            gaps += 1
        before = sent
    assert durations > 500
    assert gaps > 50


def test_ranging_frames_are_dissected_to_their_fields(run):
    """Compare all fields of every request and measurement, including those of a parameters element."""
    rows = tshark(
        run.path, "wlan.fixed.publicact", "wlan.fixed.trigger", "wlan.fixed.dialog_token",
        "wlan.fixed.followup_dialog_token", "wlan.fixed.ftm_tod", "wlan.fixed.ftm_toa",
        *(f"wlan.fixed.ftm.param.{name}" for name in (
            "status_indication", "min_delta_ftm", "asap", "ftm_per_burst", "format_and_bw", "burst_period",
        )),
        condition="wlan.fc.type_subtype == 13",
    )  # fmt: skip
    bodies = [t.frame.body for t in run.transmissions if t.frame.kind in {"ftm", "ftm_request"}]
    assert len(rows) == len(bodies)
    granted = measured = 0
    for row, body in zip(rows, bodies, strict=True):
        numbers = [int(field, 0) if field else None for field in row]
        if isinstance(body, Request):
            assert numbers[:6] == [32, int(body.trigger), None, None, None, None]
        else:
            assert numbers[:6] == [33, None, body.token, body.followed, body.t1_ps, body.t4_ps]
            measured += body.followed > 0
        parameters = body.parameters
        if parameters is None:
            assert numbers[6:] == 6 * [None]
            continue
        assert numbers[6:] == [
            int(parameters.status),
            (parameters.min_delta_us or 0) // 100,
            int(parameters.asap),
            parameters.ftms_per_burst or 0,
            parameters.format_and_bandwidth or 0,
            (parameters.burst_period_ms or 0) // 100,
        ]
        granted += parameters.status == Status.SUCCESSFUL
    assert granted > 20
    assert measured > 100


def test_stations_interfaces_have_dates_signals_and_frames_with_errors(run):
    """A frame with errors has a wrong FCS and the flag of it; all others have neither.

    Wireshark calls a frame with a wrong FCS malformed if it checks the FCS.
    """
    rows = tshark(
        run.receivers_path, "frame.interface_name", "frame.time_epoch", "radiotap.dbm_antsignal",
        "radiotap.dbm_antnoise", "radiotap.flags.badfcs", "wlan.fcs.status",
    )  # fmt: skip
    expected = []
    for each in run.transmissions:
        expected.append((f"uav {each.source}", EPOCH_UNIX_US * 1_000 + each.start_ns, "", "", "0", "1"))
        for stations, flag, status in ((each.received, "0", "1"), (each.received_in_error, "1", "0")):
            for station in stations:
                time_ns = EPOCH_UNIX_US * 1_000 + each.start_ns + each.delays_ns.item(station)
                level = str(round(10 * math.log10(each.powers_mw[station])))
                expected.append((f"uav {station}", time_ns, level, "-88", flag, status))
    found = [(name, int(time_s.replace(".", "")), *rest) for name, time_s, *rest in rows]
    assert sorted(found) == sorted(expected)
    assert [time_ns for _, time_ns, *_ in found] == sorted(time_ns for _, time_ns, *_ in found)
    assert sum(row[4] == "1" for row in found) > 20
    dates = tshark(run.receivers_path, "frame.time", condition="frame.number == 1")
    assert dates[0][0].startswith("Jan  1, 2026 00:00:00.000")
    malformed = tshark(run.receivers_path, "radiotap.flags.badfcs", condition="_ws.malformed")
    assert malformed == [["1"]] * sum(row[4] == "1" for row in found)
    assert tshark(run.receivers_path, "frame.number", condition="_ws.malformed", preferences=()) == []


def test_packets_of_interfaces_are_decoded_by_their_type(tmp_path):
    """An ARP request, an ICMPv6 router solicitation and an IPv4 datagram to one station."""
    path = tmp_path / "packets.pcapng"
    config = RadioConfig(rician_k_db=None, broadcast_rts=False)
    multicast = bytes.fromhex("333300000002")
    arp = bytes.fromhex("0001080006040001") + mac_address(1) + ipv4_address(1) + bytes(6) + ipv4_address(2)
    solicitation = bytes.fromhex(
        "6000000000083afffe800000000000000000000000000001ff020000000000000000000000000002"
        "85007bb800000000"
    )  # fmt: skip
    datagram = (
        bytes.fromhex("4500001c00004000401126cd") + ipv4_address(1) + ipv4_address(2)
        + bytes.fromhex("1f901f9100080000")
    )  # fmt: skip
    with contextlib.closing(Capture(path, config=config)) as capture:
        emulator = Emulator(
            config=config, stations=3, seed=np.random.SeedSequence(5), on_transmission=capture.append
        )
        for number, (destination, ether_type, payload) in enumerate(
            [
                (GROUP_ADDRESS, 0x0806, arp),
                (multicast, 0x86DD, solicitation),
                (mac_address(2), 0x0800, datagram),
            ]
        ):
            packet = SentPacket(
                station=1, destination=destination, ether_type=ether_type, category="be", read_ns=0,
                payload=payload,
            )  # fmt: skip
            emulator.submit_packet(packet, 1_000_000 * number)
        emulator.advance(to_us=8_000, at_us=0, pos_ned_m=PLACES_NED_M[:3], vel_ned_m_s=np.zeros((3, 3)))
    rows = tshark(
        path, "wlan.da", "wlan.sa", "llc.type", "frame.protocols", "wlan.fcs.status", "ip.checksum.status",
        condition="wlan.fc.type == 2",
    )  # fmt: skip
    sender = "02:00:00:00:00:01"
    assert [row[:3] for row in rows] == [
        ["ff:ff:ff:ff:ff:ff", sender, "0x0806"],
        ["33:33:00:00:00:02", sender, "0x86dd"],
        ["02:00:00:00:00:02", sender, "0x0800"],
    ]
    assert [row[3].split("llc:")[1] for row in rows] == ["arp", "ipv6:icmpv6", "ip:udp"]
    assert {row[4] for row in rows} == {"1"}
    assert rows[2][5] == "1"
    assert tshark(path, "frame.number", condition="_ws.malformed") == []
    (request,) = tshark(path, "arp.src.proto_ipv4", "arp.dst.proto_ipv4", condition="arp")
    assert request == ["10.1.0.1", "10.1.0.2"]
