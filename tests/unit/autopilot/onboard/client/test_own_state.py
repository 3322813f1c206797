"""Conversion of GPS_RAW_INT to a fix with the time of measurement and the stated accuracy."""

import pytest
from pymavlink.dialects.v20 import common

from autopilot.onboard.client.own_state import OwnState
from autopilot.parameters.config import Site

SITE = Site()


def state():
    own = OwnState(site=SITE, gps_delay_s=0.12)
    own.on_local_position(
        common.MAVLink_local_position_ned_message(1_000, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 3_000_000
    )
    return own


def raw(*, boot_us=1_200_000, fix_type=3, **accuracy_mm):
    lat, lon = round(SITE.latitude_deg * 1e7), round(SITE.longitude_deg * 1e7)
    return common.MAVLink_gps_raw_int_message(
        boot_us, fix_type, lat, lon, round(SITE.altitude_m * 1e3), 150, 250, 0, 0, 10, **accuracy_mm
    )


def test_a_fix_has_the_time_of_its_measurement_and_the_stated_accuracy():
    own = state()
    assert own.on_gps(raw(h_acc=1_520, v_acc=2_650))
    # On the formation's clock the autopilot booted at 2 s: 1.2 s since then, less the receiver's 0.12 s.
    assert own.fix.time_ms == 3_080
    assert own.fix.pos_ned_m == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
    assert (own.fix.std_h_m, own.fix.std_v_m) == pytest.approx((1.52, 2.65))


def test_a_receiver_that_states_no_accuracy_has_none():
    # The eph and epv of 150 and 250 are dilutions of precision here, not lengths.
    own = state()
    assert own.on_gps(raw())
    assert (own.fix.std_h_m, own.fix.std_v_m) == (None, None)


@pytest.mark.parametrize("message", [raw(fix_type=2), raw(boot_us=0), raw(boot_us=1_190_000)])
def test_messages_without_a_new_fix_change_nothing(message):
    own = state()
    assert own.on_gps(raw(boot_us=1_190_000, h_acc=1_000))
    fix = own.fix
    assert not own.on_gps(message)
    assert own.fix is fix
