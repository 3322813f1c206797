"""Where stations are and what a frame loses on its way: path loss, shadowing, fading and delay."""

from math import hypot, log10, pi, sqrt

import numpy as np
from msgspec import Struct

from netsim.config import RadioConfig
from netsim.streams import Model, Streams

SPEED_OF_LIGHT_M_S = 299_792_458.0
BOLTZMANN_J_K = 1.380649e-23
REFERENCE_TEMPERATURE_K = 290.0
REFERENCE_DISTANCE_M = 1.0
ROW_LIFETIME_NS = 4_000_000
"""A moving station's link budget is computed afresh after this: at 20 m/s it has moved 8 cm."""
AUDIBLE_BELOW_NOISE = 0.01
"""Signals more than 20 dB below the noise do not matter to anybody."""

Vector = tuple[float, float, float]


def thermal_noise_mw(bandwidth_mhz: float, noise_figure_db: float) -> float:
    """Noise power k T B F at the receiver's input, in milliwatt."""
    return (
        BOLTZMANN_J_K
        * REFERENCE_TEMPERATURE_K
        * bandwidth_mhz
        * 1e9
        * float(10.0 ** (noise_figure_db / 10.0))
    )


def friis_loss_db(distance_m: float, frequency_mhz: float) -> float:
    """Free-space path loss between isotropic antennas."""
    return 20.0 * log10(4.0 * pi * distance_m * frequency_mhz * 1e6 / SPEED_OF_LIGHT_M_S)


class Trajectories:
    """Positions of the stations, going on at the velocity of the last known instant. World NED, metres."""

    __slots__ = ("_at_ns", "_pos_ned_m", "_vel_ned_m_s", "moving", "version")

    def __init__(self, stations: int) -> None:
        self._at_ns = 0
        self._pos_ned_m: list[Vector] = [(0.0, 0.0, 0.0)] * stations
        self._vel_ned_m_s: list[Vector] = [(0.0, 0.0, 0.0)] * stations
        self.moving = False
        self.version = 0
        """Rises whenever positions may have changed otherwise than by the motion announced before."""

    def set(self, at_ns: int, pos_ned_m: list[Vector], vel_ned_m_s: list[Vector]) -> None:
        """State where the stations are at ``at_ns``, and how fast they go on from there."""
        moving = any(map(any, vel_ned_m_s))
        if moving or self.moving or pos_ned_m != self._pos_ned_m:
            self.version += 1
        self.moving = moving
        self._at_ns, self._pos_ned_m, self._vel_ned_m_s = at_ns, pos_ned_m, vel_ned_m_s

    def positions_ned_m(self, at_ns: int) -> list[Vector]:
        """Where all stations are, by station."""
        if not self.moving:
            return self._pos_ned_m
        dt_s = (at_ns - self._at_ns) * 1e-9
        return [
            (x + dt_s * vx, y + dt_s * vy, z + dt_s * vz)
            for (x, y, z), (vx, vy, vz) in zip(self._pos_ned_m, self._vel_ned_m_s, strict=True)
        ]

    def distance_m(self, a: int, b: int, at_ns: int) -> float:
        """Distance between two stations."""
        dt_s = (at_ns - self._at_ns) * 1e-9
        (xa, ya, za), (xb, yb, zb) = self._pos_ned_m[a], self._pos_ned_m[b]
        (ua, va, wa), (ub, vb, wb) = self._vel_ned_m_s[a], self._vel_ned_m_s[b]
        return hypot(xa - xb + dt_s * (ua - ub), ya - yb + dt_s * (va - vb), za - zb + dt_s * (wa - wb))

    def delay_ps(self, a: int, b: int, at_ns: int) -> int:
        """Propagation time between two stations, in picoseconds."""
        return round(self.distance_m(a, b, at_ns) / SPEED_OF_LIGHT_M_S * 1e12)


class LinkRow(Struct, frozen=True):
    """What one station's transmissions are at every other, by station; the station's own entry is zero."""

    powers_mw: list[float]
    """Mean received power, before fading."""
    delays_ns: list[int]
    longest_delay_ns: int
    """To the stations that can hear anything at all."""


