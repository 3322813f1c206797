"""Random and malformed input at every port: no exceptions, no effect, bounded memory, exact counters."""

import contextlib
import gc
import select
import socket
import sys
import tracemalloc

import numpy as np
import pytest
from fuzz import BYTES, Fuzz, digest
from pymavlink.dialects.v20 import common
from vehicle_process import VehicleProcess, config

from autopilot.mavlink.codec import Encoder, Parser
from autopilot.mavlink.counters import Counters
from autopilot.mavlink.hil import HilActuatorControls, HilParser, HilSensor
from autopilot.services.service import COMPANION, GROUND_STATION, Addressed, Partner, is_addressed_to, reply
from harness.simulator.lockstep import VehicleSlot
from studies.vehicle.solo import STEP_US, Solo

BYTES_A_STEP = 16_000
"""Input of each link in a step."""
MOST_GROWTH_BYTES = 1_000_000
"""Largest growth of traced memory during the test."""
FALSE_ALARM = 1 / 65_536
"""Probability that a 16-bit checksum is right by accident."""
MOST_BLOCKS = 2_000
"""Largest growth in blocks of Python's memory."""
DEADLINE_S = 30.0
NO_STATE = frozenset({"not_addressed", "_decided"})
"""A counter, and an array that has places which are never read before they are written."""


class Attacked(Solo):
    """A flight whose vehicle receives additional messages with each step."""

    def __init__(self):
        super().__init__(config(), seed=np.random.SeedSequence(3))
        self.attack = []
        step_unattacked = self.vehicle.step

        def step(*, link_messages, **rest):
            sent, self.attack = self.attack, []
            return step_unattacked(link_messages=[*link_messages, *sent], **rest)

        self.vehicle.step = step


