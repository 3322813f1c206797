"""Signing against pymavlink's own signer and verifier, in both directions; forged frames change no state."""

import contextlib
import hashlib
import select
import socket
import time

import numpy as np
import pytest
from pymavlink.dialects.v20 import common
from vehicle_process import VehicleProcess

from autopilot.mavlink import signing
from autopilot.mavlink.codec import Encoder, Parser, Sequences
from autopilot.mavlink.codec import signed as sign_frame
from autopilot.mavlink.counters import Counters
from autopilot.mavlink.partners import BROADCAST
from autopilot.mavlink.signing import (
    KEY_BYTES,
    MAX_STREAMS,
    OLDEST_NEW_STREAM,
    SIGNATURE_BYTES,
    TICKS_PER_S,
    SignatureVerdict,
    Signer,
    SigningKeyError,
    SigningStreams,
    key_of,
)
from autopilot.mavlink.udp_link import UdpLink
from autopilot.parameters.config import LinksConfig

KEY = hashlib.sha256(b"correct horse").digest()
NOW = 3_600 * TICKS_PER_S * 24 * 365 * 10
DEADLINE_S = 5.0


def command(number=0):
    return common.MAVLink_command_long_message(1, 1, 400, 0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, float(number))


def oracle(key=KEY, *, now=NOW, link_id=0, system=255, component=190):
    """Pymavlink as a ground station that signs and verifies."""
    station = common.MAVLink(None, srcSystem=system, srcComponent=component)
    station.signing.secret_key = key
    station.signing.link_id = link_id
    station.signing.timestamp = now
    station.signing.sign_outgoing = True
    return station


def signed(key=KEY, number=0, **station):
    return command(number).pack(oracle(key, **station))


def test_frames_signed_by_pymavlink_are_accepted():
    parser, station = Parser(Signer(KEY, link_id=0)), oracle()
    for i in range(300):
        (received,) = parser.push_datagram(command(i).pack(station), NOW)
        assert received.param7 == i
    assert parser.counters == Counters()


def test_signed_frames_are_accepted_by_pymavlink():
    station, signer, sequences = oracle(), Signer(KEY, link_id=1), Sequences()
    encoder = Encoder(system=3, component=1)
    for i in range(300):
        unsigned = encoder.encode_for(command(i), sequences)
        frame = sign_frame(unsigned, common.MAVLINK_MSG_ID_COMMAND_LONG, signer, NOW)
        received = station.decode(bytearray(frame))
        assert received.get_signed()
        assert (received.get_link_id(), received.get_seq(), received.param7) == (1, i % 256, i)
    assert station.signing.badsig_count == 0
    with pytest.raises(common.MAVError):
        oracle(bytes(KEY_BYTES)).decode(bytearray(frame))


def test_every_single_bit_error_in_a_signed_frame_is_detected():
    frame = signed()
    for at in range(1, len(frame)):
        parser = Parser(Signer(KEY, link_id=0))
        spoiled = bytearray(frame)
        spoiled[at] ^= 1 << at % 8
        assert parser.push_datagram(bytes(spoiled), NOW) == []
        counters = parser.counters
        if at >= len(frame) - SIGNATURE_BYTES:  # the checksum does not cover the signature
            assert counters == Counters(signature_bad=1)


def test_unsigned_and_version_1_frames_are_dropped_and_counted():
    parser = Parser(Signer(KEY, link_id=0))
    sender = common.MAVLink(None, srcSystem=255, srcComponent=190)
    data = command().pack(sender) + command().pack(sender, force_mavlink1=True) + signed()
    assert len(parser.push_datagram(data, NOW)) == 1
    assert parser.counters == Counters(unsigned=2)


def test_without_a_key_signed_frames_are_accepted():
    (received,) = Parser().push_datagram(signed())
    assert received.command == 400


def test_timestamps_increase_within_a_stream_and_streams_are_independent():
    signer = Signer(KEY, link_id=0)
    first, second = signed(now=NOW), signed(now=NOW + 1)
    assert signer.judge(second, NOW) is SignatureVerdict.GOOD
    assert signer.judge(second, NOW) is SignatureVerdict.REPLAYED
    assert signer.judge(first, NOW) is SignatureVerdict.REPLAYED
    for other in ({"link_id": 1}, {"system": 254}, {"component": 191}):
        assert signer.judge(signed(now=NOW, **other), NOW) is SignatureVerdict.GOOD


