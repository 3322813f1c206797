"""Guests of a real emulator at wall-clock pace, among them the programs of the documentation."""

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from netsim_pcapng import interfaces
from paths import ROOT

from netsim.transport.guest import Guest
from netsim.transport.lockstep_radio import RadioLost
from netsim.transport.zenoh_session import TransportError
from netsim.wire.messages import Delivery, FtmResult, Sent

pytestmark = pytest.mark.multiprocess

PROGRAMS = re.findall(
    r"<!-- the tests run it -->\n```python\n(.*?)```",
    (ROOT / "docs/reference/radio-api.md").read_text(),
    re.DOTALL,
)
DEADLINE_S = 120.0
"""Wall time limit of a process: the longest test transmits 17 MB, 30 s of air time on an idle machine."""


@contextlib.contextmanager
def process(*command):
    """Start a process, and kill it at the end or after `DEADLINE_S`."""
    child = subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, cwd=ROOT, env={**os.environ, "PYTHONUNBUFFERED": "1"}
    )
    timer = threading.Timer(DEADLINE_S, child.kill)
    timer.start()
    try:
        yield child
    finally:
        timer.cancel()
        child.kill()
        child.wait()
        child.stdout.close()


@contextlib.contextmanager
def laboratory(*options):
    """Yield folder and process of an emulator with s0, s1 and s2 on a circle of 15 m."""
    command = ("scripts/wifi_lab.py", "serve", "--stations", "3", *options)
    with process(sys.executable, *command) as server:
        folder, _, names = server.stdout.readline().strip().split(" ", 2)
        assert names == "s0, s1, s2"
        try:
            yield folder, server
        finally:
            server.send_signal(signal.SIGTERM)
            server.wait(DEADLINE_S)
            shutil.rmtree(folder, ignore_errors=True)  # of an emulator that the test has killed


@pytest.fixture
def lab():
    with laboratory() as (folder, _):
        yield folder


def wait_for(radio, kind):
    """Return the next item of a kind."""
    for _ in range(100):
        for item in radio.receive(timeout_s=DEADLINE_S / 100):
            if isinstance(item, kind):
                return item
    pytest.fail(f"no {kind.__name__} within {DEADLINE_S} s")


def test_a_capture_has_the_dates_of_the_hosts_clock_and_the_stations_names(tmp_path):
    path, settings = tmp_path / "air.pcapng", tmp_path / "radio.json"
    settings.write_text('{"capture": "receivers"}')
    begun_ns = time.time_ns()
    with laboratory("--capture", str(path), "--settings", str(settings)) as (folder, server):
        with Guest(folder, name="s0") as one, Guest(folder, name="s2") as other:
            one.broadcast(b"dated")
            assert wait_for(other, Delivery).payload == b"dated"
        server.send_signal(signal.SIGINT)
        server.wait(DEADLINE_S)
    names, found = interfaces(path.read_bytes())
    assert names == ["s0", "s1", "s2"]
    assert {interface for interface, *_ in found} == {0, 1, 2}
    assert all(begun_ns < time_ns < time.time_ns() for _, time_ns, *_ in found)


def test_documentation_has_programs_with_and_without_coflight():
    assert len(PROGRAMS) == 2
    assert all(len(program.splitlines()) <= 24 for program in PROGRAMS)
    assert "netsim" not in PROGRAMS[1]


def test_programs_of_the_documentation_are_stations(lab, tmp_path):
    scripts = [tmp_path / f"program{i}.py" for i in range(2)]
    for script, program in zip(scripts, PROGRAMS, strict=True):
        script.write_text(program)
    with (
        Guest(lab, name="s0") as radio,
        process(sys.executable, str(scripts[0]), lab, "s1") as first,
    ):
        delivery = wait_for(radio, Delivery)
        assert (delivery.source, delivery.payload) == (1, b"s1 is station 1")
        # 26 m: 46.8 dB at 1 m and 28.3 dB more, from 16 dBm; the fading has a K factor of 12 dB
        assert -75.0 < delivery.rssi_dbm < -50.0
        line = first.stdout.readline()
        assert re.fullmatch(r"station 0: 2[4-8]\.\d\d m\n", line), line
        with process(sys.executable, str(scripts[1]), lab, "s2") as second:
            assert wait_for(radio, Delivery).payload == b"s2 is station 2"
            assert "s2 is station 2" in first.stdout.readline()
            assert "thank you" in second.stdout.readline()


