"""How a flight with a fault has to end: exit status, names in its messages, wall time."""

import re
import signal
from collections.abc import Sequence

from foundation.exit_status import BAD_INPUT, FAILED, FINE, INTERRUPTED
from studies.chaos.faults import WITH_PX4, Fault

DEATHS = ("SIGKILL", "SIGSEGV")
GOES_ON = ("SIGSTOP for 2 s", "closed output")
END_LIMIT_S = 15.0
"""Wall time from the last fault to the end of a flight that does not go on."""
STOP_S = 2.0
"""Wall time for which a process is stopped and then continued."""
FULL = "(?i)no space left on (the )?device"


def statuses(fault: Fault) -> Sequence[int]:
    """Return the exit statuses that a flight with this fault may have.

    A launcher that was killed has the signal's. In phase ``stop`` the flight was interrupted before, and a
    process that is stopped then, even for a short time, is killed; in ``report`` it may have ended. With two
    faults those of either, and 0 only if each permits it.
    """
    each = [_statuses_of_one(part) for part in fault.parts]
    either = dict.fromkeys(status for some in each for status in some)
    return [status for status in either if status != FINE or all(FINE in some for some in each)]


def _statuses_of_one(fault: Fault) -> Sequence[int]:
    if fault.kind in GOES_ON and fault.phase != "stop":
        return [FINE]
    if fault.kind in GOES_ON and fault.target == "launcher":
        return [INTERRUPTED]
    if fault.target == "launcher":
        if fault.kind in DEATHS:
            killed = -signal.Signals[fault.kind]
            return [killed, FINE] if fault.phase == "report" else [killed]
        return [INTERRUPTED, FINE] if fault.phase == "report" else [INTERRUPTED]
    if fault.target == "disk":
        permitted = {"start": [FAILED, BAD_INPUT], "stop": [INTERRUPTED, FAILED], "report": [FAILED, FINE]}
        return permitted.get(fault.phase, [FAILED])
    if fault.phase == "stop":
        return [INTERRUPTED, FAILED]
    if fault.target in WITH_PX4:
        return [FINE]
    if fault.target == "uav 0":  # once it has connected the run goes on without it
        return [FAILED, FINE] if fault.phase == "start" else [FINE]
    return [FAILED]


def statuses_before(fault: Fault) -> Sequence[int]:
    """Return the exit statuses that a flight may have that ends before its fault.

    In phase ``stop`` it was interrupted; in another the flight may be complete.
    """
    return [INTERRUPTED] if fault.phase == "stop" else [FINE]


def named(fault: Fault) -> Sequence[str]:
    """Return texts of which the messages must have one; none: they need not name the process.

    A process by its name and id; one that was killed with the signal. A vehicle or application that is
    stopped is lost, by its name. Of two faults either may be named first, and none if the other ends the
    launcher or closes its output.
    """
    parts = fault.parts
    if len(parts) > 1 and any(part.target == "launcher" and part.kind != "SIGSTOP for 2 s" for part in parts):
        return []
    return [pattern for part in parts for pattern in _named_of_one(part)]


def _named_of_one(fault: Fault) -> Sequence[str]:
    if fault.target == "launcher" or fault.kind == "SIGSTOP for 2 s" or fault.phase == "stop":
        return []
    if fault.target == "disk":
        return [] if fault.phase == "report" else [FULL]
    if fault.target == "px4 0":  # its process is the vehicle
        return [r"uav 0( was)? lost", r"uav 0 \(pid "]
    name = re.escape(fault.target)
    if fault.kind in DEATHS:
        return [rf"{name} \(pid \d+\) was killed by {fault.kind}"]
    texts = [rf"{name} \(pid "]
    if fault.kind == "SIGSTOP":
        texts = [rf"{name} \(pid \d+\) is stopped \(SIGSTOP\)"]
        if fault.target in ("uav 0", "application 0"):
            texts.append(rf"{name}( was)? lost")
    return texts


def end_limit_s(fault: Fault) -> float:
    """Return the wall time from the first fault within which a flight has to end that does not go on."""
    stops = STOP_S * sum(part.kind == "SIGSTOP for 2 s" for part in fault.parts)
    return END_LIMIT_S + stops + (fault.second.after_s if fault.second is not None else 0.0)
