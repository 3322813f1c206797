"""Interfaces of the radio's models: propagation, small-scale fading and packet errors.

The built-in models are `netsim.phy.path_gain.PathGain`, `netsim.phy.fading.RicianFading` and
`netsim.phy.errors.PublishedErrors`. All models are functions of their arguments and of the random streams
that their factory received: equal arguments give equal bytes in any order of calls, because link budgets are
computed on demand and cached. Times are simulated time in ns. Frames: world NED in metres.
"""

from collections.abc import Callable
from typing import Protocol

from netsim.model.config import RadioConfig
from netsim.model.random_streams import RandomStreams
from netsim.phy.modes import PhyMode
from netsim.phy.path_loss import Doubles


class Propagation(Protocol):
    """Mean gains and distances between positions; consumer: `netsim.phy.propagation.Links`.

    A gain is a linear power ratio, relative to isotropic antennas in free space at 1 m
    (`netsim.phy.path_loss.REFERENCE_DISTANCE_M`). Transmit power, ``radio.antenna_gain_dbi`` at both ends,
    extra attenuation, blocked lines of sight and fading are applied by the consumer.
    """

    @property
    def power_law_exponent(self) -> float | None:
        """Exponent e if every gain is max(distance, 1 m)^-e: a kernel then replaces `between_stations`.

        None: `between_stations` is called.
        """

    @property
    def uses_attitudes(self) -> bool:
        """Whether gains depend on attitudes; budgets are then computed again when an attitude changes."""

    def between_stations(
        self, sources: slice, pos_ned_m: Doubles, axes_ned: Doubles | None
    ) -> tuple[Doubles, Doubles]:
        """Return gains and distances in metres, both (m, n), from the m ``sources`` to all n stations.

        ``sources`` is `netsim.phy.path_gain.ALL` or a slice of station numbers; ``pos_ned_m`` (n, 3);
        ``axes_ned`` (n, 3) are the bodies' z axes, None unless `uses_attitudes`. Entries of a station to
        itself are ignored. Arguments must not be changed.
        """

    def from_others(
        self, from_ned_m: Doubles, to_ned_m: Doubles, to_axes_ned: Doubles | None
    ) -> tuple[Doubles, Doubles]:
        """Return gains and distances in metres, both (m, n), from m interferers to n stations.

        ``from_ned_m`` (m, 3); ``to_ned_m`` and ``to_axes_ned`` as in `between_stations`.
        """


class Fading(Protocol):
    """Small-scale fading of all links as a sum of waves; consumer: the kernel `netsim.phy.fading.gain`.

    The power gain of a link is |h|^2, where h is a line-of-sight amplitude plus waves that rotate with the
    link's phase theta (see `netsim.phy.fading`). The gain must be reciprocal and a function of seed, pair and
    time. Call order: `move` with times that do not decrease; gains refer to times after the last `move`.
    """

    @property
    def block(self) -> Doubles:
        """Data of the kernel, one array for the whole run, changed only by `move`.

        Shape (2 + n^2 (2 + 5 * SECTORS),): time of the last `move` in ns, line-of-sight amplitude, theta (n,
        n) in rad, its rate (n, n) in rad/ns, the waves' cosines (n, n, SECTORS) and weights (n, n, SECTORS,
        4).
        """

    def move(self, at_ns: int, pos_ned_m: Doubles, vel_ned_m_s: Doubles) -> None:
        """Set positions (n, 3) at ``at_ns`` and velocities (n, 3) in m/s from then on."""


class ErrorModel(Protocol):
    """Losses of frames by noise; consumer: `netsim.phy.errors.PacketErrorModel`, which tabulates it.

    A hazard h is the loss rate per data bit: a frame of b bits at a constant ratio survives with probability
    exp(-h b), and hazards of chunks with different interference add.
    """

    def hazard(self, mode: PhyMode) -> Callable[[float], float]:
        """Return the hazard of one data bit, positive and finite, as a function of the SNR in dB.

        The SNR is power over noise in the whole channel. The function is evaluated once per mode, from -10 dB
        upwards in steps of 0.05 dB to 45 dB or the first hazard below 1e-17, from where on it counts as 0.
        """


PropagationFactory = Callable[[RadioConfig, RandomStreams], Propagation]
"""Creates the propagation model from the settings; random values are drawn from the streams."""
FadingFactory = Callable[[RadioConfig, int, RandomStreams], Fading | None]
"""Creates the fading model for a number of stations; None: the settings exclude fading."""
