"""The on-board program: joins the protocol and the radio, and reports."""

from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import Annotated

from msgspec import Meta, Struct

from coflight import Application, Context, Delivery, Reports, Sent, Status
from token_ring.protocol import Ring, Timing, Token, decode


class Phase(IntEnum):
    """Whether the UAV has the token."""

    WAITING = 0
    HOLDING = 1


class Settings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the program in the scenario."""

    hold_ms: Annotated[int, Meta(ge=0, le=10_000)] = 80
    """Time for which a UAV keeps the token."""
    pass_ms: Annotated[int, Meta(ge=10, le=10_000)] = 160
    """Longest time from passing the token until the sender has its outcome and the receiver its iteration."""


class TokenRing(Application):
    """One station of the ring."""

    Settings = Settings
    reports = Reports(phases=Phase, values=("rounds", "turns", "regenerated", "ignored"))

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._bad_tokens = 0
        self._awaited: int | None = None
        """Sequence number of the unicast whose outcome is awaited."""

    def start(self, context: Context) -> None:
        """Create the station; all UAVs of the swarm are stations."""
        self._radio = context.radio
        timing = Timing(
            stations=len(context.places_ned_m), hold_us=1_000 * self._settings.hold_ms,
            pass_us=1_000 * self._settings.pass_ms,
        )  # fmt: skip
        self._ring = Ring(context.uav, timing)

    def on_radio(self, items: Iterable[object], now_us: int) -> None:
        """Process tokens and outcomes."""
        for item in items:
            if isinstance(item, Delivery):
                token = decode(item.payload)
                if token is None:
                    self._bad_tokens += 1
                else:
                    self._ring.on_token(token, now_us)
            elif isinstance(item, Sent) and item.seq == self._awaited:
                self._awaited = None
                received = item.status == "acknowledged"
                self._send(self._ring.on_outcome(item.destination, now_us, acknowledged=received))

    def on_timer(self, now_us: int) -> None:
        """Run the protocol."""
        self._send(self._ring.on_timer(now_us))

    def status(self) -> Status:
        """Return whether it holds the token, and counts."""
        ring = self._ring
        values = {
            "rounds": ring.rounds, "turns": ring.turns,
            "regenerated": ring.regenerated, "ignored": ring.ignored,
        }  # fmt: skip
        return Status(Phase.HOLDING if ring.holds else Phase.WAITING, values=values)

    def troubles(self) -> Mapping[str, int]:
        """Return the number of datagrams that are no tokens."""
        return {"bad_tokens": self._bad_tokens}

    def _send(self, unicast: tuple[int, Token] | None) -> None:
        if unicast is not None:
            destination, token = unicast
            self._awaited = self._radio.unicast(destination, token.encode())
