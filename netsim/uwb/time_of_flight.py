"""Estimators of the time of flight from the time stamps of an exchange, and their errors.

A round is the time from the departure of an own frame to the arrival of its reply, a reply that from the
arrival of a frame to the departure of the own one. Times are ticks of the clock that measured them.
"""

from math import sqrt

from netsim.phy.path_loss import SPEED_OF_LIGHT_M_S
from netsim.uwb.clock import TICK_PS
from netsim.uwb.config import UwbConfig

M_PER_TICK = SPEED_OF_LIGHT_M_S * TICK_PS * 1e-12
_M_PER_PS = SPEED_OF_LIGHT_M_S * 1e-12


def single_sided_ticks(round_ticks: float, reply_ticks: float, rate_ratio: float = 1.0) -> float:
    """Return the time of flight of single-sided two-way ranging.

    ``rate_ratio`` is the rate of the initiator's clock divided by that of the responder's; with 1 the
    estimate is too long by half the reply time and the relative error of the clocks (`clock_error_m`).
    """
    return 0.5 * (round_ticks - reply_ticks * rate_ratio)


def double_sided_ticks(
    round_a_ticks: float, reply_b_ticks: float, round_b_ticks: float, reply_a_ticks: float
) -> float:
    """Return the time of flight of double-sided two-way ranging with unequal reply times.

    It is (Ra Rb - Da Db) / (Ra + Rb + Da + Db), with rounds R and replies D of both ends. Errors of the
    clocks e change the result by the share e of the time of flight only. Source: Neirynck, Luk and
    McLaughlin, "An alternative double-sided two-way ranging method", WPNC 2016.
    """
    product = round_a_ticks * round_b_ticks - reply_a_ticks * reply_b_ticks
    return product / (round_a_ticks + round_b_ticks + reply_a_ticks + reply_b_ticks)


def clock_error_m(relative_ppm: float, reply_time_us: float) -> float:
    """Return the error of an uncorrected single-sided distance.

    It is c/2 times relative clock error and reply time.
    ``relative_ppm`` is by how much the initiator's clock is faster than the responder's. The table of the
    DW1000 user manual (appendix 3) has the same: 0.1 ns at 2 ppm and 100 us.
    """
    return 0.5 * SPEED_OF_LIGHT_M_S * 1e-12 * relative_ppm * reply_time_us


def distance_std_m(config: UwbConfig) -> float:
    """Return the standard deviation of a distance at high signal-to-noise ratio, without antenna delays.

    With arrivals of standard deviation s, a single-sided distance has c s / sqrt(2), and in addition c/2
    times the reply time and the error of the clock ratio: that of the carrier's offset, or without correction
    that of two clocks within ``clock_ppm``. A double-sided one with equal replies has c s sqrt(3/8), since
    the response's arrival is in a round and in a reply (Rathje and Landsiedel, arXiv 2410.12826).
    """
    arrival_m = config.time_stamp_std_ps * _M_PER_PS
    if config.method == "ds":
        return arrival_m * sqrt(0.375)
    ratio_ppm = (
        config.carrier_offset_std_ppm if config.carrier_correction else config.clock_ppm * sqrt(2.0 / 3.0)
    )
    return sqrt(0.5 * arrival_m**2 + clock_error_m(ratio_ppm, config.reply_time_us) ** 2)
