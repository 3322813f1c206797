"""The channels that a run may have, as the emulator sees them: who sends through what, and how busy it is."""

from collections.abc import Callable
from typing import Protocol

from netsim.emulator.ideal_channel import IdealChannel
from netsim.mac.access import DCF, EDCA
from netsim.mac.jobs import FrameSender, OnGroupFrame, Upper
from netsim.mac.radios import Radios
from netsim.model.config import RadioConfig
from netsim.model.event_queue import EventQueue
from netsim.model.random_streams import RandomStreams
from netsim.model.tables import Integers
from netsim.phy.propagation import Links
from netsim.phy.signals import Transmission


class Channel(Protocol):
    """The radios of all stations; frames to all are told to whoever made it, the others to the stations."""

    def join(self, station: int, upper: Upper) -> FrameSender:
        """Add a station, whose own frames go to ``upper``; they come in the order of their numbers."""

    def busy_ns(self) -> int:
        """Time since the start for which the medium carried at least one signal."""

    def surveyed_ns(self) -> list[int]:
        """Time since the start for which each station sensed the medium busy or was itself sending."""

    def frames_sent(self) -> list[int]:
        """Frames that have ended, in the order of `netsim.phy.frames.FrameKind`."""

    def broadcasts(self) -> Integers:
        """Datagrams to all, (stations, 3): how many each has received, lost to collisions, and to noise."""

    def take_frames(self) -> Integers:
        """Frames that ended since the last call, in order of their end: see `records.FrameBook`."""


def channel_of(
    config: RadioConfig,
    *,
    queue: EventQueue,
    links: Links,
    stations: int,
    streams: RandomStreams,
    on_group_frame: OnGroupFrame,
    on_ended: Callable[[Transmission], None] | None,
) -> Channel:
    """Return the channel that the settings ask for.

    ``on_group_frame`` is told of the frames to all, and ``on_ended`` of every frame that has ended.
    """
    if config.channel == "ideal":
        return IdealChannel(
            config=config,
            queue=queue,
            links=links,
            stations=stations,
            on_group_frame=on_group_frame,
            on_ended=on_ended,
        )
    return Radios(
        config=config,
        access=EDCA if config.access == "edca" else dict.fromkeys(EDCA, DCF),
        queue=queue,
        links=links,
        stations=stations,
        streams=streams,
        on_group_frame=on_group_frame,
        on_ended=on_ended,
    )
