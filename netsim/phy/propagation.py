"""Positions of the stations, and link budgets: received powers and propagation delays.

The models are composed by `netsim.phy.path_gain` (path loss, antennas, shadowing), `netsim.phy.obstruction`
and `netsim.phy.fading`; a budget is the product of the enabled ones.
"""

from collections.abc import Callable
from math import hypot, inf, sqrt

import numpy as np
from msgspec import Struct
from numba import njit
from numpy.typing import ArrayLike

from netsim.model.config import RadioConfig
from netsim.model.event_queue import NEVER_NS
from netsim.model.random_streams import RandomStreams
from netsim.model.tables import Integers
from netsim.phy.antenna import rotations_ned_frd
from netsim.phy.models import RadioModels
from netsim.phy.obstruction import Obstruction
from netsim.phy.path_gain import ALL, PathGain
from netsim.phy.path_loss import REFERENCE_DISTANCE_M, SPEED_OF_LIGHT_M_S, Doubles, friis_loss_db
from netsim.phy.timing import timing_of

BOLTZMANN_J_K = 1.380649e-23
REFERENCE_TEMPERATURE_K = 290.0
ROW_LIFETIME_NS = 4_000_000
"""Validity of the link budget of a moving station, which moves 8 cm meanwhile at 20 m/s."""
COMPUTED_TOGETHER = 16
"""Number of stations up to which computing all links at once costs less than two stations' links."""
AUDIBLE_BELOW_NOISE = 0.01
"""Power ratio to the noise, and to the sensing thresholds, below which a signal is ignored: -20 dB."""
FARTHEST_PLACE_M, FASTEST_M_S, NORM_TOLERANCE = 1e8, 1e5, 1e-3
"""Limits of a station's state, to reject invalid numbers."""


def thermal_noise_mw(bandwidth_mhz: float, noise_figure_db: float) -> float:
    """Return the noise power k T B F at the receiver's input, in milliwatts."""
    noise_factor: float = 10.0 ** (noise_figure_db / 10.0)
    return BOLTZMANN_J_K * REFERENCE_TEMPERATURE_K * bandwidth_mhz * 1e9 * noise_factor


@njit(cache=True)
def is_possible(pos_ned_m: Doubles, vel_ned_m_s: Doubles, q_ned_frd: Doubles) -> bool:
    """Whether positions and velocities (n, 3) are finite and within limits, and quaternions have norm 1."""
    for r in range(len(pos_ned_m)):
        for axis in range(3):
            if not (abs(pos_ned_m[r, axis]) <= FARTHEST_PLACE_M and abs(vel_ned_m_s[r, axis]) <= FASTEST_M_S):
                return False
        square = 0.0
        for k in range(4):
            square += q_ned_frd[r, k] * q_ned_frd[r, k]
        if not abs(sqrt(square) - 1.0) <= NORM_TOLERANCE:
            return False
    return True


@njit(cache=True)
def _power_law(
    pos_ned_m: Doubles,
    vel_ned_m_s: Doubles,
    dt_s: float,
    source: int,
    at_reference_mw: float,
    exponent: float,
    farthest_m: float,
    audible_mw: float,
    powers_mw: Doubles,
    distances_m: Doubles,
    delays_ns: Integers,
) -> int:
    """Fill powers, distances and delays (n,) from a station to all; return the longest delay as `_reach`.

    Positions are extrapolated by ``dt_s``.
    """
    for r in range(len(pos_ned_m)):
        square_m2 = 0.0
        for axis in range(3):
            to_m = pos_ned_m[r, axis] + dt_s * vel_ned_m_s[r, axis]
            way_m = to_m - (pos_ned_m[source, axis] + dt_s * vel_ned_m_s[source, axis])
            square_m2 += way_m * way_m  # not way_m**2, since Python's pow rounds differently
        distances_m[r] = sqrt(square_m2)
        powers_mw[r] = at_reference_mw * max(distances_m[r], REFERENCE_DISTANCE_M) ** -exponent
    powers_mw[source] = 0.0
    return _reach(powers_mw, distances_m, farthest_m, audible_mw, delays_ns)


