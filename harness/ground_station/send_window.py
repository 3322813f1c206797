"""Limits what a ground station's radio holds of its programs: few frames without an outcome, the rest waits.

A radio's queue keeps the oldest frames and drops new ones. While simulated time rests, it would fill with
what programs send first, and that would be on the air first. No I/O.
"""

from collections import deque

MOST_UNREPORTED = 16
"""Frames to one vehicle that the radio may hold without an outcome."""
MOST_WAITING = 64
"""Datagrams to one vehicle that wait for the radio; the oldest ones are dropped."""
OUTCOME_LIMIT_US = 1_000_000
"""Simulated time in excess of the queue's lifetime after which an outcome is not expected any more.

A frame leaves the queue within the lifetime, and its attempts, of milliseconds each, are few.
"""
_UNSTAMPED = -1


class SendWindow:
    """Datagrams to ``vehicles`` vehicles before the radio, and its frames without an outcome.

    ``queue_frames`` and ``queue_lifetime_us``, in simulated time, are those of the radio's queue, which is
    not filled further.
    """

    def __init__(self, vehicles: int, *, queue_frames: int, queue_lifetime_us: int) -> None:
        self._queue_frames = queue_frames
        self._outcome_limit_us = queue_lifetime_us + OUTCOME_LIMIT_US
        self._arrivals = 0
        self._waiting: dict[int, deque[tuple[int, bytes]]] = {}
        """Numbers of arrival and datagrams, by the vehicles for which any wait."""
        self._unreported: list[dict[int, int]] = [{} for _ in range(vehicles)]
        """By vehicle: times up to which outcomes are expected, by the frames' sequence numbers."""
        self._held = 0
        """Number of frames without an outcome."""
        self.overtaken = 0
        """Datagrams that were dropped because `MOST_WAITING` newer ones waited for the same vehicle."""

    def put(self, vehicle: int, datagram: bytes) -> None:
        """Add a datagram to a vehicle."""
        waiting = self._waiting.setdefault(vehicle, deque())
        self._arrivals += 1
        waiting.append((self._arrivals, datagram))
        if len(waiting) > MOST_WAITING:
            waiting.popleft()
            self.overtaken += 1

    def take(self) -> tuple[int, bytes] | None:
        """Return the vehicle and the content of the oldest datagram that the radio may have; None: none.

        `on_sent` is to be called before the next call.
        """
        if self._held >= self._queue_frames:
            return None
        free = [each for each in self._waiting if len(self._unreported[each]) < MOST_UNREPORTED]
        if not free:
            return None
        vehicle = min(free, key=lambda each: self._waiting[each][0])
        waiting = self._waiting[vehicle]
        _, datagram = waiting.popleft()
        if not waiting:
            del self._waiting[vehicle]
        return vehicle, datagram

    def on_sent(self, vehicle: int, seq: int) -> None:
        """Add a frame that is given to the radio."""
        self._unreported[vehicle][seq] = _UNSTAMPED
        self._held += 1

    def on_reported(self, vehicle: int, seq: int) -> None:
        """Remove a frame, whose outcome is known."""
        if self._unreported[vehicle].pop(seq, None) is not None:
            self._held -= 1

    def advance(self, now_us: int) -> None:
        """Release frames whose outcomes are lost; ``now_us`` is the simulated time of a delivery.

        The time of a frame counts from the first delivery after it on: without deliveries the station has no
        simulated time. Vehicles send all the time, so a station in range of any has deliveries.
        """
        for frames in self._unreported:
            for seq, until_us in list(frames.items()):
                if until_us == _UNSTAMPED:
                    frames[seq] = now_us + self._outcome_limit_us
                elif now_us > until_us:
                    del frames[seq]
                    self._held -= 1
