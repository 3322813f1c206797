"""The sockets of one ArduPilot: repeated packets, other senders, and the end of the program."""

import contextlib
import random
import socket
import struct
import time

import pytest
from pymavlink.dialects.v20 import common as mavlink

from autopilot.mavlink.codec import Encoder
from harness.simulator import ardupilot_link
from harness.simulator.ardupilot_json import servo_packet
from harness.simulator.ardupilot_link import MAX_PENDING, REPEAT_AFTER_S, ArduPilotLink

HOST = "127.0.0.1"
WAIT_S = 5.0
SYSTEM = 3
LINE = b'\n{"timestamp":0.004}\n'


def servos(count, pulse_us=1_000, channels=16):
    magic = {16: 18_458, 32: 29_569}[channels]
    return struct.pack(f"<HHI{channels}H", magic, 1_200, count, *[pulse_us] * channels)


def heartbeat(system=SYSTEM, component=1):
    message = mavlink.MAVLink_heartbeat_message(2, 3, 1, 4, 3, 3)
    return Encoder(system=system, component=component).encode(message)


class Ends:
    """A link, and the sockets of the program at its other end."""

    def __init__(self, stack):
        states = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        states.bind((HOST, 0))
        self.address = states.getsockname()
        self.listener = socket.create_server((HOST, 0))
        self.mavlink_address = self.listener.getsockname()
        self.link = stack.enter_context(
            contextlib.closing(ArduPilotLink(states, self.listener, system=SYSTEM))
        )
        self.stack = stack
        self.program = self.udp()

    def udp(self):
        sock = self.stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        sock.bind((HOST, 0))
        sock.settimeout(WAIT_S)
        return sock

    def tcp(self, data=b""):
        connection = self.stack.enter_context(socket.create_connection(self.mavlink_address, WAIT_S))
        connection.sendall(data)
        return connection

    def send(self, count, sock=None, **kwargs):
        (sock or self.program).sendto(servos(count, **kwargs), self.address)

    def arrive(self, count=0):
        self.send(count)
        until(self.link.arrive)

    def lines(self):
        """Return the datagrams that have arrived at the program."""
        received = []
        self.program.settimeout(0.0)
        with contextlib.suppress(BlockingIOError):
            while True:
                received.append(self.program.recv(65_536))
        self.program.settimeout(WAIT_S)
        return received

    def receive(self):
        """Return the number of the next packet; None: there is none; -1: the program has ended."""
        try:
            data = self.link.recv(4_096, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return None
        return servo_packet(data).frame_count if data else -1


def until(condition, wall_limit_s=WAIT_S):
    deadline_s = time.monotonic() + wall_limit_s
    while not (value := condition()):
        assert time.monotonic() < deadline_s
        time.sleep(0.002)
    return value


@pytest.fixture
def ends():
    with contextlib.ExitStack() as stack:
        yield Ends(stack)


@pytest.fixture
def wall(monkeypatch):
    """Return the wall time of the link, as a list of one number."""
    now_s = [1_000.0]
    monkeypatch.setattr(ardupilot_link.time, "monotonic", lambda: now_s[0])
    return now_s


# ---- repetitions


def test_each_state_is_answered_by_one_packet(ends):
    ends.arrive()
    for count in range(1, 6):
        ends.link.sendall(LINE)
        assert ends.program.recv(65_536) == LINE
        ends.send(count)
        assert ends.receive() == count
    assert ends.receive() is None


def test_packets_repeated_before_a_state_cause_no_further_state(ends):
    """ArduPilot would read a surplus state instead of the next one, and be one step late from then on."""
    ends.arrive()
    for _ in range(5):  # other vehicles take some seconds to arrive
        ends.send(0)
    ends.link.sendall(LINE)
    ends.send(1)
    assert ends.receive() == 1
    assert ends.lines() == [LINE]


def test_packets_repeated_while_the_simulation_rests_cause_no_further_state(ends, wall):
    ends.arrive()
    ends.link.sendall(LINE)
    ends.send(1)
    assert ends.receive() == 1
    for _ in range(5):
        ends.send(1)
    wall[0] += 5.5
    ends.lines()
    ends.link.sendall(LINE)
    assert ends.receive() is None
    ends.send(2)
    assert ends.receive() == 2
    assert ends.lines() == [LINE]


def test_a_repetition_that_crosses_the_state_causes_no_further_state(ends, wall):
    ends.arrive()
    ends.link.sendall(LINE)
    ends.send(0)
    wall[0] += REPEAT_AFTER_S / 2
    assert ends.receive() is None
    assert ends.lines() == [LINE]


def test_a_lost_state_is_repeated_once_per_repetition(ends, wall):
    ends.arrive()
    ends.link.sendall(LINE)
    ends.lines()  # lost
    for _ in range(3):
        wall[0] += 1.0
        ends.send(0)
        assert ends.receive() is None
        assert ends.lines() == [LINE]
    ends.send(1)
    assert ends.receive() == 1


def test_a_program_that_starts_again_has_other_sockets_and_is_not_received_from(ends):
    ends.arrive()
    ends.link.sendall(LINE)
    restarted = ends.udp()
    ends.send(0, restarted)
    ends.send(1, restarted)
    assert ends.receive() is None


@pytest.mark.parametrize("channels", [16, 32])
def test_both_sizes_fit_the_buffer_of_a_step(ends, channels):
    ends.arrive()
    ends.link.sendall(LINE)
    ends.send(1, channels=channels)
    buffer = memoryview(bytearray(250))
    size = ends.link.recv_into(buffer)
    assert servo_packet(buffer[:size]).frame_count == 1


# ---- other senders


def test_datagrams_of_others_before_and_after_the_first_packet_are_not_received(ends):
    stranger = ends.udp()
    generator = random.Random(5)  # noqa: S311
    for _ in range(50):
        stranger.sendto(generator.randbytes(generator.randrange(100)), ends.address)
    assert not ends.link.arrive()
    ends.send(0)
    for count in range(1, 20):  # valid ones, which wait when the program is connected
        ends.send(count, stranger, pulse_us=2_000)
    assert ends.link.arrive()
    for count in range(20, 40):
        ends.send(count, stranger, pulse_us=2_000)
    ends.link.sendall(LINE)
    assert ends.receive() is None
    ends.send(1)
    assert ends.receive() == 1
    stranger.settimeout(0.0)
    with pytest.raises(BlockingIOError):
        stranger.recv(1)


def test_junk_of_the_program_itself_is_no_answer(ends):
    ends.arrive()
    ends.link.sendall(LINE)
    for junk in (b"", b"\0", servos(1)[:-1], servos(1) + b"\0", b"\xff" * 40, bytes(4_000)):
        ends.program.sendto(junk, ends.address)
    assert ends.receive() is None
    ends.send(1)
    assert ends.receive() == 1


def test_connections_of_others_do_not_become_the_mavlink_link(ends):
    ends.arrive()
    junk = (b"", b"GET / HTTP/1.1\r\n\r\n", heartbeat(SYSTEM + 1), heartbeat(SYSTEM, 190), b"\xfd" * 5_000)
    strangers = [ends.tcp(data) for data in junk]
    ends.tcp().close()
    silent = [ends.tcp() for _ in range(MAX_PENDING)]
    program = ends.tcp(b"0 0 0 ")  # as ArduPilot begins
    for _ in range(10):
        assert ends.receive() is None
        for _ in range(MAX_PENDING):  # those that have ended do not count
            ends.tcp().close()
    with contextlib.suppress(ConnectionError):
        assert silent[0].recv(1) == b""  # the oldest
    program.sendall(heartbeat())
    received = []
    until(lambda: (ends.receive(), received.extend(ends.link.messages())) and received)
    assert [message.get_srcSystem() for message in received] == [SYSTEM]
    for stranger in strangers:  # their ends are not that of the vehicle
        with contextlib.suppress(ConnectionError):
            assert stranger.recv(1) == b""
        stranger.close()
    with pytest.raises(ConnectionRefusedError):  # the listener is closed
        ends.tcp(heartbeat())
    ends.link.sendall(LINE + b"fix")
    assert program.recv(100) == b"fix"
    assert ends.receive() is None


# ---- MAVLink


def test_what_follows_the_line_is_sent_to_the_mavlink_link(ends):
    ends.arrive()
    ends.link.sendall(LINE + b"lost: the link has not arrived")
    program = ends.tcp(heartbeat())
    received = []
    until(lambda: (ends.receive(), received.extend(ends.link.messages())) and received)
    ends.link.sendall(LINE + b"first")
    ends.link.sendall(LINE)
    ends.link.sendall(LINE + b"second")
    until(lambda: program.recv(100, socket.MSG_PEEK) == b"firstsecond")
    assert ends.lines() == [LINE] * 4


def test_messages_that_the_program_forwards_from_other_links_are_not_the_vehicles(ends):
    """A HEARTBEAT of the application would report its phase after its end."""
    ends.arrive()
    others = [heartbeat(SYSTEM, 191), heartbeat(255, 190), heartbeat(SYSTEM + 1)]
    program = ends.tcp(heartbeat() + b"".join(others))
    received = []
    until(lambda: (ends.receive(), received.extend(ends.link.messages())) and received)
    program.sendall(b"".join(others) + heartbeat())
    until(lambda: (ends.receive(), received.extend(ends.link.messages())) and len(received) > 1)
    assert [(each.get_srcSystem(), each.get_srcComponent()) for each in received] == [(SYSTEM, 1)] * 2


def test_a_link_that_is_not_read_does_not_stop_the_states(ends):
    ends.arrive()
    ends.tcp(heartbeat())
    received = []
    until(lambda: (ends.receive(), received.extend(ends.link.messages())) and received)
    for count in range(1, 200):
        ends.link.sendall(LINE + bytes(100_000))
        assert ends.lines() == [LINE]
        ends.send(count)
        assert ends.receive() == count


def test_the_end_of_the_mavlink_link_is_the_vehicles_end(ends):
    ends.arrive()
    program = ends.tcp(heartbeat())
    received = []
    until(lambda: (ends.receive(), received.extend(ends.link.messages())) and received)
    ends.link.sendall(LINE)
    assert ends.receive() is None
    program.close()
    assert until(ends.receive) == -1


def test_a_closed_state_port_is_the_vehicles_end(ends):
    ends.arrive()
    ends.program.close()
    ends.link.sendall(LINE)
    ends.link.sendall(LINE)
    assert ends.receive() == -1


def test_closing_closes_all_sockets_and_is_harmless_when_repeated(ends):
    ends.arrive()
    connections = [ends.tcp(heartbeat()), ends.tcp()]
    received = []
    until(lambda: (ends.receive(), received.extend(ends.link.messages())) and received)
    ends.link.close()
    ends.link.close()
    for connection in connections:
        with contextlib.suppress(ConnectionError):
            assert connection.recv(1) == b""
    with contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as again:
        again.bind(ends.address)