class Port:
    """A link's parser, with counts of its input and output."""

    def __init__(self, link, seed):
        self.link = link
        self.parser = Parser()
        self.sent_bytes = self.frame_bytes = self.frames = self.accidents = 0
        self._source = Fuzz(seed).datagrams(BYTES // 2)

    def receive(self, count_bytes):
        """Messages for other vehicles in the next datagrams, from changing partners."""
        messages, until = [], self.sent_bytes + count_bytes
        while self.sent_bytes < until and (datagram := next(self._source, None)) is not None:
            self.sent_bytes += len(datagram.data)
            received = self.parser.push_datagram(datagram.data)
            self.frame_bytes += sum(len(message.get_msgbuf()) for message in received)
            expected = set(datagram.frames)
            right = [message for message in received if bytes(message.get_msgbuf()) in expected]
            assert len(right) == len(datagram.frames)  # garbage hides no frame
            self.frames += len(right)
            self.accidents += len(received) - len(right)
            messages += reply(Partner(self.link, self.sent_bytes % 8), *right)
        return messages


def test_garbage_on_both_links_of_a_flying_vehicle_has_no_effect():
    plain, attacked = Attacked(), Attacked()
    for flight in (plain, attacked):
        flight.take_off(3.0)
    assert digest(plain.vehicle, leave_out=NO_STATE) == digest(attacked.vehicle, leave_out=NO_STATE)
    ports = [Port(GROUND_STATION, 1), Port(COMPANION, 2)]

    def step():
        attacked.attack = [message for port in ports for message in port.receive(BYTES_A_STEP)]
        outputs = [flight.step(streams=True) for flight in (plain, attacked)]
        sent = [[repr(addressed.message.to_dict()) for addressed in output.links] for output in outputs]
        assert sent[0] == sent[1]  # as text, since NaN is not equal to itself
        assert outputs[0].actuators == outputs[1].actuators
        for flight in (plain, attacked):
            flight.received.clear()

    def attack_until(sent_bytes):
        while sum(port.sent_bytes for port in ports) < sent_bytes:
            step()
        gc.collect()

    attack_until(BYTES // 20)
    blocks = sys.getallocatedblocks()
    attack_until(BYTES - BYTES // 10)
    assert sys.getallocatedblocks() - blocks < MOST_BLOCKS
    # tracing is slow, so it covers the last tenth only
    tracemalloc.start()
    step()
    before_bytes = tracemalloc.get_traced_memory()[0]
    attack_until(BYTES)
    growth_bytes = tracemalloc.get_traced_memory()[0] - before_bytes
    tracemalloc.stop()
    assert growth_bytes < MOST_GROWTH_BYTES / 10
    assert digest(plain.vehicle, leave_out=NO_STATE) == digest(attacked.vehicle, leave_out=NO_STATE)
    for port in ports:
        counters = port.parser.counters
        assert counters.bytes_bad + counters.bytes_unknown + port.frame_bytes == port.sent_bytes
        assert attacked.vehicle.messaging.not_addressed[port.link] == port.frames > BYTES / 10_000
        expected = counters.frames_bad_checksum * FALSE_ALARM
        assert port.accidents <= expected + 5 * expected**0.5 + 1
        for count in (counters.frames_bad_checksum, counters.frames_unknown, counters.frames_incompatible):
            assert count > port.sent_bytes / 1_000
    # and the digest detects a change
    attacked.vehicle.parameters.set("COM_DISARM_LAND", 1.5)
    assert digest(plain.vehicle, leave_out=NO_STATE) != digest(attacked.vehicle, leave_out=NO_STATE)


@pytest.mark.parametrize("hot", [HilActuatorControls, HilSensor], ids=["simulator", "vehicle"])
def test_garbage_on_the_simulator_link_gives_no_hot_message(hot):
    """Neither side accepts it as controls or sensor data; valid frames in between are parsed."""
    parser, sent_bytes, frame_bytes, hot_ones, blocks = HilParser(hot), 0, 0, 0, 0
    for datagram in Fuzz(3).datagrams(BYTES):
        sent_bytes += len(datagram.data)
        for message in parser.push(datagram.data):
            hot_ones += isinstance(message, hot)
            frame_bytes += 0 if isinstance(message, hot) else len(message.get_msgbuf())
        if not blocks and sent_bytes > BYTES // 10:
            blocks = sys.getallocatedblocks()
    assert hot_ones == 0
    assert sys.getallocatedblocks() - blocks < MOST_BLOCKS
    waiting = sent_bytes - frame_bytes - parser.bad_bytes
    assert 0 <= waiting < 280  # no more than a frame that may still be completed


def test_a_simulator_connection_accepts_its_vehicles_answers_after_garbage():
    connection, encoder = VehicleSlot(0), Encoder(system=1, component=1)
    for i, datagram in enumerate(Fuzz(4).datagrams(200_000)):
        time_us = STEP_US * (i + 1)
        answer = common.MAVLink_hil_actuator_controls_message(time_us, [0.5] * 16, 1, 1)
        connection.answer = None
        connection.take(datagram.data, time_us)
        assert connection.answer is None
        # the padding completes any frame that the garbage appears to begin
        connection.take(encoder.encode(answer) + bytes(300), time_us)
        assert connection.answer is not None
        assert connection.answer.time_usec == time_us


@pytest.mark.parametrize("flying", [False, True])
def test_messages_with_any_contents_neither_raise_nor_accumulate(flying):
    """Valid frames of every handled kind, addressed to the vehicle; the contents are arbitrary."""
    flight, fuzz = Attacked(), Fuzz(5)
    if flying:
        flight.take_off(3.0)
    else:
        flight.run(1.0)
    services = flight.vehicle.messaging.services._of_kind
    kinds = sorted({*services, common.MAVLINK_MSG_ID_HEARTBEAT})
    encoder, grown = Encoder(system=1, component=1), []
    rounds = 100
    for i in range(rounds):
        messages = [fuzz.message_to(kind) for kind in kinds]
        flight.attack = [Addressed(Partner(i % 2, i % 11), message) for message in messages]
        for addressed in flight.step(streams=True).links:
            encoder.encode(addressed.message)  # every answer can be encoded
        for _ in range(4):
            flight.step(streams=True)
        flight.received.clear()
        if i >= rounds // 2:
            gc.collect(0)
            grown.append(sys.getallocatedblocks())
    assert max(grown) - grown[0] < MOST_BLOCKS
    assert np.isfinite(flight.vehicle.flight.state.pos_ned_m).all()


@pytest.mark.parametrize("flying", [False, True])
def test_messages_with_any_contents_in_a_pause_neither_raise_nor_accumulate(flying):
    """The same without steps in between: state that is released only by time must stay bounded."""
    flight, fuzz = Attacked(), Fuzz(7)
    if flying:
        flight.take_off(3.0)
    else:
        flight.run(1.0)
    vehicle = flight.vehicle
    kinds = sorted({*vehicle.messaging.services._of_kind, common.MAVLINK_MSG_ID_HEARTBEAT})
    encoder, grown = Encoder(system=1, component=1), []
    rounds = 60
    for i in range(rounds):
        for kind in kinds:
            message = fuzz.message_to(kind)
            for addressed in vehicle.serve_while_paused([Addressed(Partner(i % 2, i % 11), message)]):
                encoder.encode(addressed.message)
        if i >= rounds // 2:
            gc.collect(0)
            grown.append(sys.getallocatedblocks())
    assert max(grown) - grown[0] < MOST_BLOCKS
    for addressed in flight.step(streams=True).links:
        encoder.encode(addressed.message)
    flight.run(0.5)
    assert np.isfinite(vehicle.flight.state.pos_ned_m).all()


def test_garbage_at_the_sockets_of_a_running_vehicle_is_counted_and_has_no_effect(tmp_path):
    with contextlib.ExitStack() as stack:
        vehicle = stack.enter_context(VehicleProcess(tmp_path))
        stranger = stack.enter_context(socket.create_connection(vehicle.simulator_address))
        sock = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        links = {"ground_station": "gcs_local_udp", "companion": "companion_local_udp"}
        parsers = {name: Parser() for name in links}  # reference for the counters
        received = dict.fromkeys(links, 0)
        sources = {name: Fuzz(6 + i).datagrams(BYTES) for i, name in enumerate(links)}
        for _ in range(40):
            for name, port in links.items():
                for _ in range(10):  # as many as kernel and budget admit until the next round
                    data = next(sources[name]).data[:1_400]
                    sock.sendto(data, ("127.0.0.1", vehicle.ports[port]))
                    messages = parsers[name].push_datagram(data)
                    received[name] += sum(not is_addressed_to(m, system=1, component=1) for m in messages)
            for _ in range(60):
                assert list(vehicle.step().controls) == [0.0] * 16
        assert not select.select([stranger], [], [], 0.0)[0]
        details = vehicle.finish()
    for name, parser in parsers.items():
        reported = Counters(**details["links"][name])
        assert reported.frames_bad_checksum > 100
        assert received[name] > 100
        assert reported.not_addressed + reported.setup_signing == received[name]
        reported.not_addressed = reported.setup_signing = 0
        assert reported == parser.counters
    bad_bytes = sum(parser.bad_bytes for parser in parsers.values())
    assert details["malformed_bytes"] == bad_bytes