@njit(cache=True)
def _reach(
    powers_mw: Doubles, distances_m: Doubles, farthest_m: float, audible_mw: float, delays_ns: Integers
) -> int:
    """Fill the delays (n,); return the longest one to a station that can sense the signal."""
    longest_ns = 0
    for r in range(len(powers_mw)):
        if distances_m[r] > farthest_m:
            powers_mw[r], delays_ns[r] = 0.0, 0
        else:
            delays_ns[r] = round(distances_m[r] / SPEED_OF_LIGHT_M_S * 1e9)
        if powers_mw[r] > audible_mw and delays_ns[r] > longest_ns:
            longest_ns = delays_ns[r]
    return longest_ns


class Trajectories:
    """Positions of the stations, extrapolated with the velocities of the last update. World NED, metres.

    Attitudes are constant between updates.
    """

    def __init__(self, stations: int) -> None:
        self.at_ns = 0
        """Time of the last `set`."""
        self._pos_ned_m = np.zeros((stations, 3))
        self._vel_ned_m_s = np.zeros((stations, 3))
        self._rows: tuple[list[list[float]], list[list[float]]] | None = None
        """Positions and velocities as lists of floats, created on demand."""
        self._attitudes: bytes | None = None
        self._rotations: Doubles | None = None
        self.moving = False
        self.on_set: Callable[[int, Doubles, Doubles], None] | None = None
        """Called with time, positions and velocities by `set`, before it changes the motion."""
        self.version = 0
        """Incremented when positions may differ from the extrapolated ones."""
        self.pose_version = 0
        """Incremented with ``version`` and when an attitude has changed."""

    def set(
        self, at_ns: int, pos_ned_m: ArrayLike, vel_ned_m_s: ArrayLike, q_ned_frd: ArrayLike | None = None
    ) -> None:
        """Set positions and velocities (n, 3) at ``at_ns``.

        ``q_ned_frd`` (n, 4) are Hamilton quaternions wxyz that map FRD to NED; None: all level.
        """
        # copies, as the caller may change its arrays
        places, velocities = np.array(pos_ned_m, np.float64), np.array(vel_ned_m_s, np.float64)
        moving = bool(np.count_nonzero(velocities))
        if moving or self.moving or places.tobytes() != self._pos_ned_m.tobytes():
            if self.on_set is not None:
                self.on_set(at_ns, places, velocities)
            self.version += 1
            self.pose_version += 1
            self._rows = None
            self._pos_ned_m, self._vel_ned_m_s = places, velocities
        attitudes = None if q_ned_frd is None else np.array(q_ned_frd, np.float64).tobytes()
        if attitudes != self._attitudes:
            self._attitudes, self._rotations = attitudes, None
            self.pose_version += 1
        self.moving = moving
        self.at_ns = at_ns

    def course(self, at_ns: int) -> tuple[Doubles, Doubles, float]:
        """Return positions and velocities (n, 3) of the last update, and the time since then in seconds."""
        return self._pos_ned_m, self._vel_ned_m_s, (at_ns - self.at_ns) * 1e-9

    def positions_ned_m(self, at_ns: int) -> Doubles:
        """Return the positions (n, 3) of all stations."""
        pos_ned_m, vel_ned_m_s, dt_s = self.course(at_ns)
        return pos_ned_m + dt_s * vel_ned_m_s if self.moving else pos_ned_m

    def distance_m(self, a: int, b: int, at_ns: int) -> float:
        """Return the distance between two stations."""
        rows = self._rows
        if rows is None:
            rows = self._rows = self._pos_ned_m.tolist(), self._vel_ned_m_s.tolist()
        places, velocities = rows
        dt_s = (at_ns - self.at_ns) * 1e-9
        (xa, ya, za), (xb, yb, zb) = places[a], places[b]
        (ua, va, wa), (ub, vb, wb) = velocities[a], velocities[b]
        return hypot(xa - xb + dt_s * (ua - ub), ya - yb + dt_s * (va - vb), za - zb + dt_s * (wa - wb))

    def rotations_ned_frd(self) -> Doubles:
        """Return the rotations (n, 3, 3) from FRD to NED."""
        if self._rotations is None:
            level = np.tile([1.0, 0.0, 0.0, 0.0], len(self._pos_ned_m))
            attitudes = level if self._attitudes is None else np.frombuffer(self._attitudes)
            self._rotations = rotations_ned_frd(attitudes.reshape(-1, 4))
        return self._rotations


