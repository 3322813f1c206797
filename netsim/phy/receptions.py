"""How the stations received a frame that has ended: outcome, state of the receiver, SINR; for the log."""

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from netsim.model import codes as c
from netsim.model.tables import Integers, Tables
from netsim.phy.path_loss import Doubles

OUTCOMES = ("not_addressed", "delivered", "collided", "lost_to_noise", "radio_off")
"""Outcomes at a station; the first four by their codes, `codes.NOT_MEANT` to `codes.LOST`."""
STATES = ("received", "errors", "below_sensitivity", "transmitting", "missed", "radio_off")
"""What a station did with a frame, addressed or not, by the following codes."""
RECEIVED, ERRORS, BELOW_SENSITIVITY, TRANSMITTING, MISSED, RADIO_OFF = range(6)
_OUTCOME_OFF = OUTCOMES.index("radio_off")
_STATES_BY_OUTCOME = np.array([RADIO_OFF, MISSED, RECEIVED, ERRORS])
"""By `codes.ABSENT` to `codes.BROKE`."""


class Receptions(Struct):
    """Receptions of a frame by station; the transmitter's entries have no meaning."""

    outcomes: Integers
    """(n,) codes of `OUTCOMES`."""
    states: Integers
    """(n,) codes of `STATES`."""
    sinr: Doubles
    """(n,) least ratio of the power to noise and all other stations' signals; NaN without noise."""


def receptions_of(tables: Tables, frame: int) -> Receptions:
    """Return the receptions of a frame that has just ended; its row of signals must still be in use."""
    air, ends = tables.air[0], tables.ends
    power_mw: Doubles = tables.paths["power_mw"][frame]
    interference_mw, sends = _others(tables, frame)
    states = _STATES_BY_OUTCOME[ends["outcome"] - c.ABSENT]
    missed = states == MISSED
    if missed.any():
        states[missed & sends] = TRANSMITTING
        states[missed & (power_mw < air.preamble_mw)] = BELOW_SENSITIVITY
    outcomes = ends["receiver_outcome"].copy()
    outcomes[states == RADIO_OFF] = _OUTCOME_OFF
    return Receptions(outcomes, states, power_mw / (air.noise_mw + interference_mw))


def without_noise(powers_mw: Doubles, least_mw: float, outcomes: Integers) -> Receptions:
    """Return the receptions on a channel on which only the power decides.

    Radios that are off have the outcome `radio_off` already.
    """
    states = np.where(powers_mw < least_mw, BELOW_SENSITIVITY, RECEIVED)
    states[outcomes == _OUTCOME_OFF] = RADIO_OFF
    return Receptions(outcomes, states, np.full(len(powers_mw), np.nan))


def _others(tables: Tables, frame: int) -> tuple[Doubles, NDArray[np.bool_]]:
    """Return by station the greatest total power of other signals during a frame, and whether it sent then.

    The total is constant between begins and ends of signals, so it is greatest at the begin of one. A
    station's own signals are not part of it.
    """
    signals, paths = tables.signals, tables.paths
    stations, count = len(tables.stations), int(signals["overlap_count"][frame])
    if count == 0:
        return np.zeros(stations), np.zeros(stations, bool)
    which = tables.overlaps["signal"][frame, :count]
    delay_ns = paths["delay_ns"][which]
    begin_ns = signals["start_ns"][which, None] + delay_ns
    end_ns = signals["radiated_until_ns"][which, None] + delay_ns
    from_ns = signals["start_ns"][frame] + paths["delay_ns"][frame]
    until_ns = signals["radiated_until_ns"][frame] + paths["delay_ns"][frame]
    during = (begin_ns < until_ns) & (end_ns > from_ns)
    own = signals["source"][which, None] == np.arange(stations)
    power_mw = np.where(during & ~own, paths["power_mw"][which], 0.0)
    at_ns = np.maximum(begin_ns, from_ns)
    # axes: instants, signals, stations
    present = (begin_ns <= at_ns[:, None]) & (end_ns > at_ns[:, None])
    total_mw = np.where(during, np.where(present, power_mw, 0.0).sum(axis=1), 0.0)
    greatest_mw: Doubles = total_mw.max(axis=0)
    sends: NDArray[np.bool_] = (during & own).any(axis=0)
    return greatest_mw, sends
