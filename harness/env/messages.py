"""Messages between an environment, its server and the processes of its episodes."""

from msgspec import Struct


class Ready(Struct, frozen=True, tag="ready"):
    """The swarm hovers; episodes can be forked."""

    hover_s: float
    """Simulated time of the flight until then."""


class Failed(Struct, frozen=True, tag="failed"):
    """The server has failed; ``text`` is one line."""

    text: str


class Fork(Struct, frozen=True, tag="fork"):
    """Request for an episode, sent with its socket."""

    seed: int


class Forked(Struct, frozen=True, tag="forked"):
    """The episode's process."""

    pid: int


class Reap(Struct, frozen=True, tag="reap"):
    """Request for the end of a process."""

    pid: int


class Ended(Struct, frozen=True, tag="ended"):
    """How it has ended."""

    returncode: int
    """Exit status, or minus the signal that killed it."""


class Step(Struct, frozen=True):
    """Actions of one period."""

    actions: bytes
    """(N, A) float64; NaN in a row's first: hold the place."""


class Stepped(Struct, frozen=True):
    """State after it."""

    time_us: int
    observations: bytes
    """(N, O) float32, within their bounds."""
    truth: bytes
    """(N, 6) float64: true position and velocity, NED."""
    ended: dict[int, str]
    """Reasons of the UAVs that have ended in this period."""


class Reply(Struct, frozen=True):
    """What an episode answers."""

    stepped: Stepped | None
    failure: str = ""
    """One line, if it has failed."""


ToServer = Fork | Reap
FromServer = Ready | Failed | Forked | Ended
