"""The tlog of a link: what passes its tap, with and without signing, and what the file has."""

import contextlib
import errno
import os
import select
import socket

import pytest
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Parser, signed
from autopilot.mavlink.partners import BROADCAST
from autopilot.mavlink.signing import Signer, SigningStreams, key_of
from autopilot.mavlink.tlog import MOST_BUFFERED, TIME, TelemetryLog
from autopilot.mavlink.udp_link import UdpLink

DEADLINE_S = 20.0
EPOCH_US = 1_700_000_000_000_000
KEY = key_of(b"a passphrase of the test")


def beat():
    return common.MAVLink_heartbeat_message(2, 12, 29, 0, 3, 3)


@pytest.mark.parametrize("key", [None, KEY], ids=["plain", "signed"])
def test_the_tap_receives_what_the_link_accepts_and_sends(key):
    tapped = []
    with contextlib.ExitStack() as stack:
        signer = None if key is None else Signer(key, link_id=0, received=SigningStreams())
        link = UdpLink(
            host="127.0.0.1", local_port=0, remote_port=0, encoder=Encoder(system=1, component=1),
            signer=signer, tap=tapped.append,
        )  # fmt: skip
        stack.enter_context(contextlib.closing(link))
        station = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        station.bind(("127.0.0.1", 0))
        station.settimeout(DEADLINE_S)
        sent = Encoder(system=255, component=190).encode(beat())
        if key is not None:
            sender = Signer(key, link_id=1, received=SigningStreams())
            sent = signed(sent, common.MAVLINK_MSG_ID_HEARTBEAT, sender, link._now())
        for frame in (sent, sent[:-1] + bytes([sent[-1] ^ 1])):  # the second one is rejected
            station.sendto(frame, ("127.0.0.1", link.local_port))
            assert select.select([link], [], [], DEADLINE_S)[0]
            link.receive(0)
        assert tapped == [sent]
        link.send([(BROADCAST, beat()), (BROADCAST, beat())])
        datagram = station.recv(2048)
        assert b"".join(tapped[1:]) == datagram
        assert len(Parser(None).push_datagram(datagram)) == 2


def test_entries_have_the_date_of_simulated_time(tmp_path):
    path, encoder = tmp_path / "ground-0.tlog", Encoder(system=1, component=1)
    frames = [encoder.encode(beat()) for _ in range(3)]
    with contextlib.closing(TelemetryLog(path, epoch_unix_us=EPOCH_US)) as log:
        for k, frame in enumerate(frames):
            log.add(1_000 * k, frame)
    expected = b"".join(TIME.pack(EPOCH_US + 1_000 * k) + frame for k, frame in enumerate(frames))
    assert path.read_bytes() == expected
    assert path.stat().st_mode & 0o777 == 0o600


def test_a_signing_key_is_not_written(tmp_path):
    path, link = tmp_path / "ground-0.tlog", common.MAVLink(None)
    message = common.MAVLink_setup_signing_message(1, 1, bytes(range(1, 33)), 5)
    frame = bytes(message.pack(link))
    with contextlib.closing(TelemetryLog(path, epoch_unix_us=0)) as log:
        log.add(0, frame)
    assert path.read_bytes() == b""


def test_a_full_disk_names_the_file_and_memory_is_bounded(tmp_path):
    class Full:
        closed = False

        def write(self, _data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    path = tmp_path / "ground-0.tlog"
    log = TelemetryLog(path, epoch_unix_us=0)
    frame = Encoder(system=1, component=1).encode(beat())
    log.add(0, frame)  # is written at once
    log._file.close()
    log._file = Full()
    for _ in range(MOST_BUFFERED // (TIME.size + len(frame))):
        log.add(1, frame)
    with pytest.raises(OSError, match="No space left") as raised:
        log.add(1, frame)
    assert raised.value.filename == str(path)
