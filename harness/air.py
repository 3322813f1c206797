"""The time master's side of the 802.11 emulator: when the air has to go on, and that it has."""

from collections.abc import Mapping
from typing import Protocol

import msgspec

from harness.physics.truth import Truth
from netsim.hosted import LEAD_US
from netsim.radio import ADVANCE_LIMIT_S, advance_key
from netsim.wire.messages import Advance, Advanced, decode, encode, pack_rows

LONGEST_REST_US = LEAD_US // 2
"""How far a quiet air may be left behind. The emulator refuses a vehicle that is `LEAD_US` ahead of it."""


class RadioSilent(ConnectionError):
    """The 802.11 emulator does not answer the time master."""


class Answering(Protocol):
    """A question under way: see `netsim.transport.Pending`."""

    def answer(self) -> bytes | None:
        """Wait for the answer; None: there is none."""


class Asking(Protocol):
    """Asks one key: see `netsim.transport.Asker`."""

    def ask(self, payload: bytes) -> Answering:
        """Send a question."""


class Carrier(Protocol):
    """Brings questions to the emulator: see `netsim.transport.Transport`."""

    def asker(self, key: str, *, timeout_s: float) -> Asking:
        """Declare that ``key`` will be asked."""


class Air:
    """The time master's side of the emulated channel.

    Asks it to go on when it has something to do, and so often that it is never left far behind; with guests
    on the channel at every step.
    """

    def __init__(self, transport: Carrier, run_id: str, *, guests: bool = False) -> None:
        self._guests = guests
        self._asker = transport.asker(advance_key(run_id), timeout_s=ADVANCE_LIMIT_S)
        self._request: Advance | None = None
        self._pending: Answering | None = None
        self._quiet_until_us = 0
        self._handed_over = True
        self._asked_us = 0
        """How far it was let go on."""
        self.extra_attenuation_db: float | None = None
        """On every link, in the intervals that begin from now on; None is the scenario's own value."""
        self.range_offsets_m: Mapping[int, float] = {}
        """By station, how much farther than it is its radio measures, from then on too."""
        self.busy_ns = 0

    def begin(self, time_us: int, step_us: int, truth: Truth, silent: tuple[int, ...]) -> None:
        """Let the emulator simulate the step that begins now, unless the air stays quiet for so long.

        It works beside the physics, so it is given where the vehicles are and how they move now: what their
        acceleration changes in a step is less than a tenth of a millimetre. The ``silent`` are gone.
        """
        to_us = time_us + step_us
        quiet_us = min(self._quiet_until_us, self._asked_us + LONGEST_REST_US)
        if not self._guests and not self._handed_over and to_us < quiet_us:
            return
        self._handed_over = False
        self._asked_us = to_us
        self._ask(
            Advance(
                to_us=to_us,
                release_us=to_us + step_us,
                at_us=time_us,
                pos_ned_m=pack_rows(truth.pos_ned_m),
                vel_ned_m_s=pack_rows(truth.vel_ned_m_s),
                q_ned_frd=pack_rows(truth.q_ned_frd),
                silent=silent,
                extra_attenuation_db=self.extra_attenuation_db,
                range_offsets_m=tuple(self.range_offsets_m.items()),
            )
        )

    def end(self) -> tuple[int, ...]:
        """Wait until the emulator is through and its deliveries are in the vehicles' hands.

        Returns the vehicles that have not taken theirs, for which there is `wait_on`. Raises RadioSilent.
        """
        if self._pending is None:
            return ()
        answer = self._pending.answer()
        self._pending = None
        advanced = decode(Advanced, answer) if answer is not None else None
        if advanced is None:
            raise RadioSilent("the 802.11 emulator does not answer")
        self._quiet_until_us = advanced.quiet_until_us
        self.busy_ns = advanced.busy_ns
        return advanced.unresponsive

    def wait_on(self, silent: tuple[int, ...]) -> tuple[int, ...]:
        """After `end`: go on waiting for those who have not taken their deliveries, less the silent."""
        if self._request is not None:
            self._ask(msgspec.structs.replace(self._request, silent=silent))
        return self.end()

    def _ask(self, request: Advance) -> None:
        self._request = request
        self._pending = self._asker.ask(encode(request))

    def handed_over(self) -> None:
        """A vehicle gave its radio something to send: the step that begins now is not quiet."""
        self._handed_over = True
