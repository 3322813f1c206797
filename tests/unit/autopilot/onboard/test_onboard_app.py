"""Flights of the application, alone or in pairs, with a scripted autopilot."""

import numpy as np
import pytest
from beacons import Beacon, encode
from onboard_apps import formation_app
from onboard_world import (
    ALONE,
    MODE_LAND,
    MODE_LOITER,
    MODE_OFFBOARD,
    PAIR,
    SITE,
    STEP_US,
    Errors,
    phase_is,
    world,
)
from pymavlink.dialects.v20 import common

from autopilot.mavlink.modes import FlightMode
from autopilot.onboard.client.commands import CommandSender
from autopilot.onboard.client.own_state import OwnState
from autopilot.onboard.formation import messages
from autopilot.onboard.formation.flight_phases import FlightSequence, Situation
from autopilot.onboard.formation.formation_control import COAST_S
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.parameters.config import Devices
from autopilot.parameters.onboard_config import OnboardConfig
from autopilot.parameters.table import ParameterSet, Settings
from autopilot.services.parameter import ParameterService
from autopilot.services.service import APPLICATION_PARTNER
from netsim.wire.messages import Broadcast, Delivery, FtmRequest

GPS = OnboardConfig(localisation="gps")


def beacon_of(station, time_us):
    """Return the bytes of an empty beacon."""
    zero = (0.0, 0.0, 0.0)
    beacon = Beacon(
        station=station,
        seq=0,
        time_us=time_us,
        phase=FlightPhase.WAITING,
        odometry_ned_m=zero,
        vel_ned_m_s=zero,
    )
    return encode(beacon)


def test_timeline_of_a_flight():
    w = world()
    w.run_until(phase_is(FlightPhase.LOCALISING), limit_s=1.5)
    # a pair is complete with one distance each way, requested within one period
    w.run_until(phase_is(FlightPhase.TAKE_OFF), limit_s=2.0)
    w.run_until(phase_is(FlightPhase.JOINING), limit_s=3.0)
    assert all(-1.2 < z < -0.4 for z in w.pos[:, 2])  # handed over while still climbing
    # 6.8 m at 1.5 m/s with 0.8 m/s^2 at the end, then 2 s of holding
    w.run_until(phase_is(FlightPhase.ON_STATION), limit_s=6.8 / 1.5 + 2.0 + 4.0)
    for autopilot in w.autopilots:  # as by a ground station
        autopilot.mode = MODE_LAND
    w.run_until(phase_is(FlightPhase.YIELDED), limit_s=1.1)
    w.run_until(phase_is(FlightPhase.LANDED), limit_s=8.0 / 0.7 + 5.0)
    for autopilot in w.autopilots:
        numbers = list(dict.fromkeys(number for _, number, _ in autopilot.commands))
        assert numbers == [
            common.MAV_CMD_COMPONENT_ARM_DISARM,
            common.MAV_CMD_NAV_TAKEOFF,
            common.MAV_CMD_DO_SET_MODE,
        ]


def test_with_gps_alone_there_are_no_localising_no_requests_and_no_correction():
    w = world(config=GPS)
    w.run_until(phase_is(FlightPhase.ON_STATION), limit_s=20.0)
    assert w.sent[FtmRequest] == 0
    assert w.sent[Broadcast] > 0
    assert not any(any(app.estimate(w.now_us).correction_ned_m[:2]) for app in w.apps)


def test_a_lone_uav_flies():
    w = world(ALONE)
    w.run_until(phase_is(FlightPhase.ON_STATION), limit_s=20.0)
    assert w.sent[FtmRequest] == 0


def test_a_refused_command_is_repeated_every_second():
    w = world(ALONE)
    w.autopilots[0].refuse = {common.MAV_CMD_COMPONENT_ARM_DISARM: 3}
    w.run_until(phase_is(FlightPhase.TAKE_OFF), limit_s=8.0)
    arm_us = [now_us for now_us, number, _ in w.autopilots[0].commands if number == 400]
    assert np.diff(arm_us).tolist() == [1_000_000] * 3


