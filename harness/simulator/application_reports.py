"""Reports of on-board applications beside PX4s to the simulator, through the radio's Zenoh router.

Imported only where a PX4 flies, because Zenoh is large.
"""

import contextlib
from collections.abc import Iterator

from autopilot.mavlink.codec import Parser
from autopilot.process.companion_radio import said_key
from harness.simulator.lockstep import Lockstep
from netsim.transport.zenoh_session import Question, Transport


@contextlib.contextmanager
def relayed(radio_endpoint: str, run_id: str, lockstep: Lockstep) -> Iterator[None]:
    """Relay the applications' reports on themselves and their PX4s. Raises TransportError."""

    def on_report(question: Question) -> None:  # in a thread of Zenoh's
        for message in Parser().push_datagram(question.payload):
            instance = message.get_srcSystem() - 1
            if 0 <= instance < len(lockstep.slots):
                lockstep.enqueue(instance, message)
        question.answer(b"")

    with contextlib.closing(Transport.connect(radio_endpoint)) as transport:
        transport.serve(said_key(run_id), on_report)
        yield
