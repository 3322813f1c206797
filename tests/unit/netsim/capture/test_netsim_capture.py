"""Capture files, read back block by block; what Wireshark makes of them is in test_radio_capture.py.

The whole file takes 2 s.
"""

import errno
import math
import resource
import struct
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from netsim_air import A, Air, B, C
from netsim_pcapng import OFDM24, blocks, datagram, interfaces, options, packets, radiotap, transmission
from netsim_swarm import Swarm

from netsim.capture.ieee80211 import mpdu
from netsim.capture.pcapng_writer import CHUNK_BYTES, HOLD_NS, WRITE_PERIOD_NS, Capture
from netsim.emulator.service import EmulatorService
from netsim.model.config import GuestConfig, RadioConfig, ServerConfig, StationConfig
from netsim.phy.frames import Frame, FrameKind
from netsim.phy.modes import phy_mode
from netsim.phy.propagation import thermal_noise_mw
from netsim.wire.lockstep import Advance, pack_rows
from netsim.wire.messages import Broadcast, Delivery, TxBatch

CONFIG = RadioConfig(bandwidth_mhz=20)
NON_HT = ("ofdm6", "ofdm9", "ofdm12", "ofdm18", "ofdm24", "ofdm36", "ofdm48", "ofdm54")


# --- the file


def test_file_begins_with_a_section_header_and_one_interface(tmp_path):
    """Section header 0x0A0D0D0A, version 1.0; interface of link type 127, nanoseconds, no limit of length."""
    path = tmp_path / "radio.pcapng"
    Capture(path, config=CONFIG, comment="seed 7").close()
    (section, interface) = blocks(path.read_bytes())
    assert section[0] == 0x0A0D0D0A
    assert struct.unpack_from("<IHHq", section[1]) == (0x1A2B3C4D, 1, 0, -1)
    assert options(section[1][16:]) == {1: b"seed 7", 4: b"coflight"}
    assert interface[0] == 1
    assert struct.unpack_from("<HHI", interface[1]) == (127, 0, 0)
    assert options(interface[1][8:])[9] == b"\x09"


@given(
    st.lists(st.tuples(st.integers(0, 9), st.integers(0, 1472), st.integers(0, 40_000)), max_size=60),
    st.integers(0, 2**62),
)
def test_packets_are_ordered_by_start_for_any_end(tmp_path_factory, plan, origin_ns):
    """At any time any number overlap; the emulator reports them as they end. None is lost or doubled."""
    path = tmp_path_factory.mktemp("capture") / "radio.pcapng"
    start_ns, sent = origin_ns, []
    for number, (rate, size, gap_ns) in enumerate(plan):
        mode = phy_mode(NON_HT[rate % len(NON_HT)], 20)
        frame = datagram(bytes(size), source=number, seq=number, mode=mode)
        sent.append(transmission(frame, start_ns))
        start_ns += gap_ns
    capture = Capture(path, config=CONFIG)
    for each in sorted(sent, key=lambda t: (t.end_ns, t.source)):
        capture.append(each)
    capture.close()
    found = packets(path.read_bytes())
    assert [time_ns for time_ns, _, _ in found] == [t.start_ns for t in sent]
    assert [radiotap(packet)[1] for _, packet, _ in found] == [
        mpdu(t.frame) for t in sorted(sent, key=lambda t: (t.start_ns, t.source))
    ]


def test_file_without_frames_is_readable(tmp_path):
    path = tmp_path / "radio.pcapng"
    capture = Capture(path, config=CONFIG)
    assert [kind for kind, _ in blocks(path.read_bytes())] == [0x0A0D0D0A, 1]
    capture.close()


