"""Wait for the 802.11 emulator as long as its process could still answer."""

import time
from collections.abc import Callable

from harness.simulator.emulator_client import UNANSWERED, EmulatorLine, RadioSilent
from harness.simulator.response_watchdog import ResponseWatchdog
from netsim.wire.lockstep import Advance, Advanced

POLL_S = 0.25
"""Wall time after which the emulator's process is examined, again and again."""
RADIO_LIMIT_S = 8.0
"""Wall time for which the emulator may sleep or be stopped while it owes an answer; see `radio_watchdog`."""
EMULATOR = 0
"""Number of the emulator at its watchdog."""


def radio_watchdog(call_limit_s: float, *, on_check: Callable[[float], object]) -> ResponseWatchdog:
    """Return the watchdog of the emulator, which may call a user's models for ``call_limit_s`` of wall time.

    The launcher finds a stopped emulator before.
    """
    limit_s = max(RADIO_LIMIT_S, call_limit_s + 1.0)
    return ResponseWatchdog(limit_s, stopped_limit_s=RADIO_LIMIT_S, on_check=on_check)


class AwaitedLine:
    """A line to the emulator whose time-outs, every `POLL_S`, only lead to an examination of its process."""

    def __init__(self, line: EmulatorLine, watchdog: ResponseWatchdog) -> None:
        self._line = line
        self._watchdog = watchdog

    def send(self, message: Advance) -> None:
        """Request an interval."""
        self._line.send(message)

    def receive(self) -> Advanced | None:
        """Wait for the answer; None if the emulator is gone. Raises RadioSilent if it is given up."""
        waits = False
        while True:
            try:
                return self._line.receive()
            except TimeoutError:
                wall_s = time.monotonic()
                if not waits:
                    waits = True
                    self._watchdog.begin(wall_s - POLL_S)
                reason = self._watchdog.check(EMULATOR, wall_s, starting=False).give_up
                if reason is not None:
                    raise RadioSilent(f"{UNANSWERED}: {reason}") from None
