"""Small-scale Rician fading: a line-of-sight component and scattered waves with a Doppler spread.

The power gain of a link is |h|^2, with mean 1 and h = sqrt(K / (K + 1)) + sqrt(1 / (K + 1)) s. The scattered
part s follows Clarke's model: waves from all directions, of phase theta cos(alpha_m) + phi_m, where theta is
the integral of 2 pi times the Doppler spread over time. Its correlation is J0(theta' - theta), or J0(2 pi f_d
tau) for a constant spread f_d. There is one angle in each sector of the half circle. The wave from the
opposite direction has the opposite phase rotation, so the same cosine and sine are used for both (Zheng and
Xiao, IEEE Transactions on Communications 51, 2003, on such sums).

The Doppler spread of moving surroundings and that of the relative motion of the stations, v / lambda, are
independent: their squares add. Between two updates of the positions, v is the relative displacement divided
by the time between; after the last update it is the relative velocity. So the update rate has little
influence: the path between two updates is approximated by its chord.

The gain is a function of seed, unordered pair and theta, so a link is reciprocal and independent of the
order of transmissions. It is constant during a frame, and equal on all subcarriers.
"""

from math import cos, pi, prod, sin, sqrt

import numpy as np
from numba import njit

from netsim.model.random_streams import Model, RandomStreams
from netsim.phy.interfaces import Fading
from netsim.phy.path_loss import SPEED_OF_LIGHT_M_S, Doubles

SECTORS = 8
"""Angles per link, sufficient according to Zheng and Xiao; the number of waves is twice that."""
_HEAD, _WEIGHTS = 2, 4
"""Numbers before the links' in the block; weights of a wave."""


@njit(cache=True)
def _turn(
    theta_rad: Doubles,
    rates_rad_ns: Doubles,
    from_ned_m: Doubles,
    to_ned_m: Doubles,
    vel_ned_m_s: Doubles,
    since_s: float,
    doppler_hz: float,
    wavelength_m: float,
) -> None:
    """Advance every pair's theta (n, n) by the motion between positions (n, 3), and update its rate."""
    # products instead of powers, since Python's pow and compiled code round differently
    wavelength_m2, doppler_turns = wavelength_m * wavelength_m, doppler_hz * since_s
    for a in range(len(theta_rad)):
        for b in range(a):
            way_m2 = speed_m2_s2 = 0.0
            for axis in range(3):
                moved_m = to_ned_m[a, axis] - from_ned_m[a, axis]
                way_m = moved_m - (to_ned_m[b, axis] - from_ned_m[b, axis])
                speed_m_s = vel_ned_m_s[a, axis] - vel_ned_m_s[b, axis]
                way_m2 += way_m * way_m
                speed_m2_s2 += speed_m_s * speed_m_s
            turns = sqrt(way_m2 / wavelength_m2 + doppler_turns * doppler_turns)
            spread_hz = sqrt(speed_m2_s2 / wavelength_m2 + doppler_hz * doppler_hz)
            theta_rad[a, b] += 2.0 * pi * turns
            theta_rad[b, a] = theta_rad[a, b]
            rates_rad_ns[a, b] = rates_rad_ns[b, a] = 2e-9 * pi * spread_hz


@njit(cache=True)
def gain(block: Doubles, stations: int, source: int, receiver: int, at_ns: int) -> float:
    """Return the power gain of a link by fading, from the block of `RicianFading` or `SampledFading`."""
    links, link = stations * stations, source * stations + receiver
    if len(block) == links:  # gains of frames that begin now
        return float(block[link])
    theta_rad, rate_rad_ns = block[_HEAD + link], block[_HEAD + links + link]
    angle_rad = theta_rad + rate_rad_ns * (at_ns - int(block[0]))
    real, imaginary = block[1], 0.0
    wave = _HEAD + 2 * links + link * SECTORS
    weight = _HEAD + (2 + SECTORS) * links + link * SECTORS * _WEIGHTS
    for m in range(SECTORS):
        phase_rad = angle_rad * block[wave + m]
        cosine, sine = cos(phase_rad), sin(phase_rad)
        real += block[weight] * cosine + block[weight + 1] * sine
        imaginary += block[weight + 2] * cosine + block[weight + 3] * sine
        weight += _WEIGHTS
    return float(real * real + imaginary * imaginary)


