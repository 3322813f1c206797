"""File transfer: folders, reads, bursts, sessions; over lossy links, with stations' retries. About 7 s."""

import struct
import zlib

import pytest
from ftp_client import MS, Downloader, Reply, request
from hypothesis import given, settings
from hypothesis import strategies as st
from lossy import play
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Parser
from autopilot.services.files import Contents, FileStore, Log
from autopilot.services.ftp import (
    BURST_PACKETS,
    DATA_BYTES,
    IDLE_US,
    MOST_SESSIONS,
    PACKETS_OF_BURST,
    FtpFailure,
    FtpService,
    Opcode,
)
from autopilot.services.service import NEVER_US, Partner

CLIENT, OTHER = Partner(0, 3), Partner(1, 0)
CONTENT = bytes(range(256)) * 80  # 20 kB: more than a burst, and not a multiple of a packet


def make_files():
    files = FileStore()
    files.add("/etc/extras/a.bin", lambda _query: Contents(CONTENT))
    files.add("/etc/extras/empty", lambda _query: Contents(b""))
    files.add("/etc/extras/query", lambda query: Contents(query.encode()))
    files.add_log(Log("/fs/microsd/log/uav-0.ulg", Contents(b"ULog"), 0))
    return files


class Served:
    def __init__(self, files=None):
        self.service = FtpService(files or make_files())
        self.encoder = Encoder(system=255, component=190)

    def send(self, message, now_us=0, partner=CLIENT):
        (received,) = Parser().push(self.encoder.encode(message))
        replies = []
        for to, answer in self.service.on_message(received, now_us, partner):
            assert to == partner
            replies.append(Reply(answer))
            assert replies[-1].to == (255, 190)
        return replies

    def one(self, *parts, now_us=0, partner=CLIENT, **named):
        (answer,) = self.send(request(*parts, **named), now_us, partner)
        return answer

    def open(self, path=b"/etc/extras/a.bin", **named):
        return self.one(Opcode.OPEN_READ, data=path, **named)


# ---- requests


def test_a_file_is_opened_with_its_size_read_and_closed():
    served = Served()
    opened = served.open(seq=7, session=5)
    assert (opened.opcode, opened.seq, opened.session, opened.request) == (Opcode.ACK, 8, 5, Opcode.OPEN_READ)
    assert struct.unpack("<I", opened.data) == (len(CONTENT),)
    read = served.one(Opcode.READ, session=5, size=100, offset=300)
    assert (read.data, read.offset) == (CONTENT[300:400], 300)
    assert served.one(Opcode.READ, session=5, offset=len(CONTENT) - 3).data == CONTENT[-3:]
    assert served.one(Opcode.READ, session=5, offset=0).data == CONTENT[:DATA_BYTES]
    assert served.one(Opcode.READ, session=5, offset=len(CONTENT)).failure is FtpFailure.END_OF_FILE
    assert served.one(Opcode.TERMINATE, session=5, seq=20).opcode == Opcode.ACK
    assert served.one(Opcode.READ, session=5, seq=21).failure is FtpFailure.SESSION


@pytest.mark.parametrize(
    "path",
    [
        b"/etc/extras/nothing", b"/etc/extras", b"/", b"", b"/etc/passwd", b"/etc/extras/../extras/a.bin",
        b"../../../etc/hosts", b"/etc/extras/a.bin/x", b"\xff\xfe", b"/" * 200, b"C:\\x",
    ],
)  # fmt: skip
def test_only_the_store_s_files_are_accessible(path):
    served = Served()
    assert served.open(path).failure is FtpFailure.NOT_FOUND
    assert served.one(Opcode.CHECKSUM, data=path).failure is FtpFailure.NOT_FOUND


@pytest.mark.parametrize("path", [b"/etc/extras/a.bin", b"etc/extras/a.bin\0rest", b"//etc/./extras//a.bin"])
def test_equivalent_paths_name_the_same_file(path):
    assert struct.unpack("<I", Served().open(path).data) == (len(CONTENT),)


def test_a_query_is_passed_to_the_opener():
    served = Served()
    served.open(b"/etc/extras/query?start=3")
    assert served.one(Opcode.READ).data == b"start=3"


@pytest.mark.parametrize("opcode", [*range(6, 14)])
def test_writing_is_refused(opcode):
    assert Served().one(opcode, data=b"/etc/extras/a.bin").failure is FtpFailure.PROTECTED


