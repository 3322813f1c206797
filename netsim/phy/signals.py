"""What is on the air, and what a station's receiver knows of it."""

from typing import Protocol

from netsim.frames import Frame
from netsim.phy.propagation import LinkRow
from netsim.streams import Uniforms


class Listener(Protocol):
    """What a receiver tells its MAC."""

    def on_busy(self, from_ns: int) -> None:
        """Note that the medium is busy from then on; that may lie ahead by the propagation delay."""

    def on_received(self, transmission: "Transmission", power_mw: float, end_ns: int) -> None:
        """Take a frame that was received whole, for whomever it is."""

    def on_error(self, end_ns: int) -> None:
        """Note that a frame which the receiver was locked on to ended in errors."""

    def on_sent(self, transmission: "Transmission") -> None:
        """Note that the own transmission has ended."""

    def on_air_changed(self) -> None:
        """Note that a transmission has ended at all receivers."""


class Signal:
    """Energy on the air: an interferer's burst, whose ``source`` is negative, or a frame."""

    __slots__ = (
        "delays_ns", "end_ns", "longest_delay_ns", "overlaps", "powers_mw", "source", "start_ns",
    )  # fmt: skip

    def __init__(self, source: int, start_ns: int, end_ns: int, row: LinkRow, powers_mw: list[float]) -> None:
        self.source = source
        self.start_ns = start_ns
        self.end_ns = end_ns
        self.powers_mw = powers_mw
        self.delays_ns = row.delays_ns
        self.longest_delay_ns = row.longest_delay_ns
        self.overlaps: list[Signal] = []
        """Those that were on the air at some time with it; of a burst, those that began before."""


class Transmission(Signal):
    """A frame on the air, and what became of it."""

    __slots__ = ("collided", "delivered", "frame", "lost_to_noise")

    def __init__(self, frame: Frame, start_ns: int, row: LinkRow, powers_mw: list[float]) -> None:
        super().__init__(frame.source, start_ns, start_ns + frame.duration_ns, row, powers_mw)
        self.frame = frame
        self.delivered: list[int] = []
        self.collided: list[int] = []
        self.lost_to_noise: list[int] = []


class Receiver:
    """One station's receiver: what it is locked on to and how long it senses the medium busy."""

    __slots__ = (
        "_sending_from_ns",
        "_sensed_at_start_ns",
        "_sent_alone_ns",
        "attentive",
        "busy_from_ns",
        "busy_until_ns",
        "ended_busy_ns",
        "idle_before_ns",
        "index",
        "listener",
        "lock",
        "locked_ns",
        "sending_until_ns",
        "uniforms",
    )

    def __init__(self, index: int, uniforms: Uniforms) -> None:
        self.index = index
        self.uniforms = uniforms
        self.listener: Listener
        self.attentive = True
        """Whether the listener wants `Listener.on_busy` and `Listener.on_air_changed`: most of the time most
        stations have nothing to send, and it does not matter to them."""
        self.lock: Transmission | None = None
        self.locked_ns = -1
        """When it last found a preamble."""
        self.sending_until_ns = -1
        self.busy_from_ns = 0
        self.busy_until_ns = 0
        """The last busy period; it may begin later than now by the propagation delay."""
        self.idle_before_ns = 0
        """End of the busy period before that one."""
        self.ended_busy_ns = 0
        """Length of all busy periods before the last."""
        self._sending_from_ns = -1
        self._sensed_at_start_ns = 0
        self._sent_alone_ns = 0
        """Time of the own transmissions that have ended in which nothing was sensed."""

    def occupy(self, from_ns: int, until_ns: int) -> None:
        """Sense the medium busy over an interval that begins now, or later by the propagation delay."""
        if from_ns > self.busy_until_ns:
            self.ended_busy_ns += self.busy_until_ns - self.busy_from_ns
            self.idle_before_ns = self.busy_until_ns
            self.busy_from_ns = from_ns
        elif from_ns < self.busy_from_ns:
            self.busy_from_ns = from_ns
        elif until_ns <= self.busy_until_ns:
            return
        if until_ns > self.busy_until_ns:
            self.busy_until_ns = until_ns
        if self.attentive:
            self.listener.on_busy(from_ns)

    def send(self, from_ns: int, until_ns: int) -> None:
        """Send from now on: what is being received is given up."""
        self.lock = None
        self._sending_from_ns = from_ns
        self.sending_until_ns = until_ns
        if self.busy_until_ns <= from_ns:
            # what `_sensed_ns` comes down to on an idle medium
            self._sensed_at_start_ns = self.ended_busy_ns + self.busy_until_ns - self.busy_from_ns
        else:
            self._sensed_at_start_ns = self._sensed_ns(from_ns)

    def sent(self) -> None:
        """Note that the own transmission is over, after it has ended everywhere."""
        if self.busy_until_ns <= self._sending_from_ns:
            self._sent_alone_ns += self.sending_until_ns - self._sending_from_ns
        else:
            self._sent_alone_ns += self._sending_alone_ns(self.sending_until_ns)
        self._sending_from_ns = self.sending_until_ns

    def surveyed_ns(self, at_ns: int) -> int:
        """Time up to ``at_ns``, which is now, for which the medium was sensed busy or the station sent."""
        return self._sensed_ns(at_ns) + self._sent_alone_ns + self._sending_alone_ns(at_ns)

    def _sensed_ns(self, at_ns: int) -> int:
        """Time up to ``at_ns`` for which the medium was sensed busy; the last but one period may be on."""
        if at_ns >= self.busy_from_ns:
            return self.ended_busy_ns + min(at_ns, self.busy_until_ns) - self.busy_from_ns
        return self.ended_busy_ns - max(0, self.idle_before_ns - at_ns)

    def _sending_alone_ns(self, at_ns: int) -> int:
        """Time up to ``at_ns`` of the own transmission under way in which nothing was sensed."""
        until_ns = min(at_ns, self.sending_until_ns)
        if until_ns <= self._sending_from_ns:
            return 0
        return until_ns - self._sending_from_ns - (self._sensed_ns(until_ns) - self._sensed_at_start_ns)
