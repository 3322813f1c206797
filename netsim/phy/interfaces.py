"""Interfaces of the radio's models: path loss, shadowing, fading, packet errors and antenna pattern.

`netsim.radio_models.registry` creates them by the names in ``[radio]``; docs/how-to/radio-models.md shows a
model of one's own. All models are functions of their arguments, their settings and `RadioContext.generator`:
equal arguments give equal bytes in any order of calls, because link budgets are computed on demand and
cached. Arguments must not be changed. Times are simulated time in ns. Frames: world NED in metres from the
site's origin, body FRD.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np
from msgspec import Struct

from netsim.model.config import RadioConfig
from netsim.model.random_streams import Model, RandomStreams
from netsim.phy.modes import PhyMode
from netsim.phy.path_loss import Doubles


class PathLoss(Protocol):
    """Mean loss between isotropic antennas; consumer: `netsim.phy.path_gain.PathGain`.

    Transmit power, ``radio.antenna_gain_dbi`` and antenna patterns, shadowing, extra attenuation, blocked
    lines of sight and fading are applied by the consumer. Losses must be equal in both directions.
    """

    def loss_db(self, from_ned_m: Doubles, to_ned_m: Doubles, distance_m: Doubles) -> Doubles:
        """Return the losses (m, n) in dB from m positions to n, at least 0; infinity: nothing is received.

        ``from_ned_m`` (m, 3) and ``to_ned_m`` (n, 3) are positions; ``distance_m`` (m, n) is at least 1 m,
        also where the positions are closer. Entries of a station to itself may be any valid loss.
        """


class Shadowing(Protocol):
    """Variation of the mean received power with the positions; consumer: `netsim.phy.path_gain.PathGain`.

    It must be equal in both directions.
    """

    def gain_db(self, from_ned_m: Doubles, to_ned_m: Doubles, distance_m: Doubles) -> Doubles:
        """Return finite gains (m, n) in dB, positive for more power.

        Positions are as in `PathLoss.loss_db`; ``distance_m`` (m, n) has no least value.
        """


class AntennaPattern(Protocol):
    """Pattern of every station's antenna, without polarisation; consumer: `netsim.phy.path_gain.PathGain`."""

    def gain_db(self, direction_frd: Doubles) -> Doubles:
        """Return gains (m, n) in dB, relative to ``radio.antenna_gain_dbi``; minus infinity for nothing.

        ``direction_frd`` (m, n, 3) are unit vectors in the bodies' frames, from the m or n antennas to the
        other stations.
        """


class Fading(Protocol):
    """Small-scale fading of all links; consumer: `netsim.phy.fading.SampledFading`.

    Gains must be equal in both directions and a function of seed, pair and time. Call order: `move` with
    times that do not decrease; gains refer to times after the last `move`.
    """

    def gains(self, source: int, at_ns: int) -> Doubles:
        """Return the power gains (n,) of a frame that a station sends at ``at_ns``, linear and at least 0.

        Their mean over time should be 1. The station's own entry is ignored.
        """

    def move(self, at_ns: int, pos_ned_m: Doubles, vel_ned_m_s: Doubles) -> None:
        """Set positions (n, 3) at ``at_ns`` and velocities (n, 3) in m/s from then on."""


class ErrorModel(Protocol):
    """Losses of frames by noise; consumer: `netsim.phy.errors.PacketErrorModel`, which tabulates it.

    A hazard h is the loss rate per data bit: a frame of b bits at a constant ratio survives with probability
    exp(-h b), and hazards of chunks with different interference add.
    """

    def hazard(self, mode: PhyMode) -> Callable[[float], float]:
        """Return the hazard of one data bit, at least 0 and finite, as a function of the SNR in dB.

        The SNR is power over noise in the whole channel. The function is evaluated once per mode, from -10 dB
        upwards in steps of 0.05 dB to 45 dB or the first hazard below 1e-17, from where on it counts as 0.
        """


class RadioContext(Struct, frozen=True, kw_only=True):
    """What a model receives when it is created, as ``Class(context)``.

    With an attribute ``Settings``, a msgspec Struct or a dataclass, it is ``Class(context, settings)``; a
    class without a constructor is created without arguments.
    """

    config: RadioConfig
    """Settings of the radio, such as ``frequency_mhz``."""
    stations: int
    """Number of vehicles and guests, the n of positions and gains of all stations."""
    folder: Path
    """Folder of the scenario's file, to which paths in settings are relative."""
    streams: RandomStreams
    stream: Model

    def generator(self, *index: int) -> np.random.Generator:
        """Return a new random generator of this kind of model for a station, link or pair.

        It depends on the run's seed and ``index`` alone, not on the order of calls.
        """
        return self.streams.generator(self.stream, *index)
