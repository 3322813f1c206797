"""Antennas of stations of which some have another than the rest.

A pair of dipoles couples as in `netsim.phy.antenna`, with its polarisation. Of other pairs each end has a
gain of its own: that of a pattern, or that of a dipole for a partner of unknown polarisation, which receives
half of it.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from netsim.phy.antenna import Dipole, pattern_gain_db, unpolarised_source_coupling
from netsim.phy.interfaces import AntennaPattern
from netsim.phy.path_loss import Doubles

Antenna = AntennaPattern | Dipole | None
"""None: isotropic."""


class MixedAntennas:
    """The antennas of all stations: ``common``, except those of the stations in ``own``."""

    def __init__(self, common: Antenna, own: Mapping[int, Antenna]) -> None:
        self._common, self._own = common, own
        self._antennas: Sequence[Antenna] = ()

    @property
    def any_directional(self) -> bool:
        """Whether any gain depends on attitudes."""
        return any(antenna is not None for antenna in (self._common, *self._own.values()))

    def dipoles(self, stations: int) -> NDArray[np.bool_]:
        """Return which of ``stations`` (n,) have dipoles."""
        return np.array([isinstance(each, Dipole) for each in self._of(stations)])

    def gains(self, directions_ned: Doubles, rotations: Doubles, stations: NDArray[np.int64]) -> Doubles:
        """Return the linear gains (m, n) of m ``stations``, numbers (m,), in directions (m, n, 3).

        ``rotations`` (m, 3, 3) from FRD to NED are those of the m stations; dipoles have the gain for a
        partner of unknown polarisation.
        """
        gains = np.ones(directions_ned.shape[:2])
        antennas = self._of(int(stations.max(initial=0)) + 1)
        for row, station in enumerate(stations):
            antenna, one = antennas[station], slice(row, row + 1)
            if isinstance(antenna, Dipole):
                axes = rotations[one, :, 2]
                gains[row] = unpolarised_source_coupling(directions_ned[one].swapaxes(0, 1), axes)[:, 0]
            elif antenna is not None:
                gain_db = pattern_gain_db(antenna, directions_ned[one], rotations[one])
                gains[row] = 10.0 ** (gain_db[0] / 10.0)
        return gains

    def _of(self, stations: int) -> Sequence[Antenna]:
        if len(self._antennas) < stations:
            self._antennas = [self._own.get(i, self._common) for i in range(stations)]
        return self._antennas[:stations]
