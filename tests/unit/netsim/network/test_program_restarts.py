"""When a program is started again, settings of programs, and the queue that wakes its reader."""

import select
import threading

import msgspec
import pytest

from foundation.processes.wakeable_queue import WakeableQueue
from netsim.network.interfaces import link_local_address
from netsim.network.messages import NetworkConfig, ProgramConfig, check
from netsim.network.programs import FIRST_DELAY_S, LONGEST_DELAY_S, STEADY_S, restart_delay_s


@pytest.mark.parametrize(
    ("restart", "returncode", "restarts"),
    [
        ("never", 1, False),
        ("on_failure", 0, False),
        ("on_failure", 1, True),
        ("on_failure", -9, True),
        ("always", 0, True),
    ],
)
def test_policy_depends_on_the_status(restart, returncode, restarts):
    assert (restart_delay_s(restart, returncode, 0.0, 0.0) is not None) == restarts


def test_delay_doubles_up_to_a_limit_and_begins_again():
    delay_s, delays_s = 0.0, []
    for _ in range(7):
        delay_s = restart_delay_s("always", 1, 0.1, delay_s)
        delays_s.append(delay_s)
    assert delays_s == [0.5, 1.0, 2.0, 4.0, 8.0, LONGEST_DELAY_S, LONGEST_DELAY_S]
    assert restart_delay_s("always", 1, STEADY_S, delay_s) == FIRST_DELAY_S


def config(**changes):
    program = ProgramConfig(
        **{"name": "true", "station": 1, "command": ("true",), "log_path": "log"} | changes
    )
    user = {"user": "u", "password": "p"}
    return NetworkConfig(run_id="r", endpoint="e", **user, stations=(0, 1), programs=(program,))


def test_settings_survive_their_file():
    settings = config(environment={"A": "b"}, restart="always", command=("sh", ""))
    check(settings)
    assert msgspec.json.decode(msgspec.json.encode(settings), type=NetworkConfig) == settings


@pytest.mark.parametrize("changes", [{"station": 2}, {"command": ("",)}, {"command": ("a", "b\0c")}])
def test_inconsistent_program_is_rejected_by_its_position(changes):
    with pytest.raises(ValueError, match=r"programs\[0\]"):
        check(config(**changes))


def test_station_has_one_interface():
    with pytest.raises(ValueError, match="stations"):
        check(msgspec.structs.replace(config(), stations=(1, 1)))


def test_link_local_address_has_the_modified_eui_64():
    assert str(link_local_address(0x1234)) == "fe80::ff:fe00:1234"


def test_queue_wakes_its_reader_and_keeps_the_order():
    inbox = WakeableQueue()
    threading.Thread(target=lambda: [inbox.put(i) for i in range(100)]).start()
    taken = []
    while len(taken) < 100:
        assert select.select([inbox], [], [], 10.0)[0]
        taken += inbox.take_all()
    assert taken == list(range(100))
    assert inbox.take_all() == []
    assert select.select([inbox], [], [], 0.0)[0] == []
