"""Settings of the process of a ground station."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

from autopilot.parameters.config import Port
from netsim.wire.messages import Station


class GroundStationConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of one ground station's process, written by the launcher."""

    name: str
    """Name of the process in its events."""
    run_id: str
    endpoint: str
    """Zenoh endpoint of the emulator."""
    user: str
    """Zenoh user."""
    password: str
    station: Station
    answer_limit_s: float
    """Wall time within which the emulator acknowledges transmissions; longer than the run waits for it."""
    local_ports: Annotated[tuple[Port, ...], Meta(min_length=1)]
    """UDP port for each vehicle; 0: any free one."""
    host: str
    """Address to which they are bound."""
    remote_host: str
    """Address of the program that is sent to without having sent anything."""
    remote_port: Port
    """Its port; 0: there is none."""
    queue_frames: int
    """Length of the radio's queue: ``radio.queue_frames``."""
    queue_lifetime_us: int
    """Simulated time after which the radio drops a queued frame: ``radio.queue_lifetime_us``."""
    serial_modems: bool = False
    """Whether the station has a serial modem for each vehicle, in place of an 802.11 radio."""
    local_senders: Literal["own", "any"] = "own"
    """See `autopilot.parameters.config.LinksConfig`."""