def test_a_new_stream_older_than_a_minute_is_a_replay():
    frame = signed()
    assert Signer(KEY, link_id=0).judge(frame, NOW + OLDEST_NEW_STREAM) is SignatureVerdict.GOOD
    assert Signer(KEY, link_id=0).judge(frame, NOW + OLDEST_NEW_STREAM + 1) is SignatureVerdict.REPLAYED


def test_a_forged_timestamp_does_not_invalidate_later_frames_of_the_true_sender():
    signer = Signer(KEY, link_id=0)
    assert signer.judge(signed(bytes(KEY_BYTES), now=NOW + 1_000), NOW) is SignatureVerdict.BAD
    assert signer.judge(signed(), NOW) is SignatureVerdict.GOOD


def test_own_timestamps_increase_with_any_clock_and_follow_a_sender_that_is_ahead():
    signer = Signer(KEY, link_id=0)
    frame = Encoder(system=1, component=1).encode(command())

    def stamp_of(now):
        return int.from_bytes(signer.sign(frame, now)[-SIGNATURE_BYTES + 1 :][:6], "little")

    stamps = [stamp_of(now) for now in (NOW, NOW, NOW - 50, NOW + 10, 0)]
    assert stamps == [NOW, NOW + 1, NOW + 2, NOW + 10, NOW + 11]
    signer.judge(signed(now=NOW + 500), NOW)
    assert stamp_of(NOW) == NOW + 501
    assert stamp_of(1 << 60) == stamp_of(1 << 60) == (1 << 48) - 1  # the largest timestamp does not raise


def test_the_number_of_streams_is_bounded_and_those_older_than_a_minute_are_dropped():
    signer = Signer(KEY, link_id=0)
    streams = [{"link_id": i, "component": 1} for i in range(MAX_STREAMS)]
    for stream in streams:
        assert signer.judge(signed(**stream), NOW) is SignatureVerdict.GOOD
    one_more = {"component": 2, "now": NOW + OLDEST_NEW_STREAM + 2}
    assert signer.judge(signed(**one_more), NOW + OLDEST_NEW_STREAM) is SignatureVerdict.REPLAYED
    assert signer.judge(signed(**one_more), NOW + OLDEST_NEW_STREAM + 1) is SignatureVerdict.GOOD
    for stream in streams:  # dropped, but their frames are still replays
        assert signer.judge(signed(**stream), NOW + OLDEST_NEW_STREAM + 1) is SignatureVerdict.REPLAYED


def test_a_frame_received_at_one_port_is_a_replay_at_the_others():
    received = SigningStreams()
    ports = [Signer(KEY, link_id=i, received=received) for i in range(2)]
    frames = [signed(now=NOW + i) for i in range(4)]
    assert ports[0].judge(frames[1], NOW) is SignatureVerdict.GOOD
    assert [ports[1].judge(frame, NOW) for frame in frames[:2]] == [SignatureVerdict.REPLAYED] * 2
    assert ports[1].judge(frames[2], NOW) is SignatureVerdict.GOOD
    assert ports[0].judge(frames[2], NOW) is SignatureVerdict.REPLAYED


def test_random_bytes_with_a_key_never_raise():
    rng, parser = np.random.default_rng(4), Parser(Signer(KEY, link_id=0))
    for _ in range(2_000):
        frame = bytearray(signed())
        for _ in range(rng.integers(1, 4)):
            frame[rng.integers(len(frame))] = rng.integers(256)
        parser.push_datagram(bytes(frame[: rng.integers(len(frame) + 1)]), NOW)
    assert parser.counters.signature_bad > 0


@pytest.mark.parametrize(
    ("text", "key"),
    [
        (b"correct horse\n", KEY),
        (b"correct horse", KEY),
        (KEY.hex().encode() + b"\n", KEY),
        (KEY, KEY),
        (b"x" * 64, hashlib.sha256(b"x" * 64).digest()),
        (b"x" * KEY_BYTES, hashlib.sha256(b"x" * KEY_BYTES).digest()),
    ],
)
def test_a_key_file_has_a_passphrase_or_a_key(text, key):
    assert key_of(text) == key


