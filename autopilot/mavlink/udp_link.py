"""A vehicle's link over UDP."""

from collections.abc import Callable

from autopilot.mavlink.codec import Encoder
from autopilot.mavlink.input_budget import InputBudget
from autopilot.mavlink.links import MavlinkLink
from autopilot.mavlink.signing import Signer
from autopilot.mavlink.udp_socket import Address, UdpSocket
from foundation.processes.socket_owners import DatagramOwners


class UdpLink(MavlinkLink[Address]):
    """A `MavlinkLink` with a UDP socket, which communicates, on this machine, only with trusted sockets."""

    def __init__(
        self,
        *,
        host: str,
        local_port: int,
        remote_port: int,
        encoder: Encoder,
        remote_host: str | None = None,
        signer: Signer | None = None,
        owners: DatagramOwners | None = None,
        budget: InputBudget | None = None,
        tap: Callable[[bytes], None] | None = None,
    ) -> None:
        """Bind ``host:local_port`` (0: any free port); the default partner is at ``remote_port`` (0: none).

        Its address is ``remote_host``, by default ``host``; both are IPv4 addresses. ``owners`` are those to
        be trusted; None: all. Raises OSError if the port is in use.
        """
        default = (remote_host or host, remote_port) if remote_port else None
        self._udp = UdpSocket(host, local_port, default=default, owners=owners)
        super().__init__(self._udp, encoder=encoder, signer=signer, budget=budget, tap=tap)

    @property
    def local_port(self) -> int:
        """The port that the link is bound to."""
        return self._udp.local_port

    def fileno(self) -> int:
        """Return the socket's descriptor, for select and poll."""
        return self._udp.fileno()

    def close(self) -> None:
        """Release the port."""
        self._udp.close()