@given(
    st.lists(st.tuples(st.integers(0, 1472), st.integers(0, 500_000_000)), min_size=1, max_size=8),
    st.integers(20_000_000, 400_000_000),
)
def test_few_frames_are_written_within_the_write_period(tmp_path_factory, plan, step_ns):
    """`settle` comes at every step: one later than HOLD after a start may write the frame, none sooner.

    One that is later by the period too has it in the file: had the write before come since, the frame would
    have been in that. Within a second there is one write, as eight frames of 1604 B at most are no chunk.
    """
    folder = tmp_path_factory.mktemp("capture")
    path = folder / "radio.pcapng"
    start_ns, sent = 0, []
    for number, (size, gap_ns) in enumerate(plan):
        sent.append(transmission(datagram(bytes(size), sequence=number + 1), start_ns))
        start_ns = sent[-1].end_ns + gap_ns
    capture, now_ns, ended = Capture(path, config=CONFIG), 0, 0
    sizes = [path.stat().st_size]
    while now_ns <= sent[-1].start_ns + HOLD_NS + WRITE_PERIOD_NS:
        now_ns += step_ns
        while ended < len(sent) and sent[ended].end_ns <= now_ns:
            capture.append(sent[ended])
            ended += 1
        capture.settle(now_ns)
        found = [time_ns for time_ns, _, _ in packets(path.read_bytes())]
        assert found == [each.start_ns for each in sent][: len(found)]
        assert all(time_ns < now_ns - HOLD_NS for time_ns in found)
        overdue_ns = now_ns - HOLD_NS - WRITE_PERIOD_NS
        assert len(found) >= sum(each.start_ns < overdue_ns for each in sent)
        sizes.append(path.stat().st_size)
    writes = sum(a != b for a, b in pairwise(sizes))
    assert writes <= 1 + now_ns // WRITE_PERIOD_NS
    assert len(packets(path.read_bytes())) == len(sent)
    capture.close()
    alone = Capture(folder / "alone", config=CONFIG)
    for each in sent:
        alone.append(each)
    alone.close()
    assert path.read_bytes() == (folder / "alone").read_bytes()


def test_at_most_one_chunk_is_pending_and_a_kill_leaves_whole_blocks(tmp_path):
    """Back to back on 20 MHz at 24 Mbit/s: a frame of 1064 B takes 380 us, so 7 ms hold 19 of them.

    Of any number of frames all but those and one chunk are in the file, which ends with a whole block.
    """
    path = tmp_path / "radio.pcapng"
    capture = Capture(path, config=CONFIG)
    start_ns = 0
    for number in range(1_000):
        each = transmission(datagram(bytes(1_000), sequence=number + 1), start_ns)
        capture.append(each)
        start_ns = each.end_ns
        written = path.stat().st_size
        packet_bytes = 32 + 36 + 1_064
        held = 1 + HOLD_NS // (each.end_ns - each.start_ns)
        assert (number + 1) * packet_bytes - written < CHUNK_BYTES + (held + 1) * packet_bytes
    found = packets(path.read_bytes())
    assert len(found) > 900
    assert all(a[0] < b[0] for a, b in pairwise(found))
    capture.close()
    capture.close()
    assert len(packets(path.read_bytes())) == 1_000


def test_missing_folder_and_full_disk_are_reported_with_the_path(tmp_path):
    missing = tmp_path / "missing" / "radio.pcapng"
    with pytest.raises(FileNotFoundError, match=r"missing/radio\.pcapng"):
        Capture(missing, config=CONFIG)
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("this system has no /dev/full")
    with pytest.raises(OSError, match="/dev/full") as failure:
        Capture(full, config=CONFIG)
    assert failure.value.errno == errno.ENOSPC


def test_partial_write_is_a_full_disk(tmp_path):
    """The system writes as much of a chunk as fits, and refuses the rest and what comes later."""
    path = tmp_path / "radio.pcapng"
    capture = Capture(path, config=CONFIG)
    for number in range(60):
        capture.append(transmission(datagram(bytes(1_000), source=number)))
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, limits[1]))
    try:
        with pytest.raises(OSError, match=r"radio\.pcapng") as failure:
            capture.append(transmission(datagram(), 10**9))
        with pytest.raises(OSError, match=r"radio\.pcapng"):
            capture.close()
        capture.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert failure.value.errno == errno.EFBIG
    assert path.stat().st_size == 10_000


