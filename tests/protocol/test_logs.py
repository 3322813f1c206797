"""Logs: listed, and downloaded over lossy links with the stations' retries. About 5 s."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lossy import play
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Parser
from autopilot.services.files import Contents, FileStore, Log
from autopilot.services.logs import MOST_DOWNLOADS, PIECE_BYTES, PIECES, LogService
from autopilot.services.service import NEVER_US, Partner

CLIENT = Partner(0, 3)
CHUNK_BYTES = 512 * PIECE_BYTES
"""Size of the stations' requests."""
CONTENT = bytes(range(256)) * 250  # 64 kB: more than a chunk, and not a multiple of a piece
MS = 1_000


def make_service(*contents):
    files = FileStore()
    for number, content in enumerate(contents):
        files.add_log(Log(f"/log/{number}.ulg", Contents(content), 1_700_000_000 + number))
    return LogService(files)


def send(service, message, partner=CLIENT, now_us=0):
    (received,) = Parser().push(Encoder(system=255, component=190).encode(message))
    answers = service.on_message(received, now_us, partner)
    assert {to for to, _ in answers} <= {partner}
    return [answer for _, answer in answers]


def sent(service):
    pieces = []
    while service.next_deadline_us() < NEVER_US:
        messages = service.on_timer(service.next_deadline_us())
        assert len(messages) <= PIECES * MOST_DOWNLOADS
        pieces += [(to, message.ofs, bytes(message.data[: message.count])) for to, message in messages]
    return pieces


def data_request(number, offset, count):
    return common.MAVLink_log_request_data_message(1, 1, number, offset, count)


def listing(start=0, end=0xFFFF):
    return common.MAVLink_log_request_list_message(1, 1, start, end)


# ---- requests


def test_without_a_log_the_list_is_empty():
    (entry,) = send(make_service(), listing())
    assert (entry.num_logs, entry.size) == (0, 0)


def test_logs_are_listed_with_number_size_and_time():
    service = make_service(b"a" * 10, CONTENT, b"")
    entries = send(service, listing())
    assert [(entry.id, entry.num_logs, entry.last_log_num) for entry in entries] == [
        (0, 3, 2),
        (1, 3, 2),
        (2, 3, 2),
    ]
    assert [entry.size for entry in entries] == [10, len(CONTENT), 0]
    assert [entry.time_utc for entry in entries] == [1_700_000_000, 1_700_000_001, 1_700_000_002]
    assert [entry.id for entry in send(service, listing(1, 1))] == [1]
    assert [entry.id for entry in send(service, listing(9, 3))] == [2]


@pytest.mark.parametrize(
    ("offset", "count", "pieces"),
    [
        (0, 180, [(0, 90), (90, 90)]),
        (90, 100, [(90, 90), (180, 10)]),
        (len(CONTENT) - 5, 90, [(len(CONTENT) - 5, 5)]),
        (len(CONTENT) - 5, 2**32 - 1, [(len(CONTENT) - 5, 5)]),
        (len(CONTENT), 90, [(len(CONTENT), 0)]),
        (2**32 - 1, 90, [(2**32 - 1, 0)]),
        (0, 0, [(0, 0)]),
    ],
)
def test_the_requested_bytes_are_sent(offset, count, pieces):
    service = make_service(CONTENT)
    assert send(service, data_request(0, offset, count)) == []
    got = sent(service)
    assert [(at, len(data)) for _, at, data in got] == pieces
    assert b"".join(data for _, _, data in got) == CONTENT[offset : offset + count]


def test_another_request_ends_a_download():
    end = common.MAVLink_log_request_end_message(1, 1)
    for message in (end, data_request(7, 0, 90)):
        service = make_service(CONTENT)
        send(service, data_request(0, 0, 10_000))
        service.on_timer(0)
        send(service, message)
        assert sent(service) == []


def test_logs_are_not_erased():
    service = make_service(CONTENT)
    (text,) = send(service, common.MAVLink_log_erase_message(1, 1))
    assert "denied" in text.text
    assert len(send(service, listing())) == 1


