"""The study of attacks: its mutations, its judgement, and the core of its attacks on real flights (60 s)."""

import socket
import sys
import tempfile
import threading
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from other_user import root_only
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Parser
from studies.attacks import comparison, files_section, mavlink_section, radio_section, slots_section
from studies.attacks.bytes_section import fly as fly_bytes
from studies.attacks.comparison import ComparedFlight, Comparison
from studies.attacks.datagram_attacks import send_steadily
from studies.attacks.datagrams_section import Pair, Sender
from studies.attacks.datagrams_section import judge as judge_datagrams
from studies.attacks.files_section import Tried
from studies.attacks.launch import AttackError, AttackProcess
from studies.attacks.mavlink_attacks import frames
from studies.attacks.plan import QUICK_ATTACKS
from studies.attacks.sockets import HERE, free_base
from studies.attacks.tasks import IdleConnections, OpenEverything, RefusedLogins, Report, SteadyDatagrams

SMALL = replace(
    QUICK_ATTACKS,
    random_bytes=300_000,
    small_datagrams=200,
    forged_batches=20,
    altered_connections=3,
    idle_connections=5,
    least_s=1.0,
)


def failed(checks):
    return {check.name.partition(": ")[2] for check in checks if not check.passed}


# ---- mutated messages


def test_every_kind_of_message_and_every_command_is_sent_with_right_and_wrong_checksums():
    parser, parsed = Parser(), Counter()
    commands = set()
    for frame in frames(1, np.random.default_rng(1)):
        for message in parser.push_datagram(frame):
            parsed[message.get_msgId()] += 1
            if message.get_msgId() == common.MAVLINK_MSG_ID_COMMAND_LONG:
                commands.add(message.command)
    assert {*parsed} == {*common.mavlink_map}
    assert min(parsed.values()) >= 3
    assert {command & 0xFFFF for command in common.enums["MAV_CMD"]} <= commands
    assert parser.counters.frames_bad_checksum > len(common.mavlink_map) // 2


def test_equal_seeds_give_equal_frames():
    assert [*frames(2, np.random.default_rng(4))] == [*frames(2, np.random.default_rng(4))]
    assert [*frames(2, np.random.default_rng(4))] != [*frames(2, np.random.default_rng(5))]


# ---- judgement


def flown(**changed):
    usual = {
        "simulated_s": 6.0, "log_sha256": "a", "status": "not_formed", "causes": [],
        "grown_mb": {"radio": 50.0}, "unknown": [],
        "details": {"physics": {"rejected_connections": [{"count": 3}]}},
    }  # fmt: skip
    return ComparedFlight(**usual | changed)


def compared(*, may_influence=False, **changed):
    return Comparison(title="t", attacked=flown(**changed), plain=flown(), may_influence=may_influence)


@pytest.mark.parametrize(
    ("changed", "found"),
    [
        ({}, set()),
        ({"log_sha256": "b"}, {"logs that differ without a named cause"}),
        ({"log_sha256": "b", "causes": ["x"]}, {"named influences"}),
        ({"log_sha256": "b", "causes": ["x"], "may_influence": True}, set()),
        ({"unknown": ["q"], "causes": ["x"], "may_influence": True}, {"columns that are no longer finite"}),
        ({"status": "failed"}, {"flights that ended early"}),
        ({"grown_mb": {"radio": 90.0}}, {"memory that the attack adds to a process"}),
        ({"reports": [Report(found=["reads a file"])]}, {"findings"}),
    ],
)
def test_what_an_attack_does_is_found(changed, found):
    assert failed(comparison.checks(compared(**changed))) == found


def test_a_flight_that_an_attack_ends_is_found_and_its_error_is_shown():
    ended = Comparison(title="t", attacked=None, plain=None, error="uav 1 was lost")
    assert failed(comparison.checks(ended)) == {"flights that ended early"}
    assert "uav 1 was lost" in comparison.row(ended)
    for section, group in ((mavlink_section, "mavlink"), (slots_section, "slots"), (radio_section, "radio")):
        assert failed(section.judge(SMALL, {group: [ended]}).checks) == {"flights that ended early"}


def test_mutated_messages_have_to_be_named():
    section = mavlink_section.judge(SMALL, {"mavlink": [compared(may_influence=True)]})
    assert failed(section.checks) == {"named influences"}