def test_an_unanswered_command_is_repeated_with_its_confirmation_raised():
    app = formation_app(
        station=0, places_ned_m=ALONE, site=SITE, config=GPS, devices=Devices(), rng=np.random.default_rng(1)
    )
    sent = []
    for step in range(1, 1_000):
        now_us = step * STEP_US
        if step == 1:
            lat, lon = round(SITE.latitude_deg * 1e7), round(SITE.longitude_deg * 1e7)
            app.on_mavlink(common.MAVLink_local_position_ned_message(0, 0, 0, 0, 0, 0, 0), now_us)
            app.on_mavlink(common.MAVLink_gps_global_origin_message(lat, lon, 488_000), now_us)
            fix = common.MAVLink_gps_raw_int_message(200_000, 3, lat, lon, 488_000, 150, 250, 0, 0, 10)
            app.on_mavlink(fix, now_us)
        sent += [(now_us, m) for m in app.on_timer(now_us).mavlink if m.get_type() == "COMMAND_LONG"]
    assert [m.confirmation for _, m in sent[:4]] == [0, 1, 2, 3]
    assert np.diff([now_us for now_us, _ in sent]).tolist() == [500_000] * (len(sent) - 1)


def test_another_mode_is_respected_until_offboard_is_selected_again():
    w = world(ALONE)
    w.run_until(phase_is(FlightPhase.ON_STATION), limit_s=20.0)
    w.run(1.5)
    w.autopilots[0].mode = MODE_LOITER
    w.run_until(phase_is(FlightPhase.YIELDED), limit_s=1.5)
    commands = len(w.autopilots[0].commands)
    w.run(3.0)
    assert len(w.autopilots[0].commands) == commands
    w.autopilots[0].mode = MODE_OFFBOARD
    w.run_until(phase_is(FlightPhase.JOINING), limit_s=1.5)
    w.run_until(phase_is(FlightPhase.ON_STATION), limit_s=5.0)


def joining():
    """Return a flight in phase JOINING and offboard mode, and its state."""
    commands = CommandSender(target_system=1)
    flight = FlightSequence(
        commands=commands, on_station_tolerance_m=0.7, on_station_hold_s=2.0, held=False,
        shortfall=lambda _: "",
    )  # fmt: skip
    flight.phase = FlightPhase.JOINING
    own = OwnState(site=SITE, gps_delay_s=0.12)
    own.armed, own.mode = True, FlightMode.OFFBOARD
    return flight, own


def test_after_yielding_the_hold_time_restarts():
    """A minute at its place in another mode does not count."""
    flight, own = joining()
    there, since_us = Situation(shape_std_m=0.1, miss_m=0.1, place_height_m=8.0), {}
    for now_us in range(0, 70_000_000, 50_000):
        own.mode = FlightMode.HOLD if 3_000_000 <= now_us < 63_000_000 else FlightMode.OFFBOARD
        flight.update(own, there, now_us)
        since_us.setdefault((flight.phase, now_us >= 63_000_000), now_us)
    assert since_us == {
        (FlightPhase.JOINING, False): 0,
        (FlightPhase.ON_STATION, False): 2_000_000,
        (FlightPhase.YIELDED, False): 3_000_000,
        (FlightPhase.JOINING, True): 63_000_000,
        (FlightPhase.ON_STATION, True): 63_050_000 + 2_000_000,
    }


@pytest.mark.parametrize(("miss_m", "phase"), [(0.1, FlightPhase.ON_STATION), (np.nan, FlightPhase.JOINING)])
def test_a_nan_distance_is_never_on_station(miss_m, phase):
    flight, own = joining()
    for now_us in range(0, 10_000_000, 50_000):
        flight.update(own, Situation(shape_std_m=0.1, miss_m=miss_m, place_height_m=8.0), now_us)
    assert flight.phase is phase


ALONE_AND_READY = Situation(shape_std_m=0.0, miss_m=8.0, place_height_m=8.0)


