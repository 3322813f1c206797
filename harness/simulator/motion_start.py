"""Start of the formation's motion: decoded from the vehicles' messages and from the run's events.

The applications agree on the start over the radio. Each reports the agreed value to the simulator in a
NAMED_VALUE_INT, so that the truth can be compared with the plan that is flown.
"""

import contextlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from harness.simulator.messages import FormationMoves


def start_us(value: int) -> int:
    """Return the start of a NAMED_VALUE_INT's value, us; a vehicle without a start sends no such message.

    The value is milliseconds on the run's clock, an unsigned number in its signed field.
    """
    return (value & 0xFFFF_FFFF) * 1_000


def agreed(starts_us: Sequence[int | None]) -> int | None:
    """Return the start that more than half of the vehicles report; None: there is no majority."""
    if not starts_us:
        return None
    value_us, count = Counter(starts_us).most_common(1)[0]
    return value_us if 2 * count > len(starts_us) else None


def flown_start_us(events: Path) -> int | None:
    """Return the last start among a run's events; None if the formation never moved. Raises OSError."""
    last_us = None
    for line in events.read_bytes().splitlines():
        if b'"event":"formationmoves"' in line:
            with contextlib.suppress(msgspec.DecodeError):  # a line that was cut off when the process ended
                last_us = msgspec.json.decode(line, type=FormationMoves).start_us
    return last_us


def since_start_s(time_us: NDArray[np.int64], flown_us: int | None) -> NDArray[np.float64]:
    """Return (T,) seconds since the formation's start, for `FormationPlan`; all 0 without a start."""
    if flown_us is None:
        return np.zeros(len(time_us))
    return (time_us - flown_us).astype(np.float64) * 1e-6
