"""What an application is given: number, places, site, generator, radio and autopilot of its UAV. No I/O."""

from collections.abc import Iterator
from itertools import count
from operator import index

import numpy as np
from msgspec.structs import replace

from autopilot.onboard.client.autopilot_client import AutopilotClient
from autopilot.onboard.formation_plan import FormationPlan
from autopilot.parameters.config import AutopilotKind, Devices, Site
from netsim.wire.messages import (
    DEFAULT_PORT,
    MAX_PAYLOAD_BYTES,
    MAX_STATION,
    Broadcast,
    Delivery,
    FtmRequest,
    FtmResult,
    RxItem,
    Sent,
    TxItem,
    Unicast,
)

MOST_ITEMS = 10_000
"""Transmissions of one iteration; an application that submits more has failed."""
MOST_WARNINGS = 10
"""Warnings of one iteration, likewise."""


class Radio:
    """The radio of one UAV as one of its programs uses it: collects the transmissions of an iteration.

    Datagrams are sent to, and received at, the program's UDP port.

    Times ``at_us`` are when the application passes the item to its host's stack: from the present iteration
    until the next one; None: at once. All methods raise ValueError or TypeError for an item that cannot be
    sent, and return its sequence number, which the item's result carries.
    """

    def __init__(
        self, *, station: int, stations: int, loop_us: int, port: int = DEFAULT_PORT, program: int = 0,
        programs: int = 1,
    ) -> None:  # fmt: skip
        """``program`` is the number of the program among the ``programs`` of the UAV, from 0."""
        self.station, self.stations = station, stations
        """The own station number, which is the UAV's, and the number of UAVs."""
        self.now_us = 0
        """Time of the present iteration."""
        self._loop_us = loop_us
        self.port = port
        self._program, self._programs = program, programs
        # sequence numbers of a UAV's programs alternate, so that each result belongs to one
        self._numbers: Iterator[int] = count(program, programs)
        self._items: list[TxItem] = []

    def broadcast(self, payload: bytes, *, at_us: int | None = None) -> int:
        """Send a datagram of at most 1472 bytes to every station in range; it is not acknowledged."""
        self._check_payload(payload)
        time_us = self._time_us(at_us)
        return self._submit(
            Broadcast(seq=next(self._numbers), at_us=time_us, payload=payload, port=self.port)
        )

    def unicast(self, destination: int, payload: bytes, *, at_us: int | None = None) -> int:
        """Send a datagram to one station, acknowledged and repeated; `Sent` reports the outcome."""
        self._check_payload(payload)
        station, time_us = self._station("destination", destination), self._time_us(at_us)
        return self._submit(
            Unicast(
                seq=next(self._numbers), at_us=time_us, destination=station, payload=payload, port=self.port
            )
        )

    def range_to(self, peer: int, *, at_us: int | None = None) -> int:
        """Start a ranging session (FTM) with a UAV; `FtmResult` reports its distance."""
        station, time_us = self._station("peer", peer), self._time_us(at_us)
        return self._submit(FtmRequest(seq=next(self._numbers), at_us=time_us, peer=station))

    def is_for(self, item: RxItem) -> bool:
        """Whether what the radio received or measured is for this program."""
        match item:
            case Delivery():
                return item.port == self.port
            case FtmResult() | Sent():
                return item.seq % self._programs == self._program
        return True

    def take(self) -> tuple[TxItem, ...]:
        """Return the collected transmissions and forget them.

        Those of calls since the last iteration are sent at the present one.
        """
        if not self._items:
            return ()
        items, self._items, now_us = self._items, [], self.now_us
        return tuple([item if item.at_us >= now_us else replace(item, at_us=now_us) for item in items])

    def _submit(self, item: Broadcast | Unicast | FtmRequest) -> int:
        if len(self._items) >= MOST_ITEMS:
            raise ValueError(f"more than {MOST_ITEMS} transmissions in one iteration of the loop")
        self._items.append(item)
        return item.seq

    def _time_us(self, at_us: int | None) -> int:
        if at_us is None:
            return self.now_us
        if not self.now_us <= at_us <= self.now_us + self._loop_us:
            raise ValueError(
                f"at_us: {at_us}; expected {self.now_us} to {self.now_us + self._loop_us}, the next iteration"
            )
        return index(at_us)

    def _station(self, name: str, number: int) -> int:
        """Return the number of another station as Python's int."""
        if not 0 <= number <= MAX_STATION or number == self.station:
            raise ValueError(f"{name}: {number!r}; expected the number of another station")
        return index(number)

    @staticmethod
    def _check_payload(payload: bytes) -> None:
        if type(payload) is not bytes:
            raise TypeError(f"payload: {type(payload).__name__}; expected bytes")
        if len(payload) > MAX_PAYLOAD_BYTES:
            raise ValueError(f"payload: {len(payload)} bytes; expected at most {MAX_PAYLOAD_BYTES}")


class Context:
    """What one application may use; valid from `Application.start` on.

    Attributes:
        uav: number of the UAV, 0 to ``len(places_ned_m) - 1``; its MAVLink system id is one more.
        places_ned_m: (N, 3) places of the scenario's formation, site NED, read-only; the UAVs start on level
            ground below them.
        plan: these places over time, if the scenario's formation moves.
        site: origin of the site's frame.
        devices: data-sheet values of the GPS receiver and the radio.
        loop_period_us: period of `Application.on_timer`.
        rng: random generator; it depends on the run's seed, the UAV and the program only.
        radio: the UAV's radio, at the program's port.
        autopilot: the UAV's autopilot.
        autopilot_kind: which program it is.

    """

    def __init__(
        self, *, uav: int, plan: FormationPlan, site: Site, devices: Devices, loop_period_us: int,
        rng: np.random.Generator, radio: Radio, autopilot: AutopilotClient,
        autopilot_kind: AutopilotKind = "own",
    ) -> None:  # fmt: skip
        self.uav = uav
        self.places_ned_m = plan.at(0.0).pos_ned_m
        self.plan = plan
        self.site = site
        self.devices = devices
        self.loop_period_us = loop_period_us
        self.rng = rng
        self.radio = radio
        self.autopilot = autopilot
        self.autopilot_kind = autopilot_kind
        self.needs_truth = False
        self._warnings: list[str] = []

    def warn(self, text: str) -> None:
        """Send a text (ASCII) to ground stations as a STATUSTEXT of severity warning.

        Raises ValueError for more than `MOST_WARNINGS` in one iteration.
        """
        if len(self._warnings) >= MOST_WARNINGS:
            raise ValueError(f"more than {MOST_WARNINGS} warnings in one iteration of the loop")
        self._warnings.append(str(text))

    def take_warnings(self) -> list[str]:
        """Return the collected warnings and forget them."""
        warnings, self._warnings = self._warnings, []
        return warnings

    def request_truth(self) -> None:
        """Request the simulator's true state as HIL_STATE_QUATERNION, for references that no vehicle has.

        To be called in `Application.start`. Raises ValueError beside a PX4 or ArduPilot, which do not pass it
        on.
        """
        if self.autopilot_kind != "own":
            raise ValueError(f"request_truth: {self.autopilot_kind} does not pass the true state on")
        self.needs_truth = True
