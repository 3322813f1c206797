"""Hostile bytes at every port: nothing raises, nothing changes, memory stays, and the counters tell all."""

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
from harness.simulator.lockstep import ConnectionState
from studies.vehicle.solo import STEP_US, Solo

BYTES_A_STEP = 16_000
"""Of each link."""
MOST_GROWTH_BYTES = 1_000_000
"""Of traced memory, from the first of all bytes to the last."""
FALSE_ALARM = 1 / 65_536
"""Chance that a checksum of 16 bits is right by accident."""
MOST_BLOCKS = 2_000
"""Of Python's memory, that a part may take more than at first."""
DEADLINE_S = 30.0
NO_STATE = frozenset({"not_addressed", "_decided"})
"""A counter, and an array of which only some places are ever written before they are read."""


class Attacked(Solo):
    """A flight whose vehicle may be sent anything with each step."""

    def __init__(self):
        super().__init__(config(), seed=np.random.SeedSequence(3))
        self.attack = []
        taken_in = self.vehicle.step

        def step(*, link_messages, **rest):
            sent, self.attack = self.attack, []
            return taken_in(link_messages=[*link_messages, *sent], **rest)

        self.vehicle.step = step


class Port:
    """A link's parser, with an account of what it was sent and what came out."""

    def __init__(self, link, seed):
        self.link = link
        self.parser = Parser()
        self.sent_bytes = self.heard_bytes = self.heard_frames = self.accidents = 0
        self._source = Fuzz(seed).datagrams(BYTES // 2)

    def hear(self, count_bytes):
        """What is meant for others among the next datagrams, from partners that come and go."""
        messages, until = [], self.sent_bytes + count_bytes
        while self.sent_bytes < until and (datagram := next(self._source, None)) is not None:
            self.sent_bytes += len(datagram.data)
            heard = self.parser.push_datagram(datagram.data)
            self.heard_bytes += sum(len(message.get_msgbuf()) for message in heard)
            wanted = set(datagram.frames)
            right = [message for message in heard if bytes(message.get_msgbuf()) in wanted]
            assert len(right) == len(datagram.frames)  # garbage hides no frame
            self.heard_frames += len(right)
            self.accidents += len(heard) - len(right)
            messages += reply(Partner(self.link, self.sent_bytes % 8), *right)
        return messages


def test_garbage_on_both_links_of_a_flying_vehicle_changes_nothing():
    plain, attacked = Attacked(), Attacked()
    for flight in (plain, attacked):
        flight.take_off(3.0)
    assert digest(plain.vehicle, leave_out=NO_STATE) == digest(attacked.vehicle, leave_out=NO_STATE)
    ports = [Port(GROUND_STATION, 1), Port(COMPANION, 2)]

    def step():
        attacked.attack = [message for port in ports for message in port.hear(BYTES_A_STEP)]
        outputs = [flight.step(streams=True) for flight in (plain, attacked)]
        said = [[repr(addressed.message.to_dict()) for addressed in output.links] for output in outputs]
        assert said[0] == said[1]  # as text, for unknown numbers are equal to none
        assert outputs[0].actuators == outputs[1].actuators
        for flight in (plain, attacked):
            flight.heard.clear()

    def attack_until(sent_bytes):
        while sum(port.sent_bytes for port in ports) < sent_bytes:
            step()
        gc.collect()

    attack_until(BYTES // 20)
    blocks = sys.getallocatedblocks()
    attack_until(BYTES - BYTES // 10)
    assert sys.getallocatedblocks() - blocks < MOST_BLOCKS
    # tracing is slow: the rest stands for all
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
        assert counters.bytes_bad + port.heard_bytes == port.sent_bytes
        assert attacked.vehicle.messaging.not_addressed[port.link] == port.heard_frames > BYTES / 10_000
        expected = counters.frames_bad_checksum * FALSE_ALARM
        assert port.accidents <= expected + 5 * expected**0.5 + 1
        for count in (counters.frames_bad_checksum, counters.frames_unknown, counters.frames_incompatible):
            assert count > port.sent_bytes / 1_000
    # and a change would have been seen
    attacked.vehicle.set_parameter("COM_DISARM_LAND", 1.5)
    assert digest(plain.vehicle, leave_out=NO_STATE) != digest(attacked.vehicle, leave_out=NO_STATE)


@pytest.mark.parametrize("hot", [HilActuatorControls, HilSensor], ids=["simulator", "vehicle"])
def test_garbage_on_the_simulators_link_says_nothing(hot):
    """Neither side takes it for an answer, or for sensors; what comes in between is heard."""
    parser, sent_bytes, heard_bytes, hot_ones, blocks = HilParser(hot), 0, 0, 0, 0
    for datagram in Fuzz(3).datagrams(BYTES):
        sent_bytes += len(datagram.data)
        for message in parser.push(datagram.data):
            hot_ones += isinstance(message, hot)
            heard_bytes += 0 if isinstance(message, hot) else len(message.get_msgbuf())
        if not blocks and sent_bytes > BYTES // 10:
            blocks = sys.getallocatedblocks()
    assert hot_ones == 0
    assert sys.getallocatedblocks() - blocks < MOST_BLOCKS
    waiting = sent_bytes - heard_bytes - parser.bad_bytes
    assert 0 <= waiting < 280  # no more than a frame that may still be completed


def test_a_seat_hears_its_vehicle_through_garbage():
    voice, encoder = ConnectionState(0), Encoder(system=1, component=1)
    for i, datagram in enumerate(Fuzz(4).datagrams(200_000)):
        time_us = STEP_US * (i + 1)
        answer = common.MAVLink_hil_actuator_controls_message(time_us, [0.5] * 16, 1, 1)
        voice.answer = None
        voice.take(datagram.data, time_us)
        assert voice.answer is None
        # what follows is the end of whatever frame the garbage pretends to begin
        voice.take(encoder.encode(answer) + bytes(300), time_us)
        assert voice.answer is not None
        assert voice.answer.time_usec == time_us


@pytest.mark.parametrize("flying", [False, True])
def test_messages_that_say_anything_at_all_to_a_vehicle_neither_raise_nor_pile_up(flying):
    """Right frames for it, of every kind that any part of it takes, with any contents: it may do as told."""
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
            encoder.encode(addressed.message)  # can be sent, too
        for _ in range(4):
            flight.step(streams=True)
        flight.heard.clear()
        if i >= rounds // 2:
            gc.collect(0)
            grown.append(sys.getallocatedblocks())
    assert max(grown) - grown[0] < MOST_BLOCKS
    assert np.isfinite(flight.vehicle.flight.state.pos_ned_m).all()


@pytest.mark.parametrize("flying", [False, True])
def test_messages_that_say_anything_at_all_in_a_pause_neither_raise_nor_pile_up(flying):
    """The same without a step in between: nothing that only time would end may grow."""
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


def test_garbage_at_the_sockets_of_a_running_vehicle_is_counted_and_changes_nothing(tmp_path):
    with contextlib.ExitStack() as stack:
        vehicle = stack.enter_context(VehicleProcess(tmp_path))
        stranger = stack.enter_context(socket.create_connection(vehicle.simulator_address))
        sock = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        links = {"ground_station": "gcs_local_udp", "companion": "companion_local_udp"}
        parsers = {name: Parser() for name in links}  # what should come of it
        heard = dict.fromkeys(links, 0)
        sources = {name: Fuzz(6 + i).datagrams(BYTES) for i, name in enumerate(links)}
        for _ in range(40):
            for name, port in links.items():
                for _ in range(10):  # what the kernel keeps until the vehicle looks
                    data = next(sources[name]).data[:1_400]
                    sock.sendto(data, ("127.0.0.1", vehicle.ports[port]))
                    messages = parsers[name].push_datagram(data)
                    heard[name] += sum(not is_addressed_to(m, system=1, component=1) for m in messages)
            for _ in range(6):
                assert vehicle.step().controls == [0.0] * 16
        assert not select.select([stranger], [], [], 0.0)[0]
        details = vehicle.finish()
    for name, parser in parsers.items():
        told = Counters(**details["links"][name])
        assert told.frames_bad_checksum > 100
        assert heard[name] > 100
        assert told.not_addressed + told.setup_signing == heard[name]
        told.not_addressed = told.setup_signing = 0
        assert told == parser.counters
    bad_bytes = sum(parser.bad_bytes for parser in parsers.values())
    assert details["malformed_bytes"] == bad_bytes