class Links:
    """Link budgets of all pairs, computed row by row when somebody transmits and kept while nobody moves."""

    def __init__(
        self, config: RadioConfig, trajectories: Trajectories, stations: int, streams: Streams
    ) -> None:
        self._config = config
        self._trajectories = trajectories
        self._stations = stations
        self._exponent = config.path_loss_exponent
        self._extra_db = config.extra_attenuation_db
        self._audible_mw = AUDIBLE_BELOW_NOISE * thermal_noise_mw(
            config.bandwidth_mhz, config.noise_figure_db
        )
        self._rows: list[LinkRow | None] = [None] * stations
        self._row_ns = [0] * stations
        self._row_version = [-1] * stations
        shadowing_db = np.zeros((stations, stations))
        if config.shadowing_std_db > 0.0:
            for a in range(stations):
                for b in range(a):
                    draw = streams.generator(Model.SHADOWING, b, a).normal(0.0, config.shadowing_std_db)
                    shadowing_db[a, b] = shadowing_db[b, a] = draw
        self._shadowing_db = shadowing_db
        self._gains: list[list[float]] = []
        self._update_gains()

    def set_extra_attenuation_db(self, value: float | None) -> None:
        """Attenuation on every link from now on; None is the configured one."""
        extra_db = self._config.extra_attenuation_db if value is None else value
        if extra_db != self._extra_db:
            self._extra_db = extra_db
            self._update_gains()

    def _update_gains(self) -> None:
        at_reference_dbm = (
            self._config.tx_power_dbm
            + 2.0 * self._config.antenna_gain_dbi
            - friis_loss_db(REFERENCE_DISTANCE_M, self._config.frequency_mhz)
            - self._extra_db
        )
        self._gains = (10.0 ** ((at_reference_dbm - self._shadowing_db) / 10.0)).tolist()
        self._rows = [None] * self._stations

    def row(self, source: int, at_ns: int) -> LinkRow:
        """Link budget from ``source``: P(d) = P(1 m) (d / 1 m)^-exponent; nearer than 1 m that of 1 m."""
        row = self._rows[source]
        version = self._trajectories.version
        if (
            row is not None
            and version == self._row_version[source]
            and not (self._trajectories.moving and at_ns - self._row_ns[source] > ROW_LIFETIME_NS)
        ):
            return row
        places_ned_m = self._trajectories.positions_ned_m(at_ns)
        x0, y0, z0 = places_ned_m[source]
        distances_m = [hypot(x - x0, y - y0, z - z0) for x, y, z in places_ned_m]
        slope = -self._exponent
        powers_mw = [
            gain_mw * max(distance_m, REFERENCE_DISTANCE_M) ** slope
            for gain_mw, distance_m in zip(self._gains[source], distances_m, strict=True)
        ]
        powers_mw[source] = 0.0
        delays_ns = [round(distance_m / SPEED_OF_LIGHT_M_S * 1e9) for distance_m in distances_m]
        audible_mw = self._audible_mw
        longest_ns = max(
            [delay for delay, mw in zip(delays_ns, powers_mw, strict=True) if mw > audible_mw], default=0
        )
        row = LinkRow(powers_mw, delays_ns, longest_ns)
        self._rows[source], self._row_ns[source], self._row_version[source] = row, at_ns, version
        return row


class RicianFading:
    """Power gain |h|^2 of a frame on a link, mean 1.

    h = sqrt(K / (K + 1)) plus a complex Gaussian of power 1 / (K + 1), independent from frame to frame.
    """

    BLOCK = 64

    def __init__(self, k_db: float, stations: int, streams: Streams) -> None:
        k = 10.0 ** (k_db / 10.0)
        self._line_of_sight = sqrt(k / (k + 1.0))
        self._scatter_std = sqrt(0.5 / (k + 1.0))
        self._streams = streams
        self._generators: list[list[np.random.Generator | None]] = [
            [None] * stations for _ in range(stations)
        ]
        self._blocks: list[list[list[float]]] = [[] for _ in range(stations)]
        """By source: gains of its next frames, last first, each by receiver."""

    def gains(self, source: int) -> list[float]:
        """Each link's next gain, by receiver; nothing for the source itself."""
        block = self._blocks[source]
        if not block:
            self._refill(source, block)
        return block.pop()

    def _refill(self, source: int, block: list[list[float]]) -> None:
        gains = np.zeros((self.BLOCK, len(self._generators)))
        for receiver, generator in enumerate(self._generators[source]):
            if receiver == source:
                continue
            if generator is None:
                generator = self._streams.generator(Model.FADING, source, receiver)
                self._generators[source][receiver] = generator
            real, imaginary = generator.normal(0.0, self._scatter_std, (2, self.BLOCK))
            gains[:, receiver] = (self._line_of_sight + real) ** 2 + imaginary**2
        block.extend(gains[::-1].tolist())