def _parts(block: Doubles, n: int) -> tuple[Doubles, Doubles, Doubles, Doubles]:
    """Return views of theta and its rate (n, n), and the waves' cosines (n, n, sectors) and weights.

    Weights (n, n, sectors, 4) are those of cosine and sine in the real part, then in the imaginary part.
    """
    shapes = ((n, n), (n, n), (n, n, SECTORS), (n, n, SECTORS, _WEIGHTS))
    views, at = [], _HEAD
    for shape in shapes:
        size = prod(shape)
        views.append(block[at : at + size].reshape(shape))
        at += size
    theta_rad, rates_rad_ns, cosines, weights = views
    return theta_rad, rates_rad_ns, cosines, weights


class SampledFading:
    """Fading by a model in Python, which is called at the beginning of each frame."""

    def __init__(self, model: Fading, stations: int) -> None:
        self._model = model
        self._rows = np.ones((stations, stations))
        self.block = self._rows.reshape(-1)
        """Data of `gain`: gains by source and receiver, those of a source as of its last `sample`."""
        self.move = model.move

    def sample(self, source: int, at_ns: int) -> None:
        """Set the gains of a frame that a station begins now."""
        self._rows[source] = self._model.gains(source, at_ns)


class RicianFading:
    """Rician fading of all links, computed in the kernel `gain`."""

    def __init__(
        self, *, k_db: float, doppler_hz: float, frequency_mhz: float, stations: int, streams: RandomStreams
    ) -> None:
        k = 10.0 ** (k_db / 10.0)
        self._amplitude = (0.5 / SECTORS / (k + 1.0)) ** 0.5
        self._doppler_hz = doppler_hz
        self._wavelength_m = SPEED_OF_LIGHT_M_S / (frequency_mhz * 1e6)
        self._pos_ned_m: Doubles | None = None
        self.block = np.zeros(_HEAD + stations**2 * (2 + (1 + _WEIGHTS) * SECTORS))
        """Data of `gain`: time of the last update in ns, line-of-sight amplitude, arrays of `_parts`."""
        self.block[1] = (k / (k + 1.0)) ** 0.5
        self._theta_rad, self._rates_rad_ns, self._cosines, self._weights = _parts(self.block, stations)
        self._rates_rad_ns[...] = 2e-9 * pi * doppler_hz
        for a in range(stations):
            for b in range(a + 1, stations):
                cosines, weights = self._waves(streams.generator(Model.FADING, a, b))
                self._cosines[a, b] = self._cosines[b, a] = cosines
                self._weights[a, b] = self._weights[b, a] = weights

    def move(self, at_ns: int, pos_ned_m: Doubles, vel_ned_m_s: Doubles) -> None:
        """Set positions (n, 3) at ``at_ns`` and velocities (n, 3) from then on.

        No update is needed while all stations are at rest.
        """
        # before the first update all stations are at rest
        from_ned_m = pos_ned_m if self._pos_ned_m is None else self._pos_ned_m
        _turn(
            self._theta_rad,
            self._rates_rad_ns,
            from_ned_m,
            pos_ned_m,
            vel_ned_m_s,
            (at_ns - int(self.block[0])) * 1e-9,
            self._doppler_hz,
            self._wavelength_m,
        )
        self.block[0], self._pos_ned_m = at_ns, pos_ned_m

    def _waves(self, generator: np.random.Generator) -> tuple[Doubles, Doubles]:
        """Return random waves of one link: cosines (sectors,) and weights (sectors, 4)."""
        cosines = np.cos(pi / SECTORS * (np.arange(SECTORS) + generator.random(SECTORS)))
        ahead, behind = self._amplitude * np.exp(2j * pi * generator.random((2, SECTORS)))
        # ahead e^(ix) + behind e^(-ix)
        of_cosine, of_sine = ahead + behind, 1j * (ahead - behind)
        weights = np.stack((of_cosine.real, of_sine.real, of_cosine.imag, of_sine.imag), axis=1)
        return cosines, weights
