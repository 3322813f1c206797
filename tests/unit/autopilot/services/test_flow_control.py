"""Rates by the reports of a telemetry modem: the rules of PX4's mavlink_main.cpp."""

import pytest
from pymavlink.dialects.v20 import common

from autopilot.services.flow_control import TIMEOUT_US, FlowControl
from autopilot.services.streams import SECOND_US, SERIAL_HZ, MessageStreams

UNLIMITED = 10**9
NEEDS = 20.0, 1_000.0


def factor_after(*reports, start=()):
    """Return the factor after reports of free space in percent, one a second."""
    flow = FlowControl(UNLIMITED)
    for second, txbuf in enumerate((*start, *reports)):
        flow.on_radio_status(txbuf, second * SECOND_US)
    return flow.factor(len((*start, *reports)) * SECOND_US, *NEEDS)


@pytest.mark.parametrize(
    ("txbuf", "factor"), [(0, 0.8), (24, 0.8), (25, 0.975), (34, 0.975), (35, 1.0), (50, 1.0), (51, 1.025)]
)
def test_a_report_scales_the_rates_by_the_free_space_of_the_buffer(txbuf, factor):
    full = [0, 0, 0]
    assert factor_after(txbuf, start=full) == pytest.approx(0.8**3 * factor)


def test_rates_stay_within_their_limits():
    assert factor_after(*[0] * 50) == 0.05
    assert factor_after(*[100] * 50) == 1.0
    # the stored factor ends at 1 %, from which 66 reports lead back to 5 %
    assert factor_after(*[0] * 50, *[100] * 60) == 0.05
    assert factor_after(*[0] * 50, *[100] * 70) > 0.05


def test_rates_return_when_the_modem_no_longer_reports():
    flow = FlowControl(UNLIMITED)
    flow.on_radio_status(0, 0)
    assert flow.is_low(TIMEOUT_US)
    assert flow.factor(TIMEOUT_US, *NEEDS) == 0.8
    assert not flow.is_low(TIMEOUT_US + 1)
    assert flow.factor(TIMEOUT_US + 1, *NEEDS) == 1.0


def test_streams_fit_into_the_data_rate_and_the_heartbeat_keeps_its_own():
    streams = MessageStreams(
        dict.fromkeys(SERIAL_HZ, lambda: common.MAVLink_system_time_message(0, 0)), SERIAL_HZ
    )
    constant_bytes_s, variable_bytes_s = streams.needs_bytes_s
    assert constant_bytes_s == 21.0  # a heartbeat a second
    streams.rate_factor = FlowControl(1_000).factor(0, constant_bytes_s, variable_bytes_s)
    assert constant_bytes_s + streams.rate_factor * variable_bytes_s == pytest.approx(1_000.0)
    sent = dict.fromkeys(SERIAL_HZ, 0)
    streams.form = lambda kind: sent.__setitem__(kind, sent[kind] + 1) or ()
    for kind in SERIAL_HZ:
        streams.on_new_data(kind)
    for now_us in range(0, 20 * SECOND_US, 4_000):
        streams.on_timer(now_us)
    assert sent[common.MAVLINK_MSG_ID_HEARTBEAT] == 20
    assert sent[common.MAVLINK_MSG_ID_ATTITUDE] == pytest.approx(20 * 15 * streams.rate_factor, rel=0.05)
