"""Shadowing as a function of the positions of both ends of a link.

The correlation is Gudmundson's exponential (Electronics Letters 27, 1991) in the displacement of either end,
and the product of both if both move (Wang, Tameh and Nix, IEEE Transactions on Vehicular Technology 57,
2008):

    exp(-|displacement of a| / D) exp(-|displacement of b| / D)

The field over both positions is a sum of waves cos(k . a + l . b + phase). Its correlation is the
characteristic function of the wave vectors. exp(-|displacement| / D) is that of the three-dimensional Cauchy
distribution with scale 1 / D, from which k and l are drawn independently. Links are reciprocal: the fields of
(a, b) and (b, a) are added. Their correlation exp(-2 d / D) at distance d would increase the standard
deviation, so the sum is divided accordingly.
"""

from math import pi

import numpy as np

from netsim.model.random_streams import Model, RandomStreams
from netsim.phy.path_loss import Doubles

WAVES = 64
_Waves = tuple[Doubles, Doubles, Doubles, Doubles]
"""Cosine and sine of k . pos, then of l . pos + phase, each (n, waves)."""


class LogNormalShadowing:
    """Shadowing field of one run; see `netsim.phy.interfaces.Shadowing`."""

    def __init__(self, std_db: float, distance_m: float, streams: RandomStreams) -> None:
        generator = streams.generator(Model.SHADOWING)
        self._distance_m = distance_m
        self._amplitude_db = std_db * (2.0 / WAVES) ** 0.5
        # Cauchy in three dimensions: normal vectors divided by normal numbers
        directions, scales = (
            generator.standard_normal((2, WAVES, 3)),
            generator.standard_normal((2, WAVES, 1)),
        )
        self._wave_vectors = (directions / (np.abs(scales) * distance_m)).reshape(-1, 3).T
        self._phases = np.concatenate((np.zeros(WAVES), generator.uniform(0.0, 2.0 * pi, WAVES)))
        self._last_ned_m: Doubles | None = None
        self._last_waves: _Waves | None = None

    def _waves(self, pos_ned_m: Doubles) -> _Waves:
        angles = pos_ned_m @ self._wave_vectors + self._phases
        cosine, sine = np.cos(angles), np.sin(angles)
        return cosine[:, :WAVES], sine[:, :WAVES], cosine[:, WAVES:], sine[:, WAVES:]

    def gain_db(self, from_ned_m: Doubles, to_ned_m: Doubles, distance_m: Doubles) -> Doubles:
        """Return the shadowing (m, n) in dB from m positions to n positions; positive is more power.

        Waves at ``to_ned_m`` are cached for the next call with the same array, which must not be modified.
        """
        to = self._last_waves
        if to is None or to_ned_m is not self._last_ned_m:
            self._last_ned_m, to = to_ned_m, self._waves(to_ned_m)
            self._last_waves = to
        cos_k, sin_k, cos_l, sin_l = to if from_ned_m is to_ned_m else self._waves(from_ned_m)
        # cos(A + B) = cos A cos B - sin A sin B, for (a, b) and for (b, a)
        ahead, back = np.hstack((cos_k, -sin_k)), np.hstack((cos_l, -sin_l))
        both = ahead @ np.hstack((to[2], to[3])).T + back @ np.hstack((to[0], to[1])).T
        return np.asarray(
            self._amplitude_db * both / np.sqrt(2.0 + 2.0 * np.exp(-2.0 / self._distance_m * distance_m))
        )
