"""What on-board applications beside PX4s tell the simulator, by way of the radio's Zenoh router.

Imported where a PX4 flies and nowhere else, for Zenoh is large.
"""

import contextlib
from collections.abc import Iterator

from autopilot.mavlink.codec import Parser
from autopilot.process.companion_radio import said_key
from harness.simulator.lockstep import Lockstep
from netsim.transport.zenoh_session import Question, Transport


@contextlib.contextmanager
def overheard(radio_endpoint: str, run_id: str, lockstep: Lockstep) -> Iterator[None]:
    """Pass on what applications say of themselves and their PX4s. Raises TransportError."""

    def hear(question: Question) -> None:  # in a thread of Zenoh's
        for message in Parser().push_datagram(question.payload):
            instance = message.get_srcSystem() - 1
            if 0 <= instance < len(lockstep.seats):
                lockstep.overhear(instance, message)
        question.answer(b"")

    with contextlib.closing(Transport.connect(radio_endpoint)) as transport:
        transport.serve(said_key(run_id), hear)
        yield
