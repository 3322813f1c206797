"""The interface of a network emulator behind the messages of `netsim.wire`.

Consumers: `netsim.transport.server` over sockets and Zenoh, `harness.simulator.in_process_links` by calls.
The built-in emulator is `netsim.emulator.service.EmulatorService`.
"""

from collections.abc import Callable
from typing import Any, Protocol

from netsim.emulator.packets import PacketReception
from netsim.wire.lockstep import Advance, Advanced
from netsim.wire.messages import RxBatch, Station, TxBatch
from netsim.wire.packets import SentPacket


class NetworkEmulator(Protocol):
    """All radios of a run in lockstep with the simulation.

    Stations 0..vehicles-1 are vehicles, the following ones guests (`is_guest`). Call order: `open_logs` once;
    then for each interval any number of `submit`, `missing` until it is empty, `advance`, `advanced`; at the
    end `close`. `submit` may be called from any thread, all other methods from one.

    A run with packets of network interfaces replaces `advance` by `begin`, any number of `run_until` up to
    the interval's end, with `submit_packet`, `take_packets` and `take_ended` between them, and `end`. Those
    between `begin` and `end` are called from two threads, one at a time.

    Simulated time is the only clock, in us; it is given by `Advance` and never decreases. Equal settings,
    seeds, batches and intervals give equal deliveries, in whatever order the batches of an interval arrive.
    Guests are exempt: their traffic is not simulated.
    """

    @property
    def stations(self) -> int:
        """Number of vehicles and guests."""

    @property
    def reached_us(self) -> int:
        """Time up to which the channel has been simulated; 0 before the first interval."""

    @property
    def counters(self) -> dict[str, Any]:
        """Counters of the run by name, as values that JSON can hold, for the manifest."""

    def open_logs(self) -> None:
        """Create the log files named in the settings. Raises OSError."""

    def close(self) -> None:
        """Write the rest of the logs and close them; repeated calls have no effect."""

    def is_guest(self, station: Station) -> bool:
        """Whether the station's host is an external program."""

    def submit(self, batch: TxBatch) -> bool:
        """Store a batch until its interval; return False if the station is unknown or the time invalid.

        A vehicle's batch must not be more than `netsim.wire.lockstep.LEAD_US` ahead of `reached_us`.
        """

    def missing(self, request: Advance) -> set[Station]:
        """Return the senders of an interval, silent ones excepted, that have not submitted their batches."""

    def advance(self, request: Advance) -> dict[Station, RxBatch]:
        """Simulate up to ``request.to_us`` and return the deliveries by station, none for silent stations.

        The request holds positions (n, 3) in m, velocities (n, 3) in m/s (world NED) and attitudes (n, 4),
        Hamilton wxyz FRD to NED, of all vehicles at ``request.at_us``. Items of a delivery are in order of
        (time, source, sequence number). Raises ValueError for an invalid request.
        """

    def begin(self, request: Advance) -> None:
        """Begin an interval: `advance` is `begin`, `run_until` the interval's end, and `end`.

        Raises ValueError for an invalid request.
        """

    def run_until(self, time_ns: int) -> None:
        """Simulate up to and including ``time_ns``, simulated time within the interval."""

    def end(self, request: Advance) -> dict[Station, RxBatch]:
        """End the interval, which is simulated completely; return the deliveries as `advance`."""

    @property
    def next_event_ns(self) -> int:
        """Simulated time before which nothing happens without further submissions; 2**61 or more: never."""

    def submit_packet(self, packet: SentPacket, at_ns: int) -> bool:
        """Queue a packet at its sender at simulated time ``at_ns``, or now if that is in the past.

        Returns False unless the sender is a vehicle. Packets of a vehicle and time keep their order.
        """

    def take_packets(self) -> list[PacketReception]:
        """Return the packets received since the last call, in order of their end."""

    def take_ended(self) -> dict[Station, int]:
        """Return the numbers of packets that have left the queues since the last call, by sender.

        Every submitted packet is counted once, whether it was sent or dropped.
        """

    def advanced(self, *, delivered: tuple[Station, ...] = (), missing: tuple[Station, ...] = ()) -> Advanced:
        """Return the reply to the time master after `advance`, or instead of it if senders are missing.

        ``quiet_until_us`` of the reply is a time before which nothing happens unless a station sends: the
        time master skips intervals until then.
        """

    def set_between_events(self, function: Callable[[], object] | None) -> None:
        """Set a function that is called between events, to yield the processor; None removes it.

        An emulator without events may ignore it.
        """
