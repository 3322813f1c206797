"""The radio of an on-board application that is a process beside its autopilot, outside the lockstep.

What it sends goes on the air when it comes, as a guest's does: the channel is asked to go on in every step of
such a swarm. On the same way the application tells the simulator how far its flight is, which vehicles of
coflight's own say on the simulator's link.
"""

from collections.abc import Sequence

from autopilot.mavlink.codec import Encoder, Message
from autopilot.mavlink.components import APPLICATION_COMPONENT
from netsim.transport.asynchronous_radio import AsynchronousRadio
from netsim.transport.lockstep_radio import Deliveries
from netsim.transport.zenoh_session import Transport
from netsim.wire.messages import TxItem

SAID_LIMIT_S = 5.0
"""Wall time that the simulator has to acknowledge; nobody waits for it."""


def said_key(run_id: str) -> str:
    """Served by the physics server: MAVLink frames of the applications, which carry whose they are."""
    return f"coflight/{run_id}/application/said"


class CompanionRadio:
    """A station's radio, and its application's word to the simulator. Close it; for one thread.

    Raises TransportError or RadioLost if the emulator cannot be reached.
    """

    def __init__(self, *, endpoint: str, run_id: str, station: int) -> None:
        deliveries = Deliveries()
        self.receive = deliveries.take
        """What may be seen at a time, in order of (time, source, sequence)."""
        self._encoder = Encoder(system=station + 1, component=APPLICATION_COMPONENT)
        self._transport = Transport.connect(endpoint)
        try:
            self._radio = AsynchronousRadio(
                self._transport, run_id=run_id, station=station, put=deliveries.put
            )
            self._sayer = self._transport.asker(said_key(run_id), timeout_s=SAID_LIMIT_S, lossy=True)
        except BaseException:
            self._transport.close()
            raise

    @property
    def malformed(self) -> int:
        """Count of what came in on this station's key and was no delivery."""
        return self._radio.malformed

    def send(self, now_us: int, items: Sequence[TxItem]) -> None:
        """Hand over transmissions and wait until the emulator has them. Raises RadioLost."""
        self._radio.hand_over(items, now_us=now_us)

    def close(self) -> None:
        """Leave the channel; harmless when repeated."""
        self._transport.close()

    def tell(self, messages: Sequence[Message]) -> None:
        """Tell the simulator, without waiting; each message with its source, if it has one."""
        if messages:
            self._sayer.ask(b"".join(map(self._encoder.encode, messages)))
