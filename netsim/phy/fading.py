"""Small-scale fading: a steady ray and scattered waves that turn with the Doppler spread.

Power gain |h|^2 of a link, mean 1, with h = sqrt(K / (K + 1)) + sqrt(1 / (K + 1)) s. The scattered part s is
Clarke's: waves from all around, of phase theta cos(alpha_m) + phi_m, where theta is the integral of 2 pi
times the Doppler spread over time. Its correlation is then J0(theta' - theta): with a steady spread f_d, J0(2
pi f_d tau). Angles lie one in each sector of the half circle, and each stands for the wave from the other
side as well, whose phase turns the other way: cosine and sine serve both (Zheng and Xiao, IEEE Transactions
on Communications 51, 2003, on such sums).

The spread of what moves around the stations and that of the stations' own relative motion, v / lambda, are of
independent causes: their squares add. From one instant at which positions are stated to the next, v is the
way of the one end as seen from the other over the time between; after the last it is as the velocities say.
So it hardly matters at how many instants they are stated: a turn counts as its chord.

All is a function of the seed, the unordered pair and theta, so a link is the same in both directions and no
matter who sends when.

A frame has the gain of its beginning throughout, and the same on all subcarriers.
"""

from math import cos, pi, sin, sqrt

import numpy as np
from numba import njit

from netsim.phy.path_loss import SPEED_OF_LIGHT_M_S, Doubles
from netsim.streams import Model, Streams

SECTORS = 8
"""Angles of a link, as many as Zheng and Xiao find sufficient; it has twice as many waves."""


@njit(cache=True)
def _turn(
    theta_rad: Doubles,
    rates_rad_ns: Doubles,
    moved_m: Doubles,
    vel_ned_m_s: Doubles,
    since_s: float,
    doppler_hz: float,
    wavelength_m: float,
) -> None:
    """Turn every pair's theta (n, n) on by the ways (n, 3) of its ends, and take its rate from then on."""
    for a in range(len(theta_rad)):
        for b in range(a):
            way_m2 = speed_m2_s2 = 0.0
            for axis in range(3):
                way_m2 += (moved_m[a, axis] - moved_m[b, axis]) ** 2
                speed_m2_s2 += (vel_ned_m_s[a, axis] - vel_ned_m_s[b, axis]) ** 2
            turns = sqrt(way_m2 / wavelength_m**2 + (doppler_hz * since_s) ** 2)
            spread_hz = sqrt(speed_m2_s2 / wavelength_m**2 + doppler_hz**2)
            theta_rad[a, b] += 2.0 * pi * turns
            theta_rad[b, a] = theta_rad[a, b]
            rates_rad_ns[a, b] = rates_rad_ns[b, a] = 2e-9 * pi * spread_hz


@njit(cache=True)
def _gains(
    theta_rad: Doubles,
    rates_rad_ns: Doubles,
    since_ns: int,
    cosines: Doubles,
    weights: Doubles,
    line_of_sight: float,
    gains: Doubles,
) -> None:
    """Fill ``gains`` (n,) with |h|^2 of one station's links, of which all the arrays are."""
    for r in range(len(gains)):
        angle_rad = theta_rad[r] + rates_rad_ns[r] * since_ns
        real, imaginary = line_of_sight, 0.0
        for m in range(cosines.shape[1]):
            phase_rad = angle_rad * cosines[r, m]
            cosine, sine = cos(phase_rad), sin(phase_rad)
            real += weights[r, m, 0] * cosine + weights[r, m, 1] * sine
            imaginary += weights[r, m, 2] * cosine + weights[r, m, 3] * sine
        gains[r] = real * real + imaginary * imaginary


class RicianFading:
    """Fading of all links."""

    def __init__(
        self, *, k_db: float, doppler_hz: float, frequency_mhz: float, stations: int, streams: Streams
    ) -> None:
        k = 10.0 ** (k_db / 10.0)
        self._line_of_sight = (k / (k + 1.0)) ** 0.5
        self._amplitude = (0.5 / SECTORS / (k + 1.0)) ** 0.5
        self._doppler_hz = doppler_hz
        self._wavelength_m = SPEED_OF_LIGHT_M_S / (frequency_mhz * 1e6)
        self._stations = stations
        self._streams = streams
        self._since_ns = 0
        self._pos_ned_m: Doubles | None = None
        self._theta_rad = np.zeros((stations, stations))
        """Of every pair at ``_since_ns``, and its rate from then on."""
        self._rates_rad_ns = np.full((stations, stations), 2e-9 * pi * doppler_hz)
        self._waves: list[tuple[Doubles, Doubles] | None] = [None] * stations
        """By source: cosines (n, sectors); weights (n, sectors, 4) of each one's cosine and sine, in the real
        and then in the imaginary part."""

    def move(self, at_ns: int, pos_ned_m: Doubles, vel_ned_m_s: Doubles) -> None:
        """At ``at_ns`` the stations are at these places (n, 3), and go on with these velocities (n, 3).

        While all rest this need not be said again.
        """
        # before the first instant everybody stood still
        moved_m = np.zeros_like(pos_ned_m) if self._pos_ned_m is None else pos_ned_m - self._pos_ned_m
        _turn(
            self._theta_rad,
            self._rates_rad_ns,
            moved_m,
            vel_ned_m_s,
            (at_ns - self._since_ns) * 1e-9,
            self._doppler_hz,
            self._wavelength_m,
        )
        self._since_ns, self._pos_ned_m = at_ns, pos_ned_m

    def gains(self, source: int, at_ns: int) -> Doubles:
        """Gain of each link of ``source``, by station; of no meaning for itself."""
        waves = self._waves[source]
        if waves is None:
            waves = self._waves[source] = self._draw(source)
        gains = np.empty(self._stations)
        _gains(
            self._theta_rad[source],
            self._rates_rad_ns[source],
            at_ns - self._since_ns,
            *waves,
            self._line_of_sight,
            gains,
        )
        return gains

    def _draw(self, source: int) -> tuple[Doubles, Doubles]:
        cosines = np.zeros((self._stations, SECTORS))
        weights = np.zeros((self._stations, SECTORS, 4))
        for other in range(self._stations):
            if other == source:
                continue
            generator = self._streams.generator(Model.FADING, min(source, other), max(source, other))
            cosines[other] = np.cos(pi / SECTORS * (np.arange(SECTORS) + generator.random(SECTORS)))
            ahead, behind = self._amplitude * np.exp(2j * pi * generator.random((2, SECTORS)))
            # ahead e^(ix) + behind e^(-ix)
            of_cosine, of_sine = ahead + behind, 1j * (ahead - behind)
            weights[other] = np.stack((of_cosine.real, of_sine.real, of_cosine.imag, of_sine.imag), axis=1)
        return cosines, weights
