"""Radio client of an on-board application that runs as a process beside a PX4, outside the lockstep.

Transmissions are sent as soon as they arrive, as a guest's are: in such a swarm the channel is advanced in
every step. The same transport reports the phase of the flight to the simulator, which coflight's own
vehicles report on the simulator link.
"""

from collections.abc import Sequence

from autopilot.mavlink.codec import Encoder, Message
from autopilot.mavlink.components import APPLICATION_COMPONENT
from netsim.transport.asynchronous_radio import AsynchronousRadio
from netsim.transport.lockstep_radio import Deliveries
from netsim.transport.zenoh_session import Transport
from netsim.wire.messages import TxItem

SAID_LIMIT_S = 5.0
"""Wall time within which the simulator must acknowledge a report; nothing blocks on it."""


def said_key(run_id: str) -> str:
    """Key of the physics server's queryable for the applications' MAVLink frames, which carry the source."""
    return f"coflight/{run_id}/application/said"


class CompanionRadio:
    """A station's radio and the application's reports to the simulator. Close it; not thread-safe.

    Raises TransportError or RadioLost if the emulator cannot be reached.
    """

    def __init__(self, *, endpoint: str, run_id: str, station: int) -> None:
        deliveries = Deliveries()
        self.receive = deliveries.take
        """Returns the items visible at a time, in order of (time, source, sequence)."""
        self._encoder = Encoder(system=station + 1, component=APPLICATION_COMPONENT)
        self._transport = Transport.connect(endpoint)
        try:
            self._radio = AsynchronousRadio(
                self._transport, run_id=run_id, station=station, put=deliveries.put
            )
            self._reporter = self._transport.asker(said_key(run_id), timeout_s=SAID_LIMIT_S, lossy=True)
        except BaseException:
            self._transport.close()
            raise

    @property
    def malformed(self) -> int:
        """Count of messages on this station's key that were no valid delivery."""
        return self._radio.malformed

    def send(self, now_us: int, items: Sequence[TxItem]) -> None:
        """Submit transmissions and wait until the emulator has received them. Raises RadioLost."""
        self._radio.hand_over(items, now_us=now_us)

    def close(self) -> None:
        """Leave the channel; idempotent."""
        self._transport.close()

    def report(self, messages: Sequence[Message]) -> None:
        """Send messages to the simulator without waiting; a message with a source keeps it."""
        if messages:
            self._reporter.ask(b"".join(map(self._encoder.encode, messages)))