def test_partners_download_independently():
    service = make_service(CONTENT, CONTENT[::-1])
    partners = [Partner(0, 0), Partner(0, 1)]
    for number, partner in enumerate(partners):
        send(service, data_request(number, 0, 5_000), partner)
    got = sent(service)
    for partner, content in zip(partners, (CONTENT, CONTENT[::-1]), strict=True):
        assert b"".join(data for to, _, data in got if to == partner) == content[:5_000]


u16, u32 = st.integers(0, 2**16 - 1), st.integers(0, 2**32 - 1)
anything = st.one_of(
    st.builds(listing, u16, u16),
    st.builds(data_request, st.integers(0, 3), u32 | st.integers(0, 300), u32 | st.integers(0, 300)),
    st.just(common.MAVLink_log_request_end_message(1, 1)),
)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(anything, st.integers(0, 50)), max_size=30))
def test_any_sequence_of_requests_is_handled(requests):
    service = make_service(b"x" * 200, b"y" * 50)
    for place, (message, number) in enumerate(requests):
        send(service, message, Partner(0, number), place)
        assert len(service.on_timer(place * 4 * MS)) <= PIECES * MOST_DOWNLOADS


# ---- over a link


class Downloader:
    """Lists the logs and reads the first as MAVSDK does: a chunk, then its gaps after a timeout."""

    def __init__(self):
        self.size = None
        self.parts = {}
        self.done = False
        self.chunk = 0
        self.due_us = 0

    @property
    def content(self):
        return b"".join(self.parts[offset] for offset in sorted(self.parts))

    def missing(self):
        end = min((self.chunk + 1) * CHUNK_BYTES, self.size)
        return [at for at in range(self.chunk * CHUNK_BYTES, end, PIECE_BYTES) if at not in self.parts], end

    def on_timer(self, now_us):
        self.due_us = now_us + 500 * MS
        if self.size is None:
            return [listing()]
        missing, end = self.missing()
        begin = missing[0]
        if len(missing) == (end - self.chunk * CHUNK_BYTES + PIECE_BYTES - 1) // PIECE_BYTES:
            return [data_request(0, begin, end - begin)]
        until = begin
        while until in missing:
            until += PIECE_BYTES
        return [data_request(0, begin, min(until, end) - begin)]

    def next_deadline_us(self):
        return NEVER_US if self.done else self.due_us

    def on_message(self, message, now_us):
        self.due_us = now_us + 500 * MS
        if message.get_type() == "LOG_ENTRY" and self.size is None:
            self.size = message.size
            return self.on_timer(now_us)
        if message.get_type() == "LOG_DATA" and not self.done:
            self.parts[message.ofs] = bytes(message.data[: message.count])
            if not self.missing()[0]:
                self.chunk += 1
                self.done = self.chunk * CHUNK_BYTES >= self.size
                return () if self.done else self.on_timer(now_us)
        return ()


def test_a_log_arrives_complete_over_a_lossy_link():
    lost = 0
    for seed in range(50):
        station = Downloader()
        outcome = play(
            make_service(CONTENT), station, seed=seed, loss=0.05, duplication=0.05, delays_us=(0, 50 * MS)
        )
        assert station.done, seed
        assert station.content == CONTENT, seed
        lost += outcome.lost
    assert lost > 50


# ---- while it is written


def test_a_growing_log_is_listed_and_read_up_to_its_current_size():
    class Growing:
        data = CONTENT

        def size(self):
            return len(self.data)

        def read(self, offset, count):
            return self.data[offset : offset + count]

    files, file = FileStore(), Growing()
    files.add_log(Log("/log/0.ulg", file, 0))
    service = LogService(files)
    (before,) = send(service, listing())
    send(service, data_request(0, 0, before.size))
    file.data += b"more"
    assert b"".join(data for _, _, data in sent(service)) == CONTENT
    (after,) = send(service, listing())
    assert after.size == before.size + 4
    file.data = CONTENT  # reading beyond the end of a truncated file returns nothing
    send(service, data_request(0, before.size, 4))
    assert b"".join(data for _, _, data in sent(service)) == b""