def test_unicast_is_acknowledged_and_ranging_completes(lab):
    with Guest(lab, name="s0") as one, Guest(lab, name="s2") as other:
        seq = one.unicast(other.station, b"to you alone", port=4000)
        received = wait_for(other, Delivery)
        assert (received.payload, received.port) == (b"to you alone", 4000)
        sent = wait_for(one, Sent)
        assert (sent.seq, sent.status, sent.destination) == (seq, "acknowledged", 2)
        seq = other.request_ftm(peer=1)
        result = wait_for(other, FtmResult)
        assert (result.seq, result.status, result.peer) == (seq, "ok", 1)
        assert result.distance_m == pytest.approx(26.0, abs=1.0)
        assert other.now_us > 0


def test_unknown_guest_is_refused_with_the_list_of_guests(lab):
    with pytest.raises(RadioLost, match="no guest 'ground' on this channel; its guests: s0, s1, s2"):
        Guest(lab, name="ground")


def test_a_guest_without_a_radio_is_one_line(tmp_path):
    with laboratory() as (folder, _):
        access = (Path(folder) / "guests.json").read_bytes()
    path = tmp_path / "guests.json"
    for place, line in (
        (
            folder,
            rf"{folder}: no such file; pass the folder of a run that flies now and has \[\[radio.guests\]\]",
        ),
        (tmp_path, rf"{path}: no such file; pass the folder of a run that flies now"),
        ("tcp/127.0.0.1:7447", "no such file; a radio's endpoint alone is not enough: pass the run's folder"),
    ):
        with pytest.raises(TransportError, match=line):
            Guest(place, name="s0")
    path.write_bytes(b"{}")
    with pytest.raises(TransportError, match=rf"{path}: not the file guests.json of a run's radio: "):
        Guest(path, name="s0")
    path.write_bytes(access)  # of a run that has ended
    with pytest.raises(
        TransportError, match=r"cannot connect to unixsock-stream.*: No such file or directory; "
    ):
        Guest(tmp_path, name="s0")


def test_invalid_requests_raise_before_transmission(lab):
    with Guest(lab, name="s0") as radio:
        for send in (
            lambda: radio.broadcast(b"x" * 1473),
            lambda: radio.broadcast("text"),
            lambda: radio.unicast(-1, b""),
            lambda: radio.request_ftm(65_536),
        ):
            with pytest.raises(ValueError, match=r"a datagram must have at most|a station number must be"):
                send()
        assert radio.broadcast(b"x" * 1472) == 1
        for station in (0, 3):  # itself, and an unused number
            assert radio.unicast(station, b"") > 1
            assert wait_for(radio, Sent).status == "rejected"


def test_end_of_the_emulator_raises_in_receive():
    with laboratory() as (folder, server), Guest(folder, name="s0") as radio:
        assert radio.receive(timeout_s=0.1) == []
        server.kill()
        with pytest.raises(RadioLost, match="emulator has ended"):
            wait_for(radio, Delivery)


LISTENER = """
import signal, sys
from netsim.transport.guest import Guest
radio = Guest(sys.argv[1], name=sys.argv[2])
print("ready", flush=True)
signal.pause()
"""


def test_stopped_guest_does_not_block_others(lab):
    with (
        process(sys.executable, "-c", LISTENER, lab, "s2") as stopped,
        Guest(lab, name="s0") as sender,
        Guest(lab, name="s1") as receiver,
    ):
        assert stopped.stdout.readline() == "ready\n"
        os.kill(stopped.pid, signal.SIGSTOP)
        for _ in range(3000):  # 17 MB, more than the buffers to the stopped guest hold
            for _ in range(4):
                sender.broadcast(b"x" * 1472)
            assert receiver.receive(timeout_s=4.0)  # a blocked emulator would exceed this


def test_two_copies_of_the_documentation_program_stop_transmitting(lab, tmp_path):
    script = tmp_path / "program.py"
    script.write_text(PROGRAMS[0])
    with (
        process(sys.executable, str(script), lab, "s1") as one,
        process(sys.executable, str(script), lab, "s2") as other,
        Guest(lab, name="s0") as radio,
    ):
        # each broadcasts its name; then there is no traffic until the next broadcast
        for child in (one, other):
            while not child.stdout.readline().startswith("station 0:"):
                pass
        radio.broadcast(b"a question")
        received = []
        for _ in range(30):
            items = radio.receive(timeout_s=2.0)
            if not items:
                break
            received += [item for item in items if isinstance(item, Delivery)]
        else:
            pytest.fail("the stations do not stop transmitting")
        assert {item.source for item in received if item.payload == b"thank you"} == {1, 2}
