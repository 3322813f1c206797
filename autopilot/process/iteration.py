"""Messages between the simulator and an on-board application beside a PX4: one iteration of its loop.

The socket between the two is inherited from the launcher (`foundation.processes.message_stream`). The
simulator requests an iteration at the multiples of the loop's period, while the autopilots compute the step
of that time, and waits for the results before it sends the next sensors.
"""

from typing import Annotated

from msgspec import Meta, Struct

APPLICATION = "application"
"""First argument of a forked process that is an application; without it, it is a vehicle."""
TimeUs = Annotated[int, Meta(ge=0, le=2**53)]


class Iterate(Struct, frozen=True, kw_only=True, array_like=True):
    """Run the iteration that begins at ``time_us``."""

    time_us: TimeUs
    released_us: TimeUs = 0
    """Release time of the newest batch that the radio delivers; 0: there is none since the last request."""
    readings: bytes = b""
    """MAVLink frames of the scenario's own sensors that are connected to the application."""


class Iterated(Struct, frozen=True, kw_only=True, array_like=True):
    """The requested iteration has ended."""

    handed_over: bool
    """The application has sent a batch to its radio."""
    reports: bytes = b""
    """MAVLink frames for the simulator: the autopilot's mode, the application's phase and start of motion."""
