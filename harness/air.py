"""The time master's side of the 802.11 emulator: when the air has to go on, and that it has."""

import msgspec

from autopilot.types import Array
from netsim.radio import ADVANCE_LIMIT_S, advance_key
from netsim.transport import Pending, Transport
from netsim.wire.messages import Advance, Advanced, decode, encode, pack_rows


class RadioSilent(ConnectionError):
    """The 802.11 emulator does not answer the time master."""


class Air:
    """The time master's side of the emulated channel.

    Asks it to go on, and only when it has something to do.
    """

    def __init__(self, transport: Transport, run_id: str) -> None:
        self._asker = transport.asker(advance_key(run_id), timeout_s=ADVANCE_LIMIT_S)
        self._request: Advance | None = None
        self._pending: Pending | None = None
        self._quiet_until_us = 0
        self._handed_over = True
        self._attenuation_db: float | None = None
        self._next_attenuation_db: float | None = None
        self.busy_ns = 0

    def set_extra_attenuation_db(self, value: float | None) -> None:
        """Attenuate every link by this from now on; None is the scenario's own value.

        The air of the interval that ends now has not been simulated yet and keeps what was in force.
        """
        self._next_attenuation_db = value

    def begin(self, time_us: int, step_us: int, pos_ned_m: Array, silent: tuple[int, ...]) -> None:
        """Let the emulator simulate up to ``time_us``, when the vehicles are at (n, 3) ``pos_ned_m``.

        It does so beside the vehicles, unless the air stays quiet until then. The ``silent`` are gone.
        """
        attenuation_db, self._attenuation_db = self._attenuation_db, self._next_attenuation_db
        if not self._handed_over and time_us < self._quiet_until_us:
            return
        self._handed_over = False
        self._ask(
            Advance(
                to_us=time_us,
                release_us=time_us + step_us,
                pos_ned_m=pack_rows(pos_ned_m),
                silent=silent,
                extra_attenuation_db=attenuation_db,
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
        """A vehicle gave its radio something to send: the next interval is not quiet."""
        self._handed_over = True
