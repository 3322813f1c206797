"""The interface of a channel, and the choice between the emulated and the ideal one."""

from collections.abc import Callable
from typing import Protocol

from netsim.emulator.ideal_channel import IdealChannel
from netsim.mac.jobs import FrameSender, OnGroupFrame, Upper
from netsim.mac.radios import Radios
from netsim.model.config import RadioConfig
from netsim.model.event_queue import EventQueue
from netsim.model.random_streams import RandomStreams
from netsim.model.tables import Integers
from netsim.phy.frames import Transmission
from netsim.phy.propagation import Links


class Channel(Protocol):
    """The radios of all stations; received group frames go to a callback, unicast frames to the stations."""

    def join(self, station: int, upper: Upper) -> FrameSender:
        """Add the next station, in the order of their numbers; its unicast frames go to ``upper``."""

    def busy_ns(self) -> int:
        """Return the time since the start for which the medium carried at least one signal."""

    def surveyed_ns(self) -> list[int]:
        """Return the time since the start, by station, for which it sensed the medium busy or was sending."""

    def frames_sent(self) -> list[int]:
        """Return the number of ended frames by kind, in the order of `netsim.phy.frames.FrameKind`."""

    def broadcasts(self) -> Integers:
        """Return broadcast datagrams (stations, 3): received, lost to collisions, lost to noise."""

    def take_frames(self) -> Integers:
        """Return the frames that ended since the last call, in order of their end: see `FrameBook.take`."""


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
    """Return the channel selected by ``config.channel``.

    ``on_group_frame`` is called with received group frames, ``on_ended`` with every frame that has ended.
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
        queue=queue,
        links=links,
        stations=stations,
        streams=streams,
        on_group_frame=on_group_frame,
        on_ended=on_ended,
    )
