"""The channels that a run may have, as the emulator sees them: who sends through what, and how busy it is."""

from collections.abc import Callable
from typing import Protocol

from netsim.config import RadioConfig
from netsim.ideal import IdealChannel
from netsim.kernel import EventQueue
from netsim.mac.access import DCF, EDCA, AccessParameters
from netsim.mac.jobs import Sender
from netsim.mac.station import Station, Upper
from netsim.phy.medium import Medium, Transmission
from netsim.phy.modes import phy_mode
from netsim.phy.propagation import Links
from netsim.streams import Model, Streams, Uniforms


class Channel(Protocol):
    """The radios of all stations."""

    def join(self, station: int, upper: Upper) -> Sender:
        """Add a station, whose received frames go to ``upper``; they come in the order of their numbers."""

    def busy_ns(self) -> int:
        """Time since the start for which the medium carried at least one signal."""

    def surveyed_ns(self, station: int, /) -> int:
        """Time since the start for which a station sensed the medium busy or was itself sending."""


class EmulatedChannel:
    """Stations that contend for one medium."""

    def __init__(
        self,
        *,
        config: RadioConfig,
        queue: EventQueue,
        links: Links,
        stations: int,
        streams: Streams,
        on_ended: Callable[[Transmission], None],
    ) -> None:
        self._config = config
        self._queue = queue
        self._streams = streams
        self._access: dict[str, AccessParameters] = (
            EDCA if config.access == "edca" else dict.fromkeys(EDCA, DCF)
        )
        self._medium = Medium(
            config=config, queue=queue, links=links, stations=stations, streams=streams, on_ended=on_ended
        )

    def join(self, station: int, upper: Upper) -> Station:
        """See `Channel`."""
        config = self._config
        return Station(
            index=station,
            queue=self._queue,
            medium=self._medium,
            access=self._access,
            control_mode=phy_mode(config.control_mode, config.bandwidth_mhz),
            queue_frames=config.queue_frames,
            backoff=Uniforms(self._streams.generator(Model.BACKOFF, station)),
            upper=upper,
        )

    def busy_ns(self) -> int:
        """See `Channel`."""
        return self._medium.busy_ns()

    def surveyed_ns(self, station: int) -> int:
        """See `Channel`."""
        return self._medium.receivers[station].surveyed_ns(self._queue.now_ns)


def channel_of(
    config: RadioConfig,
    *,
    queue: EventQueue,
    links: Links,
    stations: int,
    streams: Streams,
    on_ended: Callable[[Transmission], None],
) -> Channel:
    """Return the channel that the settings ask for."""
    if config.channel == "ideal":
        return IdealChannel(config=config, queue=queue, links=links, on_ended=on_ended)
    return EmulatedChannel(
        config=config, queue=queue, links=links, stations=stations, streams=streams, on_ended=on_ended
    )
