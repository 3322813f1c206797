"""Full steps and their causes: decisions, and the application's loop."""

from unittest.mock import Mock

import pytest
from msgspec.structs import replace
from pymavlink.dialects.v20 import common
from vehicle_world import STEP_US, Flight, vehicle_config

from autopilot.onboard.programs import OnboardOutput
from autopilot.services.service import NEVER_US
from autopilot.vehicle.vehicle import DECISION_PERIOD_US, Vehicle
from netsim.wire.messages import Broadcast, Delivery

NO_LINKS = (False, False)


def sensor(time_us):
    return common.MAVLink_hil_sensor_message(
        time_us, 0.0, 0.0, -9.81, 0.0, 0.0, 0.0, 0.2, 0.0, 0.4, 955.98, 0.0, 488.0, 15.0, 0x1FFF, 0
    )


def vehicle_of(loop_period_ms):
    config = vehicle_config(onboard=True)
    return Vehicle(replace(config, onboard=replace(config.onboard, loop_period_ms=loop_period_ms)))


@pytest.mark.parametrize("loop_period_ms", [4, 12, 20, 40])
def test_the_application_runs_only_at_the_multiples_of_its_period(loop_period_ms):
    vehicle, loop_times_us = vehicle_of(loop_period_ms), []

    def on_timer(now_us):
        loop_times_us.append(now_us)
        return OnboardOutput((), (Broadcast(seq=len(loop_times_us), at_us=now_us, payload=b""),))

    vehicle.app.on_timer = on_timer
    sent_us = [
        time_us
        for time_us in range(STEP_US, 200_000, STEP_US)
        if vehicle.step(sim_messages=[sensor(time_us)], link_active=NO_LINKS).radio
    ]
    period_us = 1_000 * loop_period_ms
    assert loop_times_us == sent_us == list(range(period_us, 200_000, period_us))


def test_a_simulator_with_other_step_times_runs_it_as_often():
    """Its steps are at no multiple of 20 ms; the first one after each multiple runs the loop."""
    vehicle = vehicle_of(20)
    vehicle.app.on_timer = Mock(return_value=OnboardOutput((), ()))
    for time_us in range(1_001_000, 1_201_000, STEP_US):
        vehicle.step(sim_messages=[sensor(time_us)], link_active=NO_LINKS)
    loop_times_us = [call.args[0] for call in vehicle.app.on_timer.call_args_list]
    assert loop_times_us == list(range(1_021_000, 1_201_000, 20_000))


def test_radio_items_between_two_loops_are_not_lost():
    vehicle = vehicle_of(20)
    vehicle.app.on_radio = Mock()
    item = Delivery(source=1, seq=0, received_ns=5_000_000, rssi_dbm=-60.0, payload=b"")
    for time_us in (4_000, 8_000):
        vehicle.step(
            sim_messages=[sensor(time_us)], radio_items=[item] * (time_us == 8_000), link_active=NO_LINKS
        )
    vehicle.app.on_radio.assert_called_once_with([item], 8_000)


def test_steps_before_the_next_deadline_only_process_the_sample():
    """In flight with its application and without active links: nine steps of ten."""
    with Flight(vehicle_config(onboard=True)) as flight:
        flight.run(12.0)
        vehicle = flight.vehicle
        assert vehicle.commander.armed
        looked_us = []

        def watched(look):
            def watching(*arguments):
                looked_us.append(flight.now_us)
                return look(*arguments)

            return watching

        parts = (vehicle, "_update_inputs"), (vehicle, "_run_app"), (vehicle.messaging, "on_timer")
        for owner, name in parts:
            setattr(owner, name, watched(getattr(owner, name)))
        due_us = []
        for _ in range(500):
            if vehicle.fast_step_limits(NEVER_US).full_step_us <= flight.now_us + STEP_US:
                due_us.append(flight.now_us + STEP_US)
            flight.step()
        assert sorted(set(looked_us)) == due_us
        assert 50 <= len(due_us) <= 55  # 2 s at 25 Hz, and the samples after the application's commands


def test_without_an_application_only_decisions_are_due():
    vehicle = Vehicle(vehicle_config())
    vehicle.step(sim_messages=[sensor(STEP_US)], link_active=NO_LINKS)
    assert vehicle._loop_us == NEVER_US
    assert vehicle.fast_step_limits(NEVER_US).full_step_us <= DECISION_PERIOD_US