def test_power_is_the_transmitters(tmp_path):
    path = tmp_path / "radio.pcapng"
    config = RadioConfig(
        bandwidth_mhz=20, tx_power_dbm=15.0, stations=(StationConfig(station=2, tx_power_dbm=3.0),)
    )
    capture = Capture(path, config=config)
    for source in range(3):
        capture.append(transmission(datagram(source=source), 10**6 * source))
    capture.close()
    powers = [radiotap(packet)[0]["tx_power"] for _, packet, _ in packets(path.read_bytes())]
    assert powers == [(15,), (15,), (3,)]


# --- what stations do


def captured(air, path):
    capture = Capture(path, config=CONFIG)
    for each in air.transmissions:
        capture.append(each)
    capture.close()
    return packets(path.read_bytes())


def retries(found):
    """(sequence number, retry bit) of every data frame."""
    frames = [radiotap(packet)[1] for _, packet, _ in found]
    return [
        (int.from_bytes(frame[22:24], "little") >> 4, frame[1] >> 3 & 1)
        for frame in frames
        if frame[0] == 0x08
    ]


def test_all_transmissions_after_the_first_are_retries(tmp_path):
    """B receives nothing, so A's frame is sent 1 + 7 times; the next frame begins without a retry."""
    air = Air(2, powers_dbm={(A, B): -200.0})
    air.send(0, A, B)
    air.send(1, A)
    air.run()
    assert retries(captured(air, tmp_path / "radio.pcapng")) == [(1, 0)] + 7 * [(1, 1)] + [(2, 0)]


def test_retry_is_detected_after_a_frame_of_another_queue(tmp_path):
    """A's best-effort frame 1 to B fails; its voice frame 2 goes out in between, before 1 comes again."""
    air = Air(3, powers_dbm={(A, B): -200.0}, access="edca")
    air.send(0, A, B, category="be", retry_limit=3)
    air.send(100, A, C, category="vo")
    air.run()
    found = retries(captured(air, tmp_path / "radio.pcapng"))
    assert sorted(found) == [(1, 0), (1, 1), (1, 1), (1, 1), (2, 0)]
    assert found.index((2, 0)) < len(found) - 1


@given(st.integers(1, 2**40), st.booleans())
def test_wrapped_sequence_numbers_are_not_retries(tmp_path_factory, first, wrapped):
    """Whether the MAC counts on or modulo 4096, a new number is ahead and an equal one is not."""
    path = tmp_path_factory.mktemp("capture") / "radio.pcapng"
    capture = Capture(path, config=CONFIG)
    numbers = [first, first, first + 1, first + 3, first + 1, first + 2_000, first + 4_000, first + 4_096]
    for at, number in enumerate(numbers):
        sequence = number % 4096 if wrapped else number
        capture.append(transmission(datagram(sequence=sequence), 10**6 * at))
    capture.close()
    assert [retry for _, retry in retries(packets(path.read_bytes()))] == [0, 1, 0, 0, 1, 0, 0, 0]


def test_control_frames_do_not_affect_retry_detection(tmp_path):
    """3000, an ACK, 3001: were the ACK's 0 a number, 3001 would lie behind it."""
    path = tmp_path / "radio.pcapng"
    capture = Capture(path, config=CONFIG)
    answer = Frame(kind=FrameKind.ACK, source=0, destination=1, mode=OFDM24, frame_bytes=14)
    for at, frame in enumerate((datagram(sequence=3_000), answer, datagram(sequence=3_001))):
        capture.append(transmission(frame, 10**6 * at))
    capture.close()
    assert retries(packets(path.read_bytes())) == [(3_000, 0), (3_001, 0)]


def test_comment_lists_the_receivers_that_missed_a_frame(tmp_path):
    """A and B broadcast at once: C receives both with equal power and loses both; D is out of range of B.

    A and B, which are sending, do not receive each other's frame: without the other both would have.
    """
    air = Air(4, powers_dbm={(B, 3): -100.0})
    air.send(0, A)
    air.send(0, B)
    air.send(5_000, A)
    air.run()
    found = captured(air, tmp_path / "radio.pcapng")
    assert [comment for _, _, comment in found] == [
        b"collided at 1, 2",
        b"collided at 0, 2; lost to noise at 3",
        None,
    ]


