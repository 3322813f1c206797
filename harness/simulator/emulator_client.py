"""The time master's side of the 802.11 emulator: when the air has to go on, and that it has."""

from collections.abc import Mapping
from typing import Protocol

import msgspec

from harness.world.physics.truth import Truth
from netsim.wire.lockstep import LEAD_US, Advance, Advanced, pack_rows

LONGEST_REST_US = LEAD_US // 2
"""How far a quiet air may be left behind. The emulator refuses a vehicle that is `LEAD_US` ahead of it."""


class RadioSilent(ConnectionError):
    """The 802.11 emulator does not answer the time master."""


class EmulatorLine(Protocol):
    """The way to the emulator: see `netsim.transport.interval_stream.ClockLine`."""

    def send(self, message: Advance) -> None:
        """Ask for an interval."""

    def receive(self) -> Advanced | None:
        """Wait until it is done; None: the emulator is gone. Raises TimeoutError."""


class EmulatorClient:
    """The time master's side of the emulated channel.

    It goes on in intervals as long as the loop of the vehicles' applications, ``period_us``: one begins when
    they have handed over their batches, and what arrives in it is theirs when it ends. The emulator works on
    it beside the steps in between. Of quiet intervals it is asked for as few as keep it from being left far
    behind.

    ``free``: there are radios whose hosts are in no lockstep, and may speak at any time. Then intervals are
    as long as the steps, and none is left out; what arrives is released a step after the end, which is the
    step that the emulator needs to work beside the others.
    """

    def __init__(self, line: EmulatorLine, *, period_us: int, free: bool = False) -> None:
        self._period_us = period_us
        self._free = free
        self._line = line
        self._request: Advance | None = None
        """What the emulator has not answered yet."""
        self._quiet_until_us = 0
        self._asked_us = 0
        """How far it was let go on."""
        self._delivered: dict[int, tuple[int, ...]] = {}
        """By time of release, vehicles that have a delivery."""
        self.extra_attenuation_db: float | None = None
        """On every link, in the intervals that begin from now on; None is the scenario's own value."""
        self.range_offsets_m: Mapping[int, float] = {}
        """By station, how much farther than it is its radio measures, from then on too."""
        self.busy_ns = 0
        """Time for which the channel was occupied until the end of the last interval that is done."""

    def is_awaited(self, time_us: int) -> bool:
        """Whether the emulator has not done yet what the sensors of ``time_us`` have to tell of."""
        return self._request is not None and self._request.release_us <= time_us

    def delivered(self, time_us: int) -> tuple[int, ...]:
        """Vehicles whose radio has brought something for the step of ``time_us``; to be asked once a step."""
        return self._delivered.pop(time_us, ()) if self._delivered else ()

    def begins_at(self, time_us: int) -> bool:
        """Whether an interval begins with the step of ``time_us``; the one before has to be done by then."""
        return self._free or time_us % self._period_us == 0

    def begin(
        self,
        time_us: int,
        step_us: int,
        truth: Truth,
        *,
        senders: tuple[int, ...] = (),
        silent: tuple[int, ...] = (),
    ) -> None:
        """Let the emulator simulate the interval that begins now, unless the air stays quiet for so long.

        It works beside the physics, so it is given where the vehicles are and how they move now: what an
        acceleration of 2 m/s2 changes in 40 ms are 1.6 mm. The ``senders`` have handed something over in
        this step; the ``silent`` are gone.
        """
        to_us = time_us + (step_us if self._free else self._period_us)
        quiet_us = min(self._quiet_until_us, self._asked_us + LONGEST_REST_US)
        if not self._free and not senders and to_us < quiet_us:
            return
        self._asked_us = to_us
        self._request = Advance(
            to_us=to_us,
            release_us=to_us + step_us if self._free else to_us,
            at_us=time_us,
            pos_ned_m=pack_rows(truth.pos_ned_m),
            vel_ned_m_s=pack_rows(truth.vel_ned_m_s),
            q_ned_frd=pack_rows(truth.q_ned_frd),
            senders=senders,
            silent=silent,
            extra_attenuation_db=self.extra_attenuation_db,
            range_offsets_m=tuple(self.range_offsets_m.items()),
        )
        self._line.send(self._request)

    def end(self) -> tuple[int, ...]:
        """Wait until the emulator is through with what it was let do.

        Returns the vehicles whose batches it misses, for which there is `wait_on`. Raises RadioSilent.
        """
        request = self._request
        if request is None:
            return ()
        try:
            advanced = self._line.receive()
        except TimeoutError:
            raise RadioSilent("the 802.11 emulator does not answer") from None
        if advanced is None:
            raise RadioSilent("the 802.11 emulator is gone")
        if advanced.missing:
            return advanced.missing
        self._request = None
        self._quiet_until_us = advanced.quiet_until_us
        self.busy_ns = advanced.busy_ns
        if advanced.delivered:
            self._delivered[request.release_us] = advanced.delivered
        return ()

    def wait_on(self, silent: tuple[int, ...]) -> tuple[int, ...]:
        """After `end`: go on waiting for those whose batches are missing, less the silent."""
        if self._request is not None:
            self._request = msgspec.structs.replace(self._request, silent=silent)
            self._line.send(self._request)
        return self.end()