class LinkRow(Struct, frozen=True):
    """Link budget from one transmitter to every station, by station.

    Entries of the transmitter itself and of stations beyond `PhyTiming.farthest_m` are zero.
    """

    powers_mw: Doubles
    """Mean received power, before fading."""
    delays_ns: Integers
    longest_delay_ns: int
    """Longest delay to a station that can sense the signal."""
    until_ns: int = 0
    """End of its validity while `Links.version` is unchanged; it is valid at least at the requested time."""


class Links:
    """Link budgets of all pairs, computed when a station transmits and cached while no station moves."""

    def __init__(
        self,
        config: RadioConfig,
        trajectories: Trajectories,
        stations: int,
        streams: RandomStreams,
        models: RadioModels,
    ) -> None:
        self._config = config
        self._trajectories = trajectories
        self._stations = stations
        self._extra_db = config.extra_attenuation_db
        self._farthest_m = timing_of(config).farthest_m
        # stations that may sense a signal must process its end
        self._audible_mw = min(
            AUDIBLE_BELOW_NOISE * thermal_noise_mw(config.bandwidth_mhz, config.noise_figure_db),
            10.0 ** (min(config.cca_energy_dbm, config.cca_preamble_dbm) / 10.0 - 2.0),
        )
        self._powers_version = 0
        self._rows: dict[int, tuple[int, LinkRow]] = {}
        """By source: `version` and link budget."""
        self._propagation = PathGain(config, models)
        offset_db = np.zeros(stations)
        for station in config.stations:
            if station.antenna_gain_dbi is not None:
                offset_db[station.station] = station.antenna_gain_dbi - config.antenna_gain_dbi
        self._gain_offset_db: list[float] = offset_db.tolist()
        """By station: gain relative to that of the settings."""
        self._receiver_gain = 10.0 ** (offset_db / 10.0) if offset_db.any() else None
        """The same (n,), linear; None: all are equal."""
        self._exponent = None if offset_db.any() else self._propagation.power_law_exponent
        self._uses_attitudes = self._propagation.uses_attitudes
        self._together = stations <= COMPUTED_TOGETHER
        self._poses_of: tuple[int, int] | None = None
        """Pose version and time of the following, which `_use_poses` sets."""
        self._poses: tuple[Doubles, Doubles | None]
        """Positions (n, 3) and rotations from FRD to NED."""
        self._paths: tuple[Doubles, Doubles] | None = None
        """Gains and distances of all links, computed on demand."""
        self._interferer_rows: list[LinkRow] = []
        """Computed on demand."""
        self._obstruction: Obstruction | None = None
        if config.nlos_fraction > 0.0:
            self._obstruction = Obstruction(
                fraction=config.nlos_fraction,
                duration_s=config.nlos_duration_s,
                stations=stations,
                streams=streams,
            )
        self._blocked_gain = 10.0 ** (-config.nlos_loss_db / 10.0)
        self.fading = models.fading
        if self.fading is not None:
            trajectories.on_set = self.fading.move
        self._distances_m = np.empty(stations)
        """Buffer used while a row is computed."""
        self._tx_power_dbm = [config.tx_power_dbm] * stations
        for station in config.stations:
            if station.tx_power_dbm is not None:
                self._tx_power_dbm[station.station] = station.tx_power_dbm
        self._update_powers()

    def set_extra_attenuation_db(self, value: float) -> None:
        """Set the extra attenuation of all links. Interferers are not attenuated.

        Raises ValueError if it is negative or not finite.
        """
        if not 0.0 <= value < inf:
            raise ValueError(f"extra attenuation of {value} dB is negative or not finite")
        if value != self._extra_db:
            self._extra_db = value
            self._update_powers()

    def _update_powers(self) -> None:
        loss_db = friis_loss_db(REFERENCE_DISTANCE_M, self._config.frequency_mhz) + self._extra_db
        gain_db = 2.0 * self._config.antenna_gain_dbi - loss_db
        self._at_reference_mw = [
            10.0 ** ((power_dbm + gain_db + offset_db) / 10.0)
            for power_dbm, offset_db in zip(self._tx_power_dbm, self._gain_offset_db, strict=True)
        ]
        """By source: power received at `REFERENCE_DISTANCE_M` by an antenna with the common gain, the extra
        attenuation included."""
        self._powers_version += 1

    @property
    def version(self) -> int:
        """Incremented when rows may differ from those of the extrapolated motion."""
        trajectories = self._trajectories
        poses = trajectories.pose_version if self._uses_attitudes else trajectories.version
        return poses + self._powers_version

    def blocked(self, a: int, b: int, at_ns: int) -> bool:
        """Whether the line of sight between two stations is blocked."""
        return self._obstruction is not None and self._obstruction.blocked(a, b, at_ns)[0]

    def row(self, source: int, at_ns: int) -> LinkRow:
        """Return the link budget from a station to all others, without fading."""
        trajectories, version = self._trajectories, self.version
        row_version, row = self._rows.get(source, (None, None))
        if row is not None and row_version == version and at_ns <= row.until_ns:
            return row
        until_ns = at_ns + ROW_LIFETIME_NS if trajectories.moving else NEVER_NS
        if self._exponent is not None and self._obstruction is None:  # computed in a kernel
            powers_mw, delays_ns = np.empty(self._stations), np.empty(self._stations, np.int64)
            longest_ns = _power_law(
                *trajectories.course(at_ns),
                source,
                self._at_reference_mw[source],
                self._exponent,
                self._farthest_m,
                self._audible_mw,
                powers_mw,
                self._distances_m,
                delays_ns,
            )
            row = LinkRow(powers_mw, delays_ns, longest_ns, until_ns)
        else:
            since_ns = self._use_poses(at_ns)
            if trajectories.moving:
                until_ns = since_ns + ROW_LIFETIME_NS - 1
            gains, distances_m = self._paths_from(source)
            powers_mw = self._at_reference_mw[source] * gains
            if self._receiver_gain is not None:
                powers_mw *= self._receiver_gain
            if self._obstruction is not None:
                blocked, same_until_ns = self._obstruction.row(source, at_ns)
                powers_mw[blocked] *= self._blocked_gain
                until_ns = min(until_ns, same_until_ns - 1)
            powers_mw[source] = 0.0
            row = self._finish(powers_mw, distances_m, self._farthest_m, until_ns)
        self._rows[source] = version, row
        return row

    def interferer_row(self, index: int, at_ns: int) -> LinkRow:
        """Return the link budget from an interferer to all stations, without fading and blockage."""
        self._use_poses(at_ns)
        if not self._interferer_rows:
            config = self._config
            places = np.array([interferer.pos_ned_m for interferer in config.interferers])
            gains, distances = self._propagation.from_others(places, *self._poses)
            if self._receiver_gain is not None:
                gains = gains * self._receiver_gain
            gain_db = config.antenna_gain_dbi - friis_loss_db(REFERENCE_DISTANCE_M, config.frequency_mhz)
            self._interferer_rows = [
                self._finish(10.0 ** ((interferer.eirp_dbm + gain_db) / 10.0) * gains[i], distances[i], inf)
                for i, interferer in enumerate(config.interferers)
            ]
        return self._interferer_rows[index]

    def _use_poses(self, at_ns: int) -> int:
        """Set the poses used at ``at_ns``; return their time, whole row lifetimes after the last update."""
        trajectories = self._trajectories
        since_ns = at_ns - (at_ns - trajectories.at_ns) % ROW_LIFETIME_NS if trajectories.moving else 0
        key = trajectories.pose_version, since_ns
        if key != self._poses_of:
            rotations = trajectories.rotations_ned_frd() if self._uses_attitudes else None
            self._poses_of, self._poses = key, (trajectories.positions_ned_m(since_ns), rotations)
            self._paths, self._interferer_rows = None, []
        return since_ns

    def _paths_from(self, source: int) -> tuple[Doubles, Doubles]:
        """Return gains and distances (n,) of one station's links; with few stations computes all links."""
        if not self._together:
            gains, distances = self._propagation.between_stations(slice(source, source + 1), *self._poses)
            return gains[0], distances[0]
        if self._paths is None:
            self._paths = self._propagation.between_stations(ALL, *self._poses)
        return self._paths[0][source], self._paths[1][source]

    def _finish(
        self, powers_mw: Doubles, distances_m: Doubles, farthest_m: float, until_ns: int = 0
    ) -> LinkRow:
        delays_ns = np.empty(self._stations, np.int64)
        longest_ns = _reach(powers_mw, distances_m, farthest_m, self._audible_mw, delays_ns)
        return LinkRow(powers_mw, delays_ns, int(longest_ns), until_ns)
