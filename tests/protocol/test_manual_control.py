"""Sticks over MAVLink: decoding of MANUAL_CONTROL and channel overrides, and takeover."""

import pytest
from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Condition
from autopilot.commander.commander import Commander
from autopilot.commander.params import CommanderParams
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.mode_registry import mode_table
from autopilot.services.manual_control import ManualControlService
from autopilot.services.service import Partner

ALL = sum(Condition)
CLIENT, OTHER = Partner(0, 3), Partner(1, 3)


def sticks(*, x=0, y=0, z=500, r=0):
    return common.MAVLink_manual_control_message(1, x, y, z, r, 0)


def flying(mode, **params):
    commander = Commander(CommanderParams(**params), mode_table())
    commander.update(0, conditions=ALL, landed=True)
    assert commander.arm(0) is None
    commander.update(1, conditions=ALL, landed=False)
    assert commander.set_mode(mode) is None
    return commander, ManualControlService(commander)


def test_axes_are_decoded_as_in_mavlink_with_their_time():
    _, service = flying(FlightMode.POSITION)
    assert service.sticks is None
    service.on_message(sticks(x=-500, y=250, z=1000, r=1000), 7_000, CLIENT)
    got = service.sticks
    assert (got.time_us, got.pitch, got.roll, got.throttle, got.yaw) == (7_000, -0.5, 0.25, 1.0, 1.0)
    assert service.is_fresh(507_000, 500_000)
    assert not service.is_fresh(507_001, 500_000)


def test_missing_axes_are_neutral_and_others_are_clamped():
    _, service = flying(FlightMode.POSITION)
    service.on_message(sticks(x=32_767, y=-30_000, z=-1000, r=32_767), 0, CLIENT)
    got = service.sticks
    assert (got.pitch, got.roll, got.throttle, got.yaw) == (0.0, -1.0, 0.0, 0.0)
    service.on_message(sticks(z=32_767), 0, CLIENT)
    assert service.sticks.throttle == 0.5  # neutral


@pytest.mark.parametrize(
    ("mode", "bits", "taken"),
    [
        (FlightMode.HOLD, 1, True),
        (FlightMode.MISSION, 1, True),
        (FlightMode.HOLD, 2, False),
        (FlightMode.OFFBOARD, 1, False),
        (FlightMode.OFFBOARD, 2, True),
        (FlightMode.STABILIZED, 3, False),
    ],
)
def test_moved_sticks_take_over_as_set_by_the_parameter(mode, bits, taken):
    commander, service = flying(mode, stick_takeover=bits)
    assert service.on_message(sticks(y=290), 0, CLIENT) == ()  # COM_RC_STICK_OV is 30 %
    assert commander.mode is mode
    texts = [message.text for _, message in service.on_message(sticks(y=-310), 4_000, CLIENT)]
    assert commander.mode is (FlightMode.POSITION if taken else mode)
    assert texts == (["Pilot took over using sticks"] if taken else [])


def test_sticks_have_no_effect_on_a_vehicle_on_the_ground():
    commander = Commander(CommanderParams(), mode_table())
    service = ManualControlService(commander)
    commander.update(0, conditions=ALL, landed=True)
    service.on_message(sticks(x=1000), 0, CLIENT)
    assert commander.mode is FlightMode.HOLD


def channels(*widths_us):
    return common.MAVLink_rc_channels_override_message(1, 1, *widths_us, *[0] * (8 - len(widths_us)))


def test_overridden_channels_are_decoded_as_sticks():
    _, service = flying(FlightMode.POSITION)
    service.on_message(channels(1_750, 1_250, 2_000, 1_000), 4_000, CLIENT)
    got = service.sticks
    assert (got.time_us, got.roll, got.pitch, got.throttle, got.yaw) == (4_000, 0.5, -0.5, 1.0, -1.0)
    service.on_message(channels(65_535, 1_500, 65_535, 0), 8_000, CLIENT)  # unchanged, centre, released
    got = service.sticks
    assert (got.time_us, got.roll, got.pitch, got.throttle, got.yaw) == (8_000, 0.5, 0.0, 1.0, 0.0)


