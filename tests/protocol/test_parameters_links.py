"""The parameter services over lossy links, with stations' retries. About 15 s."""

import pytest
from lossy import play
from parameter_dialogue import bits, expected, set_message
from pymavlink.dialects.v20 import common

from autopilot.parameters.table import ROW_INDEX_OF, ROWS, ParameterSet, Settings
from autopilot.services.parameter import ParameterService, value_bytes
from autopilot.services.service import NEVER_US

SEEDS = 200
LINK = {"loss": 0.05, "duplication": 0.05, "delays_us": (0, 100_000)}
MS = 1_000


class Reader:
    """Reads all parameters as a station does: the list, and then the missing ones by index."""

    def __init__(self, *, batch, silence_us):
        self.values = {}
        self.count = 0
        self.done = False
        self.requests = 0
        self._batch, self._silence_us = batch, silence_us
        self._due_us = 0
        self._waiting_for = None

    def on_message(self, message, now_us):
        if message.get_msgId() != common.MAVLINK_MSG_ID_PARAM_VALUE or message.param_index == 65_535:
            return ()
        self.count = message.param_count
        self.values[message.param_index] = message.param_id, bits(message)
        self.done = len(self.values) == self.count
        self._due_us = NEVER_US if self.done else now_us + self._silence_us
        if not self.done and message.param_index == self._waiting_for:
            return self._ask_for_missing()
        return ()

    def on_timer(self, now_us):
        self._due_us = now_us + self._silence_us
        if not self.count:
            self.requests += 1
            return [common.MAVLink_param_request_list_message(1, 1)]
        return self._ask_for_missing()

    def next_deadline_us(self):
        return self._due_us

    def _ask_for_missing(self):
        missing = [index for index in range(self.count) if index not in self.values][: self._batch]
        self._waiting_for = missing[-1]
        self.requests += len(missing)
        return [common.MAVLink_param_request_read_message(1, 1, b"", index) for index in missing]


def mavsdk():
    """Ten at a time, half a second after the last value or on receipt of the tenth."""
    return Reader(batch=10, silence_us=500 * MS)


def qgroundcontrol():
    """Ten at a time, three seconds after the last value."""
    return Reader(batch=10, silence_us=3_000 * MS)


def mavproxy():
    """One at a time, a second after the last value."""
    return Reader(batch=1, silence_us=1_000 * MS)


STATIONS = [mavsdk, qgroundcontrol, mavproxy]


@pytest.mark.parametrize("make", STATIONS)
def test_all_parameters_arrive_and_are_equal_over_a_lossy_link(make):
    parameters = ParameterSet(
        Settings(), {"MPC_XY_P": 1.0 / 3.0, "SENS_BOARD_Z_OFF": -0.1, "COM_FLTMODE1": 8}
    )
    values = expected(parameters)
    lost = 0
    for seed in range(SEEDS):
        station = make()
        service = ParameterService(parameters)
        outcome = play(service, station, seed=seed, **LINK)
        assert station.done, seed
        assert station.values == values, seed
        lost += outcome.lost
    assert lost > SEEDS  # the link was lossy


def test_three_stations_are_served_concurrently():
    parameters = ParameterSet(Settings())
    stations = [make() for make in STATIONS]
    play(ParameterService(parameters), *stations, seed=1, packed=True, **LINK)
    for station in stations:
        assert {index: name for index, (name, _) in station.values.items()} == {
            index: row.name for index, row in enumerate(ROWS)
        }


class Writer:
    """Sets parameters one after the other as MAVSDK does: repeated after half a second until the echo."""

    def __init__(self, values):
        self._left = list(values.items())
        self._due_us = 0

    @property
    def done(self):
        return not self._left

    def on_message(self, message, now_us):
        name, value = self._left[0] if self._left else ("", 0.0)
        row = ROWS[ROW_INDEX_OF[name]] if name else None
        if row and message.get_type() == "PARAM_VALUE" and message.param_id == name:
            if bits(message) == value_bytes(row.is_integer, value):
                self._left.pop(0)
            return self.on_timer(now_us) if self._left else ()
        return ()

    def on_timer(self, now_us):
        self._due_us = now_us + 500 * MS
        name, value = self._left[0]
        return [set_message(name, value)]

    def next_deadline_us(self):
        return self._due_us if self._left else NEVER_US


def test_values_written_over_a_lossy_link_are_stored():
    values = {row.name: row.minimum for row in ROWS if row.name.startswith(("MC_ROLL", "RC_MAP", "COM_FLT"))}
    values = {name: round(value * 64) / 64 for name, value in values.items()}  # exact in float32
    for seed in range(SEEDS):
        parameters = ParameterSet(Settings())
        station = Writer(values)
        play(ParameterService(parameters), station, seed=seed, **LINK)
        assert station.done
        assert {name: parameters.get(name) for name in values} == pytest.approx(values)
