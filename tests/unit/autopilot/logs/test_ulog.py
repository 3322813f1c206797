"""The ULog that a host writes for stations, parsed by the format's description. About 10 s."""

import contextlib
import struct

import msgspec
import numpy as np
import pytest
from pymavlink.dialects.v20 import common
from vehicle_world import STEP_US, Flight, vehicle_config

from autopilot.logs.ulog import NAV_STATES, TOPICS, UlogWriter
from autopilot.mavlink.codec import Encoder
from autopilot.mavlink.modes import FlightMode
from autopilot.parameters.table import ROWS
from autopilot.services.service import GROUND_STATION, Addressed, Partner
from autopilot.vehicle.host import Host

SAMPLE_US = 100_000
_CODES = {"uint64_t": "Q", "double": "d", "float": "f", "uint8_t": "B", "bool": "?", "int32_t": "i"}


class Read:
    """Contents of a log, by https://docs.px4.io/main/en/dev_log/ulog_file_format.html."""

    def __init__(self, data):
        assert data[:7] == b"ULog\x01\x12\x35"
        self.begin_us = struct.unpack_from("<Q", data, 8)[0]
        self.formats, self.topics, self.samples = {}, {}, {}
        self.parameters, self.changes, self.texts, self.about = {}, [], [], {}
        at, in_data = 16, False
        while at < len(data):
            size, kind = struct.unpack_from("<Hc", data, at)
            content = data[at + 3 : at + 3 + size]
            assert len(content) == size
            at += 3 + size
            in_data |= kind in b"ADL"
            assert kind not in b"BFI" or not in_data
            getattr(self, f"on_{kind.decode()}")(content, in_data)

    def on_B(self, content, _):  # noqa: N802  # the format's letters
        assert content == bytes(40)  # no incompatibility flags

    def on_F(self, content, _):  # noqa: N802
        name, _, fields = content.decode().partition(":")
        self.formats[name] = [field.split(" ") for field in fields.rstrip(";").split(";")]

    def keyed(self, content):
        kind, _, name = content[1 : 1 + content[0]].decode().partition(" ")
        return kind, name, content[1 + content[0] :]

    def on_I(self, content, _):  # noqa: N802
        kind, name, value = self.keyed(content)
        assert kind == f"char[{len(value)}]"
        self.about[name] = value.decode()

    def on_P(self, content, in_data):  # noqa: N802
        kind, name, value = self.keyed(content)
        self.parameters[name] = struct.unpack(f"<{_CODES[kind]}", value)[0]
        if in_data:
            self.changes.append(name)

    def on_A(self, content, _):  # noqa: N802
        multi_id, number = struct.unpack_from("<BH", content)
        assert multi_id == 0
        self.topics[number] = content[3:].decode()
        self.samples[self.topics[number]] = []

    def on_D(self, content, _):  # noqa: N802
        name = self.topics[struct.unpack_from("<H", content)[0]]
        at, sample = 2, {}
        for kind, field in self.formats[name]:
            base, _, length = kind.rstrip("]").partition("[")
            layout = struct.Struct(f"<{length}{_CODES[base]}")
            values = layout.unpack_from(content, at)
            sample[field] = values if length else values[0]
            at += layout.size
        assert at == len(content)
        self.samples[name].append(sample)

    def on_L(self, content, _):  # noqa: N802
        level, time_us = struct.unpack_from("<BQ", content)
        self.texts.append((level - ord("0"), time_us, content[9:].decode()))