def test_released_channels_are_no_sticks_and_others_are_clamped():
    _, service = flying(FlightMode.POSITION)
    service.on_message(channels(0, 0, 0, 0), 0, CLIENT)
    service.on_message(channels(*[65_535] * 8), 0, CLIENT)
    assert service.sticks is None
    service.on_message(channels(65_534, 1, 1, 1_500), 4_000, CLIENT)
    got = service.sticks
    assert (got.roll, got.pitch, got.throttle, got.yaw) == (1.0, -1.0, 0.0, 0.0)
    service.on_message(channels(0, 0, 0, 0), 8_000, CLIENT)
    assert service.sticks.time_us == 4_000  # so the sticks time out


@pytest.mark.parametrize("moved", [sticks(x=1000, y=1000), channels(2_000, 2_000, 2_000, 2_000)])
def test_one_partners_sticks_are_used_while_they_are_fresh(moved):
    commander, service = flying(FlightMode.HOLD)
    timeout_us = round(commander.params.manual_loss_s * 1e6)
    service.on_message(sticks(), 0, CLIENT)
    assert service.on_message(moved, timeout_us, OTHER) == ()  # no takeover either
    assert (service.sticks.time_us, service.sticks.pitch, commander.mode) == (0, 0.0, FlightMode.HOLD)
    service.on_message(sticks(), timeout_us, CLIENT)
    service.on_message(moved, 2 * timeout_us, OTHER)
    assert service.sticks.time_us == timeout_us
    service.on_message(moved, 2 * timeout_us + 1, OTHER)  # the previous sticks have timed out
    assert (service.sticks.pitch, commander.mode) == (1.0, FlightMode.POSITION)
    service.on_message(sticks(), 3 * timeout_us, CLIENT)
    assert service.sticks.pitch == 1.0


def test_unchanged_channels_keep_their_partners_values_until_these_time_out():
    commander, service = flying(FlightMode.POSITION)
    timeout_us = round(commander.params.manual_loss_s * 1e6)
    service.on_message(channels(2_000, 2_000, 2_000, 1_500), 0, CLIENT)
    throttle_alone = channels(65_535, 65_535, 1_750, 65_535)
    service.on_message(throttle_alone, timeout_us + 1, OTHER)
    got = service.sticks
    assert (got.roll, got.pitch, got.throttle, got.yaw) == (0.0, 0.0, 0.75, 0.0)
    service.on_message(throttle_alone, 3 * timeout_us, CLIENT)  # its previous values have timed out
    got = service.sticks
    assert (got.time_us, got.roll, got.pitch, got.throttle) == (3 * timeout_us, 0.0, 0.0, 0.75)
    service.on_message(channels(1_750, 65_535, 65_535, 65_535), 4 * timeout_us, CLIENT)
    got = service.sticks
    assert (got.roll, got.throttle) == (0.5, 0.75)


def test_the_number_of_partners_with_channels_is_bounded():
    _, service = flying(FlightMode.POSITION)
    for number in range(1_000):
        service.on_message(channels(2_000, 2_000, 2_000, 2_000), number, Partner(0, number))
    assert len(service._channels) <= 8


def test_channel_overrides_take_over_like_a_joystick():
    commander, service = flying(FlightMode.MISSION)
    assert service.on_message(channels(1_640, 1_500, 1_500, 1_500), 0, CLIENT) == ()
    assert commander.mode is FlightMode.MISSION
    service.on_message(channels(1_660, 1_500, 1_500, 1_500), 0, CLIENT)
    assert commander.mode is FlightMode.POSITION


def test_buttons_and_manual_setpoint_messages_are_ignored():
    commander, service = flying(FlightMode.MISSION)
    pressed = common.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0xFFFF)
    assert service.on_message(pressed, 0, CLIENT) == ()
    assert commander.mode is FlightMode.MISSION
    assert common.MAVLINK_MSG_ID_MANUAL_SETPOINT not in service.takes
