"""What the processes of a run report to its owner, and the errors that end it."""

from collections.abc import Mapping

from msgspec import Struct

from foundation.processes.child_protocol import Warned
from harness.launch.kernel_cache import CompileProgress
from harness.launch.supervisor import ChildMessage, Exited
from harness.simulator.messages import AnyEvent
from netsim.network.messages import ProgramEnded


class ProcessNotice(Struct, frozen=True, kw_only=True):
    """A message of the launcher itself: a warning, or what it does before an operation that takes long."""

    text: str


class Compiling(Struct, frozen=True, kw_only=True):
    """Kernels that are being compiled before the flight, by package."""

    packages: Mapping[str, CompileProgress]


Message = ChildMessage | Exited | ProcessNotice | Compiling
RunEvent = AnyEvent | Warned | Exited | ProgramEnded


class SwarmError(Exception):
    """The swarm cannot fly or continue; the text is one line for the user."""


class SetupError(SwarmError):
    """The swarm could not be started: a port, a folder or another resource is not available."""


class SwarmTimeoutError(SwarmError):
    """A condition was not met in time."""