@pytest.fixture(scope="module")
def flown():
    """Log of twenty seconds: waiting, take-off, hover; with a parameter that is changed in flight."""
    with Flight(vehicle_config()) as flight:
        writer = UlogWriter("uav 0", flight.vehicle.parameters)
        data, truth, armed_us = writer.begin(0), [], None
        while flight.now_s < 20.0:
            flight.step()
            now_us = flight.vehicle.flight.now_us
            if now_us % SAMPLE_US == 0:
                data += writer.samples(flight.vehicle)
                state = flight.vehicle.flight.state
                truth.append((now_us, *state.pos_ned_m, flight.vehicle.commander.armed))
            if armed_us is None and flight.now_s > 9.0 and not flight.vehicle.commander.arming_refusals():
                flight.command(common.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
                flight.command(common.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, *[float("nan")] * 4)
                armed_us = now_us
            if now_us == 12_000_000:
                flight.vehicle.parameters.set("MPC_XY_P", 1.25)
        return Read(data), truth, flight.vehicle


def test_every_topic_has_samples_ten_times_a_second_once_it_has_data(flown):
    log, truth, _ = flown
    assert set(log.samples) == {topic.name for topic in TOPICS}
    for name, samples in log.samples.items():
        times = [sample["timestamp"] for sample in samples]
        assert times == list(range(times[0], times[-1] + 1, SAMPLE_US)), name
        assert times[-1] == truth[-1][0]
        assert len(times) > 50, name


def test_the_samples_are_the_vehicles_estimates(flown):
    log, truth, vehicle = flown
    estimated = {row[0]: row[1:4] for row in truth}
    for sample in log.samples["vehicle_local_position"]:
        position = [sample[axis] for axis in ("x", "y", "z")]
        np.testing.assert_allclose(position, estimated[sample["timestamp"]], rtol=1e-6, atol=1e-6)
    last = log.samples["vehicle_global_position"][-1]
    site = vehicle.config.site
    assert abs(last["lat"] - site.latitude_deg) < 1e-4
    assert abs(last["lon"] - site.longitude_deg) < 1e-4
    for sample in log.samples["vehicle_attitude"]:
        assert sum(part**2 for part in sample["q"]) == pytest.approx(1.0, abs=1e-5)
    assert log.samples["battery_status"][-1]["voltage_v"] == pytest.approx(
        vehicle.flight.battery.voltage_v, rel=1e-6
    )


def test_arming_and_modes_have_px4s_numbers(flown):
    log, truth, vehicle = flown
    armed = {row[0]: row[4] for row in truth}
    states = log.samples["vehicle_status"]
    assert [sample["arming_state"] == 2 for sample in states] == [armed[s["timestamp"]] for s in states]
    assert True in armed.values()
    assert NAV_STATES[FlightMode.TAKEOFF] in {sample["nav_state"] for sample in states}
    assert states[-1]["nav_state"] == NAV_STATES[vehicle.commander.mode]
    assert set(NAV_STATES) >= set(FlightMode) - {FlightMode.__members__.get("ORBIT")}


def test_the_log_has_all_parameters_and_one_change(flown):
    log, _, vehicle = flown
    assert list(log.parameters) == [row.name for row in ROWS]
    for row in ROWS:
        assert log.parameters[row.name] == pytest.approx(vehicle.parameters.get(row.name), rel=1e-6)
    assert log.changes == ["MPC_XY_P"]


# ---- the host


SIMULATOR = Encoder(system=0, component=1)


def sensor(time_us):
    at_rest = (0.0, 0.0, -9.81, 0.0, 0.0, 0.0, 0.2, 0.0, 0.4, 1013.25, 0.0, 0.0, 15.0)
    return SIMULATOR.encode(common.MAVLink_hil_sensor_message(time_us, *at_rest, 0x1FFF, 0))


def run(host, begin_us, end_us, *station_messages, active=(True, False)):
    out = []
    for now_us in range(begin_us, end_us, STEP_US):
        for messages in host.push(host.put(sensor(now_us))):
            links = [Addressed(Partner(GROUND_STATION, 0), message) for message in station_messages]
            station_messages = ()
            out += host.step(messages, link_messages=links, link_active=active)[1]
    return [message for _, message in out]


@pytest.fixture
def config(tmp_path):
    return msgspec.structs.replace(vehicle_config(), params_path=str(tmp_path / "uav-0.params"))


LIST = common.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF)


def test_without_a_station_there_is_no_log(config, tmp_path):
    with contextlib.closing(Host(config, None)) as host:
        run(host, 4_000, 400_000)
    assert list(tmp_path.iterdir()) == []


def test_a_message_from_a_station_starts_a_log_that_can_be_read_while_written(config, tmp_path):
    refused = common.MAVLink_command_long_message(
        1, 1, common.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1.0, *[0.0] * 6
    )
    with contextlib.closing(Host(config, None)) as host:
        run(host, 4_000, 200_000)
        texts = run(host, 200_000, 2_000_000, common.MAVLink_system_time_message(0, 0), refused)
        (entry,) = [m for m in run(host, 2_000_000, 2_004_000, LIST) if m.get_type() == "LOG_ENTRY"]
        assert entry.num_logs == 1
        ask = common.MAVLink_log_request_data_message(1, 1, 0, 0, entry.size)
        pieces = [m for m in run(host, 2_004_000, 4_000_000, ask) if m.get_type() == "LOG_DATA"]
        downloaded = b"".join(bytes(piece.data[: piece.count]) for piece in pieces)
        file = host.vehicle.messaging.files.open("/fs/microsd/log/uav-0.ulg")
        assert file.read(0, entry.size) == downloaded
    whole = (tmp_path / "uav-0.ulg").read_bytes()
    assert whole[: entry.size] == downloaded
    log = Read(whole)
    assert log.begin_us == 200_000
    sent = [
        m.text if isinstance(m.text, str) else m.text.decode() for m in texts if m.get_type() == "STATUSTEXT"
    ]
    assert [text for _, _, text in log.texts] == list(dict.fromkeys(sent))  # the texts are sent on both links
    assert any("denied" in text.lower() for text in sent)
    times = [sample["timestamp"] for sample in log.samples["vehicle_status"]]
    assert times == list(range(200_000, 4_000_000, SAMPLE_US))


def test_without_listeners_and_disarmed_no_samples_are_written(config):
    with contextlib.closing(Host(config, None)) as host:
        run(host, 4_000, 400_000, LIST)
        size = host.vehicle.messaging.files.logs[0].file.size()
        run(host, 400_000, 1_000_000, active=(False, False))
        assert host.vehicle.messaging.files.logs[0].file.size() == size
        run(host, 1_000_000, 1_400_000)
        assert host.vehicle.messaging.files.logs[0].file.size() > size


def test_a_log_that_cannot_be_opened_is_one_line_and_does_not_end_the_run(config, tmp_path, capsys):
    (tmp_path / "uav-0.ulg").mkdir()
    with contextlib.closing(Host(config, None)) as host:
        answers = run(host, 4_000, 100_000, LIST)
    assert [m.num_logs for m in answers if m.get_type() == "LOG_ENTRY"] == [0]
    assert capsys.readouterr().err.startswith("uav 0: no log: ")
