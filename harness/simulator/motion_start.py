"""When the formation begins to move: what the vehicles say of it, and what the run's events keep of that.

The applications agree on the start among themselves, over the radio. Each tells the simulator in a
NAMED_VALUE_INT what it holds agreed, so that the truth can be held against the plan that is flown.
"""

import contextlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from autopilot.onboard.formation import messages
from harness.simulator.messages import FormationMoves

START_NAME = messages.START_NAME.decode("ascii")
"""Name of the message's value: milliseconds on the run's clock, an unsigned number in its signed field."""


def start_us(value: int) -> int:
    """Give the start that a message says; who holds none says nothing."""
    return (value & 0xFFFF_FFFF) * 1_000


def agreed(starts_us: Sequence[int | None]) -> int | None:
    """Give the start that more than half of the vehicles say; None: there is no such start."""
    if not starts_us:
        return None
    value_us, count = Counter(starts_us).most_common(1)[0]
    return value_us if 2 * count > len(starts_us) else None


def flown_start_us(events: Path) -> int | None:
    """Last start among a run's events; None if the formation never moved. Raises OSError."""
    last_us = None
    for line in events.read_bytes().splitlines():
        if b'"event":"formationmoves"' in line:
            with contextlib.suppress(msgspec.DecodeError):  # a line that was cut off with its process
                last_us = msgspec.json.decode(line, type=FormationMoves).start_us
    return last_us


def since_start_s(time_us: NDArray[np.int64], flown_us: int | None) -> NDArray[np.float64]:
    """(T,) times in seconds since the formation's start, for `FormationPlan`; all 0 without a start."""
    if flown_us is None:
        return np.zeros(len(time_us))
    return (time_us - flown_us).astype(np.float64) * 1e-6
