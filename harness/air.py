"""The time master's side of the 802.11 emulator: when the air has to go on, and that it has."""

from harness.physics.truth import Truth
from netsim.radio import ANSWER_LIMIT_S, advance_key
from netsim.transport import Pending, Transport
from netsim.wire.messages import Advance, Advanced, decode, encode, pack_rows


class RadioSilent(ConnectionError):
    """The 802.11 emulator does not answer the time master."""


class Air:
    """The time master's side of the emulated channel.

    Asks it to go on, and only when it has something to do.
    """

    def __init__(self, transport: Transport, run_id: str) -> None:
        self._asker = transport.asker(advance_key(run_id), timeout_s=ANSWER_LIMIT_S)
        self._pending: Pending | None = None
        self._quiet_until_us = 0
        self._handed_over = True
        self.extra_attenuation_db: float | None = None
        self.busy_ns = 0

    def begin(self, time_us: int, step_us: int, truth: Truth, silent: tuple[int, ...]) -> None:
        """Let the emulator simulate up to ``time_us`` beside the vehicles.

        Unless the air stays quiet until then.
        """
        if not self._handed_over and time_us < self._quiet_until_us:
            return
        self._handed_over = False
        request = Advance(
            to_us=time_us,
            release_us=time_us + step_us,
            pos_ned_m=pack_rows(truth.pos_ned_m),
            vel_ned_m_s=pack_rows(truth.vel_ned_m_s),
            q_ned_frd=pack_rows(truth.q_ned_frd),
            silent=silent,
            extra_attenuation_db=self.extra_attenuation_db,
        )
        self._pending = self._asker.ask(encode(request))

    def end(self) -> tuple[int, ...]:
        """Wait until the emulator is through and its deliveries are in the vehicles' hands.

        Returns the vehicles that did not take theirs. Raises RadioSilent.
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

    def handed_over(self) -> None:
        """A vehicle gave its radio something to send: the next interval is not quiet."""
        self._handed_over = True