def test_a_slow_flight_and_a_slow_sender_are_found():
    def pair(beside, sent_s):
        sender = Sender(name="own user", is_other=False, rate_s=15_000.0)
        return Pair(sender=sender, without=4.0, beside=beside, sent_s=sent_s)

    def judged(*pairs):
        return failed(judge_datagrams(SMALL, {"datagrams": [[*pairs]]}).checks)

    assert judged(pair(2.1, 15_000.0), pair(3.0, 14_000.0), pair(1.0, 15_000.0)) == set()
    assert judged(pair(1.9, 15_000.0)) == {"share of the speed that is left"}
    assert judged(pair(3.0, 9_000.0)) == {"datagrams per second"}


def test_a_file_that_can_be_read_is_found_and_listed():
    tried = [Tried(place="run", report=Report(counts={"files": 2}, found=["reads x"]))]
    section = files_section.judge(SMALL, {"files": tried})
    assert [check.passed for check in section.checks] == [False]
    assert section.tables[-1].rows == (("reads x",),)
    skipped = files_section.judge(SMALL, {"files": [Tried(place="run", report=None)]})
    assert skipped.checks == ()
    assert "Nothing was tried" in skipped.conditions.replace("\n", " ")


# ---- programs that attack


@root_only
def test_another_user_opens_what_is_open_and_nothing_else():
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o711)
        readable, private = folder / "readable", folder / "private"
        for path, mode in ((readable, 0o644), (private, 0o600)):
            path.write_text("")
            path.chmod(mode)
        task = OpenEverything(paths=[str(readable), str(private), str(folder)], sockets=[], pids=[1])
        with AttackProcess(task, is_other=True) as process:
            report = process.report()
    assert report.found == [f"reads {readable}"]
    assert report.counts == {"files and folders": 3, "processes": 1}


def test_an_attack_that_fails_itself_is_one_line(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(AttackError, match="status 1") as raised:
        AttackProcess(RefusedLogins(logins=[], limit_s=0.1), is_other=False)
    assert "\n" not in str(raised.value)


def test_a_program_that_writes_many_messages_is_not_held_by_them(monkeypatch, tmp_path):
    program = tmp_path / "program"
    program.write_text("#!/bin/sh\nhead -c 1000000 /dev/zero >&2; echo begun; echo '{}'\n")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    with AttackProcess(RefusedLogins(logins=[], limit_s=0.1), is_other=False) as process:
        assert process.report() == Report()


class _StandInSwarm:
    """A swarm whose time passes without processes."""

    def __init__(self, *_, out, **__):
        self.path, self.pids = out, {}
        self.truth = self
        self.t_s = 0.0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def run(self, until_s):
        self.t_s = until_s

    def run_for(self, duration_s):
        self.t_s += duration_s

    def set_speed(self, _):
        pass


def test_a_flight_does_not_wait_for_an_attack_without_end(monkeypatch):
    monkeypatch.setattr(comparison, "Swarm", _StandInSwarm)
    monkeypatch.setattr(comparison, "ATTACK_LIMIT_S", 0.2)
    endless = IdleConnections(streams_to=[(HERE, free_base(1))], count=1, introduction=b"")
    with pytest.raises(AttackError, match="does not end within"):
        comparison.compare("t", lambda _: [comparison.Attack(task=endless)], least_s=0.0)


@pytest.mark.parametrize("one_port", [False, True])
def test_datagrams_of_many_sockets_come_from_many_ports_or_from_many_addresses(one_port):
    ended = threading.Event()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind((HERE, 0))
        receiver.settimeout(20.0)
        task = SteadyDatagrams(
            datagrams_to=receiver.getsockname(), rate_s=1_000.0, sockets=300, one_port=one_port
        )
        sender = threading.Thread(target=send_steadily, args=(task, ended))
        sender.start()
        try:
            sources = {receiver.recvfrom(1_000)[1] for _ in range(900)}
        finally:
            ended.set()
            sender.join()
    addresses, ports = ({source[i] for source in sources} for i in range(2))
    assert len(sources) > 200
    assert (len(addresses), len(ports)) == ((len(sources), 1) if one_port else (1, len(sources)))


# ---- real flights


@pytest.mark.multiprocess
@root_only
def test_random_bytes_and_foreign_connections_of_another_user_change_no_byte_of_a_flight():
    for one in (fly_bytes(SMALL, "tcp", True), slots_section.fly(SMALL, True)):  # noqa: FBT003
        assert failed(comparison.checks(one)) == set(), comparison.row(one)


@pytest.mark.multiprocess
@pytest.mark.parametrize("kind", ["guest: forged batches", "own user, no password"])
def test_forged_batches_and_wrong_passwords_change_no_byte_of_a_flight(kind):
    one = radio_section.fly(SMALL, kind, "unix")
    assert failed(comparison.checks(one)) == set(), comparison.row(one)