def position(own, now_us, *, down_m, vel_down_m_s=0.0):
    own.on_local_position(
        common.MAVLink_local_position_ned_message(now_us // 1_000, 0.0, 0.0, down_m, 0.0, 0.0, vel_down_m_s),
        now_us,
    )


def status(*, ready):
    health = common.MAV_SYS_STATUS_PREARM_CHECK if ready else 0
    return common.MAVLink_sys_status_message(0, 0, health, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize(("ready_s", "armed_s"), [(None, 0.0), (4.0, 4.0), (60.0, 20.0)])
def test_arming_waits_for_the_autopilots_checks_if_it_reports_them(ready_s, armed_s):
    flight, own = joining()
    flight.phase = FlightPhase.ARMING
    begun_us = None
    for now_us in range(0, 30_000_000, 100_000):
        if ready_s is not None:
            own.on_status(status(ready=now_us >= ready_s * 1e6))
        flight.update(own, ALONE_AND_READY, now_us)
        if begun_us is None and flight._commands.next_deadline_us() <= now_us:
            begun_us = now_us
    assert begun_us == pytest.approx(armed_s * 1e6, abs=100_000)


def take_off(*, drift_m_s, mode_after):
    """Return the time of the hand-over, s, and the altitudes commanded by a flight from its arming on.

    The autopilot's height drifts up by ``drift_m_s``. It lifts off after 4 s, climbs at 1 m/s to the altitude
    of the command in its own frame, and then selects ``mode_after``.
    """
    flight, own = joining()
    flight.phase, own.mode, own.heartbeat_us = FlightPhase.ARMING, FlightMode.HOLD, 0
    own.origin_alt_m = SITE.altitude_m
    own._standing = True
    height_m, climb_m_s, altitudes_m = 0.0, 0.0, set()
    for now_us in range(0, 30_000_000, 40_000):
        now_s = now_us * 1e-6
        position(own, now_us, down_m=-height_m - drift_m_s * now_s, vel_down_m_s=-drift_m_s - climb_m_s)
        altitude_m = 488.0 + height_m + 1e-3 * np.sin(now_us)
        own.on_altitude(common.MAVLink_altitude_message(now_us, altitude_m, 0.0, 0.0, 0.0, 0.0, 0.0))
        flight.update(own, ALONE_AND_READY, now_us)
        for command in flight._commands.on_timer(now_us):
            if command.command == common.MAV_CMD_NAV_TAKEOFF:
                altitudes_m.add(round(command.param7 - SITE.altitude_m, 3))
                own.mode = FlightMode.TAKEOFF
            flight._commands.on_ack(common.MAVLink_command_ack_message(command.command, 0), now_us)
        if flight.phase is FlightPhase.JOINING:
            return now_s, altitudes_m
        if own.mode is FlightMode.TAKEOFF and now_s >= 4.0:
            if height_m + drift_m_s * now_s < max(altitudes_m):
                climb_m_s = 1.0
                height_m += 0.04
            else:
                climb_m_s, own.mode = 0.0, mode_after
    return None, altitudes_m


def test_the_application_takes_over_in_the_climb():
    taken_over_s, altitudes_m = take_off(drift_m_s=0.0, mode_after=FlightMode.HOLD)
    assert taken_over_s == pytest.approx(4.0 + 0.5, abs=0.25)
    assert altitudes_m == {2.5}


def test_the_application_takes_over_where_a_drifting_autopilot_ends_its_take_off():
    """Its height has drifted by 2.4 m when it lifts off: it ends below the height of the hand-over."""
    taken_over_s, altitudes_m = take_off(drift_m_s=0.6, mode_after=FlightMode.HOLD)
    assert taken_over_s == pytest.approx(4.2, abs=0.3)
    assert len(altitudes_m) == 1  # the command is not changed while it is carried out


def test_another_mode_in_the_take_off_is_not_taken_over_on_the_ground():
    taken_over_s, _ = take_off(drift_m_s=0.6, mode_after=FlightMode.LAND)
    assert taken_over_s is None


def test_without_distances_it_takes_off_after_the_timeout_with_a_message():
    w = world(errors=Errors(radio_loss=1.0))
    w.run_until(phase_is(FlightPhase.LOCALISING), limit_s=1.5)
    began_us = w.now_us
    w.run_until(phase_is(FlightPhase.ARMING), limit_s=10.2)
    assert w.now_us - began_us == pytest.approx(10_000_000, abs=200_000)
    w.run_until(phase_is(FlightPhase.ON_STATION), limit_s=20.0)
    for app, autopilot in zip(w.apps, w.autopilots, strict=True):
        assert not any(app.estimate(w.now_us).correction_ned_m[:2])
        ((_, text),) = autopilot.texts
        assert text.startswith("formation not localised in 10 s: beacons of 0 of 1 other UAVs received; ")


def test_a_line_takes_off_after_the_timeout_and_names_the_geometry():
    w = world(((0.0, -8.5, -8.0), (0.0, 0.0, -8.0), (0.0, 8.5, -8.0)))
    w.run_until(phase_is(FlightPhase.LOCALISING), limit_s=1.5)
    w.run_until(phase_is(FlightPhase.ARMING), limit_s=10.2)
    w.run(0.1)
    for autopilot in w.autopilots:
        ((_, text),) = autopilot.texts
        assert text.startswith("formation not localised in 10 s: ranging determines its shape to ")
        assert "(places within 0.0 m of a line)" in text


def test_uavs_that_answer_are_located_before_take_off_at_a_long_ranging_period():
    """All pairs in 6 s, one of three silent from the start: gathering ends before the time-out."""
    places = ((-3.0, 0.0, -8.0), (3.0, 0.0, -8.0), (0.0, 4.0, -8.0))
    w = world(places, config=OnboardConfig(ftm_period_s=6.0))
    w.dead.add(2)
    w.run_until(lambda w: all(app.phase is FlightPhase.TAKE_OFF for app in w.apps[:2]), limit_s=13.0)
    for app in w.apps[:2]:
        assert app.application.localisation.located.tolist() == [True, True, False]


@pytest.mark.parametrize("ranging", ["all_pairs", "scheduled"])
def test_neighbours_are_avoided_without_a_channel_while_odometry_is_valid(ranging):
    w = world(config=OnboardConfig(ranging=ranging))
    w.run_until(phase_is(FlightPhase.ON_STATION), limit_s=25.0)
    w.run(3.0)
    app, called_us, pushes_m_s = w.apps[0], [], []
    avoidance = app.application._guidance._avoidance
    original = avoidance.velocity_change_ne_m_s

    def spy(now_us, **kwargs):
        change = original(now_us, **kwargs)
        called_us.append(now_us)
        pushes_m_s.append(float(change[0]))
        return change

    avoidance.velocity_change_ne_m_s = spy
    cut_us, w.radio_cut = w.now_us, True
    w.run(4.0)
    assert not any(pushes_m_s)
    for _ in range(150):  # a push beyond the other's last reported position: 9 m in 4.5 s
        w.vel[0] = (2.0, 0.0, 0.0)
        w.run(0.03)
    assert max(pushes_m_s) > 0.5  # the other one blocks the way back, to the south
    w.run(20.0)
    assert np.diff(called_us).max() <= 50_000 + STEP_US
    # Support lasts for the policy's silence after the last distance, of which one may be lost.
    silence_us = app.application._traffic.ranging.silence_us
    coasted_us = called_us[-1] - cut_us - round(COAST_S * 1e6)
    assert 0.5 * silence_us < coasted_us <= silence_us + 100_000


def test_the_position_loops_gain_is_requested_and_used():
    """1.5 1/s instead of 0.95, from the autopilot's own parameter service."""
    w = world()
    app = w.apps[0]
    w.run_until(phase_is(FlightPhase.ON_STATION), limit_s=25.0)
    parameters = ParameterSet(Settings())
    service = ParameterService(parameters)
    reference, own = app.application._guidance._reference, app.application._own
    avoidance = app.application._guidance._avoidance
    original = avoidance.velocity_change_ne_m_s
    found = []

    def spy(now_us, *, desired_ne_m_s, **kwargs):
        way_ne_m = (reference.pos_ned_m - app.application._guidance.believed_ned_m(own, now_us))[:2]
        found.append((desired_ne_m_s - reference.vel_ned_m_s[:2], way_ne_m))
        return original(now_us, desired_ne_m_s=desired_ne_m_s, **kwargs)

    avoidance.velocity_change_ne_m_s = spy
    for gain_1_s in (0.95, 1.5):
        parameters.set("MPC_XY_P", gain_1_s)
        for _, answer in service.on_message(
            messages.gain_requests(("MPC_XY_P",), 1)[0], w.now_us, APPLICATION_PARTNER
        ):
            app.on_mavlink(answer, w.now_us)
        w.run(0.5)
        desired, way = np.array(found).transpose(1, 0, 2)
        found.clear()
        assert np.abs(way).max() > 0.0
        assert desired == pytest.approx(gain_1_s * way)
    app.on_mavlink(common.MAVLink_param_value_message(b"MPC_XY_P", np.nan, 9, 1, 0), w.now_us)
    assert app.application._guidance.position_gain_1_s == 1.5


def test_odometry_restarts_after_a_telemetry_gap():
    """4 m in 3 s without LOCAL_POSITION_NED, as with an invalid position: earlier odometry is discarded."""
    w = world()
    w.run_until(phase_is(FlightPhase.ON_STATION), limit_s=25.0)
    telemetry = w._telemetry
    w._telemetry = lambda i, step: [
        msg for msg in telemetry(i, step) if i or msg.get_type() != "LOCAL_POSITION_NED"
    ]
    w.run(1.5)
    w.pos[0, :2] += (4.0, 0.0)
    w.run(1.5)
    w._telemetry = telemetry
    believed = {app: app.application.localisation for app in w.apps}
    while w.apps[0].application._own.time_us < w.now_us - 100_000:
        w._step()
    for _ in range(60):  # 6 s: two ranging rounds
        w.run(0.1)
        true_m = np.linalg.norm(w.pos[1, :2] - w.pos[0, :2])
        for app, localisation in believed.items():
            others = localisation.others(w.now_us, fresh_us=1_000_000)
            if others["fresh"].all():
                pos_ned_m = others["pos_ned_m"]
                error_m = np.linalg.norm(pos_ned_m[1, :2] - pos_ned_m[0, :2]) - true_m
                assert abs(error_m) < 4.0 * others["std_m"].max() + 0.1, app.application._station
    assert all(localisation.located.all() for localisation in believed.values())


def test_the_own_gps_may_be_newer_than_the_odometry():
    """A receiver without delay: its message arrives before the position of its time."""
    app = formation_app(
        station=0, places_ned_m=PAIR, site=SITE, config=OnboardConfig(),
        devices=Devices(gps_delay_s=0.0), rng=np.random.default_rng(1),
    )  # fmt: skip
    lat, lon = round(SITE.latitude_deg * 1e7), round(SITE.longitude_deg * 1e7)
    for k in range(1, 31):
        now_us = k * 32_000
        if k % 6 == 0:
            early_us = now_us - 4_000
            fix = common.MAVLink_gps_raw_int_message(early_us, 3, lat, lon, 488_000, 150, 250, 0, 0, 10)
            app.on_mavlink(fix, early_us)
            assert app.application.localisation.members["fix_us"][0] < early_us - 1_000  # not yet
        app.on_mavlink(common.MAVLink_local_position_ned_message(now_us // 1_000, 0, 0, 0, 0, 0, 0), now_us)
        if k % 6 == 0:
            assert early_us - 1_000 < app.application.localisation.members["fix_us"][0] <= early_us


def test_the_estimate_is_extrapolated_to_now():
    """At 10 m/s the newest position, 20 ms old, is 0.2 m behind; the extrapolation is limited to 50 ms."""
    app = formation_app(
        station=0, places_ned_m=ALONE, site=SITE, config=GPS, devices=Devices(), rng=np.random.default_rng(1)
    )
    app.on_mavlink(common.MAVLink_local_position_ned_message(4, 1, 2, -3, 10, 0, -1), 4_000)
    for now_us, ahead_s in ((4_000, 0.0), (24_000, 0.020), (54_000, 0.050), (400_000, 0.050)):
        expected_ned_m = (1.0 + 10.0 * ahead_s, 2.0, -3.0 - ahead_s)
        assert app.estimate(now_us).pos_ned_m == pytest.approx(expected_ned_m, abs=1e-9)


def test_the_estimate_from_the_truth_has_its_standard_deviation():
    truth = OnboardConfig(localisation="truth")
    app = formation_app(
        station=0,
        places_ned_m=ALONE,
        site=SITE,
        config=truth,
        devices=Devices(),
        rng=np.random.default_rng(1),
    )
    assert app.estimate(0).std_ned_m[0] == truth.gps_bias_std_m
    lat, lon = round(SITE.latitude_deg * 1e7), round(SITE.longitude_deg * 1e7)
    alt_mm = round(SITE.altitude_m * 1e3)
    truth_message = common.MAVLink_hil_state_quaternion_message(
        4_000, (1.0, 0.0, 0.0, 0.0), 0, 0, 0, lat, lon, alt_mm, 0, 0, 0, 0, 0, 0, 0, 0
    )
    app.on_mavlink(truth_message, 4_000)
    # 1e-7 degrees are 11 mm
    assert app.estimate(4_000).std_ned_m == (0.01, 0.01, 0.01)


def test_loss_and_return_of_ranging_are_each_reported_once():
    w = world()
    w.run_until(phase_is(FlightPhase.ON_STATION), limit_s=25.0)
    w.radio_cut = True
    w.run(8.0)
    lost = [text for _, text in w.autopilots[0].texts]
    assert lost == ["ranging lost: correction frozen, then fading"]
    w.radio_cut = False
    w.run(4.0)
    assert [text for _, text in w.autopilots[0].texts] == [*lost, "ranging is back"]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda _: b"",
        lambda _: b"\xff" * 128,
        lambda now_us: beacon_of(0, now_us),
        lambda now_us: beacon_of(200, now_us),
        lambda _: beacon_of(1, 2**62),
    ],
    ids=["empty", "noise", "own number", "no such station", "from the future"],
)
def test_an_invalid_datagram_is_counted_and_changes_nothing(spoil):
    w = world()
    w.run(2.0)
    app = w.apps[0]
    state, cov = app.application.localisation.state.copy(), app.application.localisation.cov.copy()
    delivery = Delivery(source=1, seq=0, received_ns=0, rssi_dbm=-60.0, payload=spoil(w.now_us))
    app.on_radio([delivery], w.now_us)
    assert app.troubles()["bad_beacons"] == 1
    assert np.array_equal(app.application.localisation.state, state)
    assert np.array_equal(app.application.localisation.cov, cov)


def test_the_boot_time_of_the_autopilot_has_no_effect():
    tracks = []
    for offset_us in (0, 1_000, -60_000_000):
        w = world(seed=4, boot_offset_us=offset_us)
        w.run(6.0)
        tracks.append(w.flown()[1])
    assert np.array_equal(tracks[0], tracks[1])
    assert np.array_equal(tracks[0], tracks[2])


def test_flights_with_the_same_seed_are_equal():
    flights = []
    for seed in (3, 3, 4):
        w = world(seed=seed)
        w.run(6.0)
        flights.append((w.flown()[0], w.flown()[1]))
    assert np.array_equal(flights[0][0], flights[1][0])
    assert np.array_equal(flights[0][1], flights[1][1])
    assert not np.array_equal(flights[0][1], flights[2][1])
