"""Other programs on the radio: the documentation's own, against a real emulator in its own time."""

import contextlib
import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from netsim.guest import Guest
from netsim.radio import RadioLost
from netsim.transport import Transport, TransportError
from netsim.wire.messages import Delivery, FtmResult, Sent

pytestmark = pytest.mark.multiprocess

ROOT = Path(__file__).parents[2]
PROGRAMS = re.findall(
    r"<!-- the tests run it -->\n```python\n(.*?)```", (ROOT / "docs/radio-api.md").read_text(), re.DOTALL
)
DEADLINE_S = 30.0


@contextlib.contextmanager
def process(*command):
    """A process whose lines are read with a deadline; gone at the end."""
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


@pytest.fixture
def lab():
    """Endpoint of an emulator with the stations s0, s1 and s2, 15 m apart from their circle's middle."""
    command = ("scripts/wifi_lab.py", "serve", "--stations", "3", "--port", "0")
    with process(sys.executable, *command) as server:
        endpoint, _, names = server.stdout.readline().strip().split(" ", 2)
        assert names == "s0, s1, s2"
        yield endpoint


def wait_for(radio, kind):
    """The next item of a kind."""
    for _ in range(100):
        for item in radio.receive(timeout_s=DEADLINE_S / 100):
            if isinstance(item, kind):
                return item
    pytest.fail(f"no {kind.__name__} within {DEADLINE_S} s")


def test_the_documentation_has_a_program_with_and_one_without_coflight():
    assert len(PROGRAMS) == 2
    assert all(len(program.splitlines()) <= 24 for program in PROGRAMS)
    assert "netsim" not in PROGRAMS[1]


def test_the_documentations_programs_are_stations(lab, tmp_path):
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
        said = first.stdout.readline()
        assert re.fullmatch(r"station 0: 2[4-8]\.\d\d m\n", said), said
        with process(sys.executable, str(scripts[1]), lab, "s2") as second:
            assert wait_for(radio, Delivery).payload == b"s2 is station 2"
            assert "s2 is station 2" in first.stdout.readline()
            assert "thank you" in second.stdout.readline()


def test_a_datagram_to_one_station_is_acknowledged_and_ranging_answers(lab):
    with Guest(lab, name="s0") as one, Guest(lab, name="s2") as other:
        seq = one.unicast(other.station, b"to you alone")
        assert wait_for(other, Delivery).payload == b"to you alone"
        sent = wait_for(one, Sent)
        assert (sent.seq, sent.status, sent.destination) == (seq, "acknowledged", 2)
        seq = other.request_ftm(peer=1)
        result = wait_for(other, FtmResult)
        assert (result.seq, result.status, result.peer) == (seq, "ok", 1)
        assert result.distance_m == pytest.approx(26.0, abs=1.0)
        assert other.now_us > 0


def test_who_is_no_guest_is_told_who_is(lab):
    with pytest.raises(RadioLost, match="no guest 'ground' on this channel; its guests: s0, s1, s2"):
        Guest(lab, name="ground")


def test_an_endpoint_without_a_radio_is_one_line():
    with contextlib.closing(Transport.listen("127.0.0.1", 0)) as nobody:
        with pytest.raises(RadioLost, match="no radio of this version answers there"):
            Guest(nobody.endpoint, name="s0")
        endpoint = nobody.endpoint
    with pytest.raises(TransportError, match="cannot connect to"):
        Guest(endpoint, name="s0")
