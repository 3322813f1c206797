"""Setpoints of `AutopilotClient.fly`: which values are sent, which are marked as ignored, what is refused."""

import math
from types import SimpleNamespace

import pytest

from autopilot.mavlink.modes import FlightMode
from autopilot.onboard.client.autopilot_client import AutopilotClient, FlightState
from autopilot.onboard.client.autopilots import ARDUPILOT, PX4
from autopilot.parameters.config import Site
from autopilot.services.setpoint_messages import decode

ORIGIN_NED_M = (10.0, -20.0, 0.0)


def following(interface=PX4):
    """Return the client of a vehicle that follows setpoints and whose estimator started at ORIGIN_NED_M."""
    client = AutopilotClient(system=2, site=Site(), gps_delay_s=0.12, interface=interface)
    client.flight, client.own.mode, client.own.origin_ned_m = (
        FlightState.FOLLOWING, FlightMode.OFFBOARD, ORIGIN_NED_M,
    )  # fmt: skip
    return client


def flown(client):
    """Return the setpoint that an autopilot decodes from the only message of the client."""
    (message,) = client.take(0)
    return decode(message, SimpleNamespace(state=None))


def test_the_axes_of_a_setpoint_are_mixed_as_they_are_given():
    client = following()
    client.fly(vel_ned_m_s=(2.0, 0.0, None), pos_ned_m=(None, None, -8.0), yaw_rad=1.0)
    setpoint = flown(client)
    assert setpoint.vel_axes == (True, True, False)
    assert setpoint.pos_axes == (False, False, True)
    assert setpoint.vel_ned_m_s[:2] == (2.0, 0.0)
    assert setpoint.pos_ned_m[2] == -8.0
    assert setpoint.acc_ned_m_s2 is None
    assert setpoint.yaw_rad == 1.0


def test_a_whole_position_is_sent_from_the_origin_of_the_estimator():
    client = following()
    client.fly(pos_ned_m=(1.0, 2.0, -3.0), acc_ned_m_s2=(0.1, 0.2, 0.3))
    setpoint = flown(client)
    assert setpoint.pos_ned_m == (-9.0, 22.0, -3.0)
    assert setpoint.pos_axes == setpoint.acc_axes == (True, True, True)
    assert setpoint.acc_ned_m_s2 == (0.1, 0.2, 0.3)
    assert setpoint.vel_ned_m_s is None


@pytest.mark.parametrize(
    ("setpoint", "line"),
    [
        ({}, "for each of the three axes"),
        ({"vel_ned_m_s": (1.0, 1.0, None)}, "for each of the three axes"),
        ({"vel_ned_m_s": (1.0, None, None), "pos_ned_m": (1.0, None, -1.0)}, "for each of the three axes"),
        ({"pos_ned_m": (1.0, 2.0)}, r"pos_ned_m: \(1.0, 2.0\); expected three numbers"),
        ({"pos_ned_m": (1.0, 2.0, "3 m")}, "expected three numbers"),
        ({"vel_ned_m_s": (1.0, 2.0, math.nan)}, "vel_ned_m_s: .*; expected finite numbers"),
        ({"acc_ned_m_s2": (math.inf, 2.0, 0.0)}, "acc_ned_m_s2: .*; expected finite numbers"),
        ({"pos_ned_m": (0.0, 0.0, -1.0), "yaw_rad": math.nan}, "yaw_rad: nan; expected a finite number"),
    ],
)
def test_what_is_no_setpoint_is_refused(setpoint, line):
    client = following()
    with pytest.raises(ValueError, match=line):
        client.fly(**setpoint)
    assert client.take(0) == []


def test_an_ardupilot_is_sent_whole_vectors_only():
    """ArduPilot ignores a vector of which one axis is marked as ignored, and would fly the others only."""
    client = following(ARDUPILOT)
    with pytest.raises(ValueError, match="expected all three axes beside an ArduPilot"):
        client.fly(vel_ned_m_s=(2.0, 0.0, None), pos_ned_m=(None, None, -8.0))
    client.fly(vel_ned_m_s=(2.0, 0.0, 0.0))
    assert flown(client).vel_axes == (True, True, True)
