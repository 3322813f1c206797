"""Capture files, read back block by block; what Wireshark makes of them is in test_radio_capture.py.

The whole file takes 2 s.
"""

import errno
import resource
import struct
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from netsim_air import A, Air, B, C
from netsim_pcapng import OFDM24, blocks, datagram, options, packets, radiotap, transmission
from netsim_swarm import Swarm

from netsim.capture.ieee80211 import mpdu
from netsim.capture.pcapng_writer import CHUNK_BYTES, HOLD_NS, WRITE_PERIOD_NS, Capture
from netsim.model.config import RadioConfig, StationConfig
from netsim.phy.frames import Frame, FrameKind
from netsim.phy.modes import phy_mode

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