def broadcasts(path, seed):
    """Five stations that broadcast 40 times each, with RTS and CTS, at times that make some collide."""
    capture = Capture(path, config=RadioConfig(), comment=f"seed {seed}")
    places_ned_m = [(0.0, 20.0 * i, -10.0) for i in range(5)]
    swarm = Swarm(places_ned_m, seed=seed, on_transmission=capture.append)
    for round_ in range(40):
        for station in range(5):
            swarm.broadcast(station, 10_000 * round_ + 20 * station)
    swarm.run(500_000)
    capture.close()
    return path.read_bytes()


def test_equal_runs_give_equal_bytes(tmp_path):
    one = broadcasts(tmp_path / "1", 1)
    assert one == broadcasts(tmp_path / "again", 1)
    assert one != broadcasts(tmp_path / "2", 2)
    assert len(packets(one)) > 400


# --- dates and receivers

EPOCH_UNIX_US = 4_102_444_800_000_001
"""A microsecond into 2100, beyond 32 bits of seconds."""


def test_packet_times_count_from_the_epoch_and_radiotap_times_from_the_start(tmp_path):
    path = tmp_path / "radio.pcapng"
    capture = Capture(path, config=CONFIG, epoch_unix_us=EPOCH_UNIX_US)
    capture.append(transmission(datagram(), 5_000_000_123))
    capture.close()
    ((time_ns, packet, _),) = packets(path.read_bytes())
    assert time_ns == 1_000 * EPOCH_UNIX_US + 5_000_000_123
    fields, _ = radiotap(packet)
    assert (fields["timestamp"][0], fields["tsft"]) == (5_000_000_123, (5_000_020,))


def of_receivers(path, transmissions, **settings):
    config = RadioConfig(bandwidth_mhz=20, capture="receivers", **settings)
    capture = Capture(path, config=config, vehicles=4, epoch_unix_us=EPOCH_UNIX_US)
    for each in transmissions:
        capture.append(each)
    capture.close()
    return interfaces(path.read_bytes())


def test_every_station_has_an_interface_with_its_own_and_its_received_frames(tmp_path):
    """B receives A 7 dB weaker than C does and 300 ns later; D is below the preamble's threshold."""
    powers_dbm = {(A, B): -62.0, (A, C): -55.0, (A, 3): -83.0}
    air = Air(4, powers_dbm=powers_dbm, delays_ns={(A, B): 500, (A, C): 200, (A, 3): 900})
    air.send(0, A)
    air.send(5_000, B, C)  # D, which is not addressed, also receives it and the ACK
    air.run()
    guests = (GuestConfig(name="tower", pos_ned_m=(0.0, 0.0, 0.0)),)
    names, found = of_receivers(tmp_path / "radio.pcapng", air.transmissions, guests=guests)
    assert names == ["uav 0", "uav 1", "uav 2", "uav 3", "tower"]
    assert [time_ns for _, time_ns, *_ in found] == sorted(time_ns for _, time_ns, *_ in found)
    (first, data, ack) = sorted(air.transmissions, key=lambda each: each.start_ns)
    noise_dbm = round(10 * math.log10(thermal_noise_mw(20, 7.0)))
    seen = []
    for interface, time_ns, packet, _ in found:
        fields, frame = radiotap(packet)
        level = fields.get("signal", (None,))[0]
        assert fields.get("noise") == (None if level is None else (noise_dbm,))
        assert ("tx_power" in fields) == (level is None)
        assert time_ns == 1_000 * EPOCH_UNIX_US + fields["timestamp"][0]
        seen.append((interface, frame, fields["timestamp"][0], level))
    expected = [(A, first, 0, None), (C, first, 200, -55), (B, first, 500, -62)]
    expected += [(B, data, 0, None), (A, data, 0, -50), (C, data, 0, -50), (3, data, 0, -50)]
    expected += [(C, ack, 0, None), (A, ack, 0, -50), (B, ack, 0, -50), (3, ack, 0, -50)]
    assert sorted(seen, key=lambda row: (row[2], row[0])) == sorted(
        ((at, mpdu(sent.frame), sent.start_ns + delay_ns, level) for at, sent, delay_ns, level in expected),
        key=lambda row: (row[2], row[0]),
    )