def test_other_opcodes_are_refused_or_ignored():
    served = Served()
    assert (
        served.one(16).failure is FtpFailure.UNKNOWN_COMMAND
    )  # a listing with times, which MAVProxy tries first
    assert served.one(Opcode.LIST, size=240).failure is FtpFailure.SIZE
    assert served.one(Opcode.NONE).opcode == Opcode.ACK
    assert served.send(request(Opcode.ACK)) == []
    assert served.send(request(Opcode.NAK)) == []


def test_folders_are_listed_up_to_the_end_of_their_entries():
    served = Served()

    def listed(path, offset=0):
        return served.one(Opcode.LIST, data=path, offset=offset).data.rstrip(b"\0").split(b"\0")

    assert listed(b"/") == [b"Detc", b"Dfs"]
    assert listed(b"/etc/extras") == [b"Fa.bin\t20480", b"Fempty\t0", b"Fquery\t0"]
    assert listed(b"/etc/extras", 2) == [b"Fquery\t0"]
    assert served.one(Opcode.LIST, data=b"/etc/extras", offset=3).failure is FtpFailure.END_OF_FILE
    assert served.one(Opcode.LIST, data=b"/none").failure is FtpFailure.NOT_FOUND


def test_a_long_listing_is_sent_in_parts():
    files = FileStore()
    names = [f"{number:03}-{'x' * (number % 50)}" for number in range(100)]
    for name in names:
        files.add(f"/a/{name}", lambda _query: Contents(b""))
    served = Served(files)
    got, failure = [], None
    while failure is None:
        part = served.one(Opcode.LIST, data=b"/a", offset=len(got))
        failure = part.failure
        if failure is None:
            got += [entry[1:].split(b"\t")[0].decode() for entry in part.data.rstrip(b"\0").split(b"\0")]
    assert (got, failure) == (names, FtpFailure.END_OF_FILE)


def test_the_checksum_is_px4s():
    (checksum,) = struct.unpack("<I", Served().one(Opcode.CHECKSUM, data=b"/etc/extras/a.bin").data)
    assert checksum == zlib.crc32(CONTENT, 0xFFFF_FFFF) ^ 0xFFFF_FFFF


# ---- sessions


def test_equal_session_numbers_of_two_partners_are_separate_sessions():
    served = Served()
    served.open()
    assert served.one(Opcode.READ, partner=OTHER).failure is FtpFailure.SESSION
    served.open(b"/etc/extras/query?x", partner=OTHER)
    assert served.one(Opcode.READ, partner=OTHER).data == b"x"
    assert served.one(Opcode.RESET, partner=OTHER).opcode == Opcode.ACK
    assert served.one(Opcode.READ, partner=OTHER).failure is FtpFailure.SESSION
    assert served.one(Opcode.READ).data == CONTENT[:DATA_BYTES]


def test_the_number_of_sessions_is_limited_and_idle_ones_are_closed():
    served = Served()
    for number in range(MOST_SESSIONS):
        assert served.open(session=number).failure is None
    assert served.open(session=99).failure is FtpFailure.NO_SESSION_LEFT
    assert served.open(session=0).failure is None  # replaces the open session
    served.one(Opcode.READ, session=0, now_us=IDLE_US)
    assert served.open(session=99, now_us=IDLE_US + 1).failure is None
    assert served.one(Opcode.READ, session=0, now_us=IDLE_US + 1).failure is None
    assert served.one(Opcode.READ, session=1, now_us=IDLE_US + 1).failure is FtpFailure.SESSION


def test_a_repeated_terminate_gets_the_same_answer():
    served = Served()
    served.open()
    end = request(Opcode.TERMINATE, seq=9)
    assert [answer.opcode for _ in range(3) for answer in served.send(end)] == [Opcode.ACK] * 3
    assert served.one(Opcode.TERMINATE, seq=10).failure is FtpFailure.SESSION