@pytest.mark.parametrize("text", [b"", b"\n", b"\0" * 31, b"\xff\xfe", b"two\nlines"])
def test_other_contents_are_not_a_key(text):
    with pytest.raises(SigningKeyError):
        key_of(text)
    with pytest.raises(SigningKeyError):
        Signer(b"short", link_id=0)


def test_a_link_with_a_key_accepts_and_answers_only_signed_partners():
    with contextlib.ExitStack() as stack:
        ground, stranger = (
            stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2)
        )
        link = stack.enter_context(
            contextlib.closing(
                UdpLink(
                    host="127.0.0.1",
                    local_port=0,
                    remote_port=0,
                    encoder=Encoder(system=1, component=1),
                    signer=Signer(KEY, link_id=0),
                )
            )
        )
        clock = link._now()
        assert clock // TICKS_PER_S + signing.EPOCH_UNIX_S > 1_735_689_600  # after 2025-01-01
        for sock, frame in (
            (stranger, command().pack(common.MAVLink(None, srcSystem=255))),
            (stranger, signed(bytes(KEY_BYTES), now=clock)),
            (ground, signed(now=clock)),
        ):
            sock.settimeout(DEADLINE_S)
            sock.sendto(frame, ("127.0.0.1", link.local_port))
            assert select.select([link], [], [], DEADLINE_S)[0]
            received = link.receive(0)
        assert [message.command for _, message in received] == [400]
        assert link.counters == Counters(unsigned=1, signature_bad=1)
        link.send([(BROADCAST, command())])
        answer = oracle(now=clock).decode(bytearray(ground.recv(2048)))
        assert answer.get_signed()
        assert not select.select([stranger], [], [], 0.0)[0]


def test_a_vehicle_with_a_key_ignores_unsigned_messages_and_reports_the_counts(tmp_path):
    """PARAM_SET unsigned, with another key, and signed; the last is then replayed to both ports."""
    key_file = tmp_path / "key"
    key_file.write_text("correct horse\n")
    name = b"MPC_XY_VEL_MAX"
    with contextlib.ExitStack() as stack:
        vehicle = stack.enter_context(
            VehicleProcess(tmp_path, links=LinksConfig(signing_key_file=str(key_file)))
        )
        sock = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        sock.settimeout(DEADLINE_S)
        now = (time.time_ns() // 10_000) - signing.EPOCH_UNIX_S * TICKS_PER_S
        station, unsigned = oracle(now=now), common.MAVLink(None, srcSystem=255, srcComponent=190)

        def setting(value, sender):
            kind = common.MAV_PARAM_TYPE_REAL32
            return common.MAVLink_param_set_message(1, 1, name, value, kind).pack(sender)

        right = setting(5.0, station)
        read = common.MAVLink_param_request_read_message(1, 1, name, -1).pack(station)
        stranger = oracle(bytes(KEY_BYTES), now=now)
        wrong = setting(3.0, unsigned), setting(4.0, stranger), setting(6.0, unsigned)
        for frame in (*wrong, right, right, read):
            sock.sendto(frame, ("127.0.0.1", vehicle.ports["gcs_local_udp"]))
        # ports are read in order
        sock.sendto(right, ("127.0.0.1", vehicle.ports["companion_local_udp"]))
        values = []
        for _ in range(500):  # two seconds of simulated time
            if len(values) == 2:
                break
            vehicle.step()
            while select.select([sock], [], [], 0.0)[0]:
                values += [
                    received.param_value
                    for received in Parser(Signer(KEY, link_id=9)).push_datagram(sock.recv(4096), now)
                    if received.get_type() == "PARAM_VALUE"
                ]
        assert values == [5.0, 5.0]
        links = vehicle.finish()["links"]
    assert Counters(**links["ground_station"]) == Counters(unsigned=2, signature_bad=1, replayed=1)
    assert Counters(**links["companion"]) == Counters(replayed=1)