def test_a_frame_received_with_errors_is_flagged_and_its_fcs_is_inverted(tmp_path):
    """13 dB above the noise a preamble is detected, and the payload at 54 Mbit/s is not received."""
    noise_dbm = 10 * math.log10(thermal_noise_mw(20, 7.0))
    air = Air(3, powers_dbm={(A, B): noise_dbm + 13.0})
    air.send(0, A, mode="ofdm54", frame_bytes=1_500)
    air.run()
    (sent,) = air.transmissions
    assert (sent.received, sent.received_in_error) == ([C], [B])
    _, found = of_receivers(tmp_path / "radio.pcapng", air.transmissions)
    (_, intact), (_, broken), (_, good) = (radiotap(packet) for _, _, packet, _ in found)
    flags = {interface: radiotap(packet)[0]["flags"][0] for interface, _, packet, _ in found}
    assert flags == {A: 0x10, B: 0x50, C: 0x10}
    assert intact == good == mpdu(sent.frame)
    assert broken[:-4] == intact[:-4]
    assert bytes(a ^ b for a, b in zip(broken[-4:], intact[-4:], strict=True)) == b"\xff" * 4


@pytest.mark.parametrize("channel", ["emulated", "ideal"])
def test_signals_are_those_that_the_hosts_receive(channel, tmp_path):
    """Of the whole service, with fading on the emulated channel; station 4 is out of range of most."""
    radio = RadioConfig(channel=channel, capture="receivers", broadcast_rts=False, host_jitter_us=0)
    path = tmp_path / "radio.pcapng"
    config = ServerConfig(
        run_id="test", stations=5, seed=3, radio=radio, capture_path=str(path), epoch_unix_us=EPOCH_UNIX_US
    )
    places_ned_m = np.array([(0.0, each, -10.0) for each in (0.0, 9.0, 30.0, 80.0, 400.0)])
    service = EmulatorService(config)
    service.open_logs()
    delivered = set()
    for step in range(60):
        sender = step % 5
        items = (Broadcast(seq=step, at_us=4_000 * step, payload=bytes([step])),)
        service.submit(TxBatch(station=sender, now_us=4_000 * step, items=items))
        arrived = service.advance(request(4_000 * step, places_ned_m))
        delivered |= {
            (station, item.payload[0], round(item.rssi_dbm))
            for station, batch in arrived.items()
            for item in batch.items
            if isinstance(item, Delivery)
        }
    service.close()
    names, found = interfaces(path.read_bytes())
    assert len(names) == 5
    captured_of = set()
    for interface, time_ns, packet, _ in found:
        fields, frame = radiotap(packet)
        assert time_ns == 1_000 * EPOCH_UNIX_US + fields["timestamp"][0]
        if "signal" in fields and not fields["flags"][0] & 0x40:
            captured_of.add((interface, frame[60], fields["signal"][0]))
    assert captured_of == delivered
    assert len({level for *_, level in delivered}) > 3
    assert {station for station, *_ in delivered} >= {0, 1, 2, 3}


def request(at_us, places_ned_m):
    count = len(places_ned_m)
    return Advance(
        to_us=at_us + 4_000,
        release_us=at_us + 4_000,
        at_us=at_us,
        pos_ned_m=pack_rows(places_ned_m),
        vel_ned_m_s=pack_rows(np.zeros((count, 3))),
        q_ned_frd=pack_rows(np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))),
        extra_attenuation_db=0.0,
    )


def test_the_kind_of_capture_does_not_change_the_medium(tmp_path):
    """The transmitters' interfaces together hold what the capture of the medium holds."""
    air = Air(3)
    for number in range(5):
        air.send(2_000 * number, number % 3, frame_bytes=200)
    air.run()
    medium = captured(air, tmp_path / "medium")
    _, found = of_receivers(tmp_path / "receivers", air.transmissions)
    sent = [packet for _, _, packet, _ in found if "tx_power" in radiotap(packet)[0]]
    assert sent == [packet for _, packet, _ in medium]