def test_the_answer_to_a_terminate_expires_with_an_idle_session():
    """After that, equal bytes are a new request from a station that uses the number again."""
    served = Served()
    served.open()
    end = request(Opcode.TERMINATE, seq=9)
    served.send(end)
    served.open(now_us=IDLE_US)
    (answer,) = served.send(end, now_us=IDLE_US)
    assert answer.opcode == Opcode.ACK
    assert served.one(Opcode.READ, now_us=IDLE_US).failure is None  # the stored answer was sent
    (answer,) = served.send(end, now_us=IDLE_US + 1)
    assert answer.opcode == Opcode.ACK
    assert served.one(Opcode.READ, now_us=IDLE_US + 1).failure is FtpFailure.SESSION


def bursts(served):
    """Packets of bursts with the times at which they are sent."""
    packets = []
    while served.service.next_deadline_us() < NEVER_US:
        now_us = served.service.next_deadline_us()
        packets += [(now_us, Reply(message)) for _, message in served.service.on_timer(now_us)]
    return packets


def test_a_burst_has_a_fixed_number_of_packets_in_order_and_marks_the_last():
    served = Served()
    served.open()
    assert served.send(request(Opcode.BURST, seq=65_530, size=DATA_BYTES)) == []
    packets = bursts(served)
    assert b"".join(packet.data for _, packet in packets) == CONTENT[: PACKETS_OF_BURST * DATA_BYTES]
    assert [packet.seq for _, packet in packets] == [(65_531 + k) % 65_536 for k in range(PACKETS_OF_BURST)]
    assert [packet.complete for _, packet in packets] == [0] * (PACKETS_OF_BURST - 1) + [1]
    assert {packet.request for _, packet in packets} == {Opcode.BURST}
    at_once = [now_us for now_us, _ in packets]
    assert max(at_once.count(now_us) for now_us in at_once) == BURST_PACKETS


def test_a_burst_ends_with_the_file_and_a_request_beyond_it_is_refused():
    served = Served()
    served.open()
    served.send(request(Opcode.BURST, size=80, offset=len(CONTENT) - 100))
    packets = [packet for _, packet in bursts(served)]
    assert [(len(packet.data), packet.complete) for packet in packets] == [(80, 0), (20, 1)]
    assert served.one(Opcode.BURST, offset=len(CONTENT)).failure is FtpFailure.END_OF_FILE


def test_an_empty_file_is_opened_and_has_no_data():
    served = Served()
    assert served.open(b"/etc/extras/empty").data == bytes(4)
    assert served.one(Opcode.BURST).failure is FtpFailure.END_OF_FILE


@settings(max_examples=200, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.binary(max_size=251) | st.binary(min_size=251, max_size=251),
            st.integers(0, 20),
            st.sampled_from((0, 4 * MS, 20_000 * MS)),
        ),
        max_size=20,
    )
)
def test_any_requests_get_at_most_one_answer_and_leave_a_bounded_number_of_sessions(payloads):
    served, now_us = Served(), 0
    for payload, opcode, later_us in payloads:
        now_us += later_us
        data = payload.ljust(251, b"\0")
        for sent in (data, data[:3] + bytes([opcode]) + data[4:]):
            message = common.MAVLink_file_transfer_protocol_message(0, 1, 1, sent)
            assert len(served.send(message, now_us)) <= 1
        assert len(served.service.on_timer(now_us)) <= MOST_SESSIONS * BURST_PACKETS
    assert len(served.service._sessions) <= MOST_SESSIONS


# ---- over a link


def test_files_arrive_complete_over_a_lossy_link():
    lost = 0
    for seed in range(200):
        stations = [Downloader(b"/etc/extras/a.bin", session=0), Downloader(b"etc/extras/a.bin", session=0)]
        outcome = play(
            FtpService(make_files()),
            *stations,
            seed=seed,
            loss=0.05,
            duplication=0.05,
            delays_us=(0, 50 * MS),
        )
        for station in stations:
            assert station.done, seed
            assert station.content == CONTENT, seed
        lost += outcome.lost
    assert lost > 200


def test_a_burst_waits_for_its_link_and_keeps_its_session_open():
    room = []
    service = FtpService(make_files(), has_room=lambda _partner: bool(room))
    served = Served()
    served.service = service
    served.open()
    served.send(request(Opcode.BURST))
    now_us = 0
    while now_us < 2 * IDLE_US:
        now_us = service.next_deadline_us()
        assert service.on_timer(now_us) == []
    assert served.open(session=1, now_us=now_us).failure is None  # closes idle sessions
    room.append(True)
    assert len(bursts(served)) == PACKETS_OF_BURST
