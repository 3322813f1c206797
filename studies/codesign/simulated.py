"""Simulated measurements as received by one UAV of a hovering formation, with exactly known statistics.

The errors are those that the localisation filter models, plus the faults in `Trouble`, so that the filter can
be compared with bounds of the same model. Motion, random walks, Gauss-Markov errors and measurements are on a
time grid of `GRID_US`, so there is no interpolation error.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from autopilot.onboard.localisation.localisation import CooperativeLocalisation
from autopilot.onboard.localisation.model import LocalisationModel
from autopilot.onboard.radio.scheduled_ranging import owner
from harness.world.gauss_markov import gauss_markov_path

Array = NDArray[np.float64]

GRID_US = 20_000
OWN_ODOMETRY_US = 40_000
BEACON_US = 100_000
FIX_US = 200_000
UPDATE_US = 60_000
"""Period at which the application lets the filter process its measurements."""
FIX_DELAY_US = 120_000
"""Delay from the instant of a fix to its reception."""
SESSION_US = 20_000
"""Delay from the instant of a distance to its availability at the initiator."""
RANGING_PERIOD_S = 1.0
"""Period of all pairs, which are spread evenly over it."""
SESSION_STD_M = 0.03
"""Standard deviation of a distance, in addition to the model's floor."""
SWAY_STD_M, SWAY_TIME_CONSTANT_S = 0.3, 1.5
"""Motion of the UAVs about their places due to wind, per axis."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trouble:
    """Faults in addition to the modelled errors."""

    loss: float = 0.0
    """Share of lost beacons, at each receiver, and of lost FTM sessions."""
    nlos_fraction: float = 0.0
    nlos_mean_m: float = 3.0
    """Mean of the exponentially distributed excess of a distance without line of sight."""
    liars_m: dict[int, float] = field(default_factory=dict)
    """Excess of all distances measured by a station."""
    liars_since_s: float = 0.0
    gps_off_ned_m: dict[int, tuple[float, float, float]] = field(default_factory=dict)
    """Constant error of a station's GPS."""
    gps_off_since_s: float = 0.0
    odometry_jump_ne_m: dict[int, tuple[float, float]] = field(default_factory=dict)
    """Step of a station's odometry."""
    odometry_jump_s: float = 0.0
    shuffled: bool = False
    """Every beacon is received twice, the second time up to 0.5 s late, and thus out of order."""


NO_TROUBLE = Trouble()


@dataclass(frozen=True, slots=True)
class Ranged:
    """One measured distance."""

    initiator: int
    responder: int
    time_us: int
    distance_m: float
    std_m: float


@dataclass(frozen=True, slots=True)
class Message:
    """Measurements that arrive together: the content of a beacon, or the UAV's own data."""

    arrival_us: int
    station: int
    odometry_us: int
    """-1 if there is no odometry."""
    fix_us: int
    """-1 if there is no fix."""
    distances: tuple[Ranged, ...]


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedFlight:
    """Truth, and the messages received by station `own` in order of arrival; T instants of the grid."""

    model: LocalisationModel
    places_ned_m: Array
    """(N, 3)"""
    own: int
    pos_ned_m: Array
    """(T, N, 3) truth."""
    vel_ned_m_s: Array
    """(T, N, 3)"""
    odometry_ned_m: Array
    """(T, N, 3)"""
    fix_ned_m: Array
    """(T, N, 3) GPS position; the fixes are its samples every `FIX_US`."""
    messages: tuple[Message, ...]

    @property
    def offsets_ned_m(self) -> Array:
        """(T, N, 3) true position less odometry."""
        return self.pos_ned_m - self.odometry_ned_m

    @property
    def end_us(self) -> int:
        """Time of the last instant."""
        return (len(self.pos_ned_m) - 1) * GRID_US

    def known(self) -> tuple[list[tuple[int, int]], list[Ranged]]:
        """Return all received fixes (time_us, station) and distances, without duplicates, sorted by time."""
        fixes = {(item.fix_us, item.station) for item in self.messages if item.fix_us >= 0}
        distances = {
            (item.time_us, item.initiator, item.responder): item
            for message in self.messages
            for item in message.distances
        }
        return sorted(fixes), [distances[key] for key in sorted(distances)]

    def filtered(self) -> CooperativeLocalisation:
        """Return the UAV's filter after all messages, propagated to the end of the flight."""
        filter_ = CooperativeLocalisation(own=self.own, places_ned_m=self.places_ned_m, model=self.model)
        for _ in self.steps(filter_, until_us=self.end_us):
            pass
        filter_.advance(self.end_us)
        return filter_

    def steps(self, filter_: CooperativeLocalisation, *, until_us: int) -> Iterator[int]:
        """Feed the messages to a filter; yield the time (us) after each of its updates."""
        messages = iter(self.messages)
        message = next(messages, None)
        for now_us in range(0, until_us + 1, GRID_US):
            while message is not None and message.arrival_us <= now_us:
                self._feed(filter_, message, now_us)
                message = next(messages, None)
            if now_us % UPDATE_US == 0 or now_us == until_us:
                filter_.update(now_us)
                yield now_us

    def _feed(self, filter_: CooperativeLocalisation, message: Message, now_us: int) -> None:
        station = message.station
        if message.odometry_us >= 0:
            at = message.odometry_us // GRID_US
            odometry_ned_m, vel_ned_m_s = self.odometry_ned_m[at, station], self.vel_ned_m_s[at, station]
            filter_.on_odometry(station, message.odometry_us, odometry_ned_m.tolist(), vel_ned_m_s.tolist())
        if message.fix_us >= 0:
            filter_.on_fix(
                station, message.fix_us, self.fix_ned_m[message.fix_us // GRID_US, station].tolist()
            )
        for item in message.distances:
            filter_.on_range(
                item.initiator, item.responder, item.time_us, item.distance_m, item.std_m, now_us=now_us
            )


def simulate(
    *,
    places_ned_m: Array,
    duration_s: float,
    rng: np.random.Generator,
    own: int = 0,
    model: LocalisationModel | None = None,
    scheduled: bool = False,
    trouble: Trouble = NO_TROUBLE,
) -> SimulatedFlight:
    """Draw a simulated flight.

    Args:
        places_ned_m: (N, 3)
        duration_s: length of the flight.
        rng: generator of all random numbers.
        own: the receiving station.
        model: sensor errors; the defaults of the filter if None.
        scheduled: each pair is measured by one end only, otherwise by both.
        trouble: additional faults.

    """
    model = model or LocalisationModel()
    count = len(places_ned_m)
    steps = round(duration_s * 1e6) // GRID_US + 1
    dt_s = GRID_US * 1e-6
    sway_m = _gauss_markov(rng, (steps, count, 3), SWAY_STD_M, SWAY_TIME_CONSTANT_S)
    # Smoothed twice, so that velocity and acceleration are finite.
    for _ in range(2):
        sway_m = _smoothed(sway_m, SWAY_TIME_CONSTANT_S / 3.0)
    walk_ne_m = np.cumsum(
        rng.normal(0.0, model.odometry_drift_m_sqrt_s * np.sqrt(dt_s), (steps, count, 2)), axis=0
    )
    # The autopilot's velocity is smooth and odometry is its integral, so the random walk is in the truth.
    # Position control removes the slow part of the walk.
    flown_m = sway_m
    flown_m[..., :2] -= _smoothed(walk_ne_m, SWAY_TIME_CONSTANT_S)
    vel_ned_m_s = np.gradient(flown_m, dt_s, axis=0)
    pos_ned_m = places_ned_m + flown_m
    pos_ned_m[..., :2] += walk_ne_m

    odometry_ned_m = places_ned_m + flown_m
    odometry_ned_m[..., :2] -= odometry_ned_m[0, :, :2].copy()
    for station, jump_ne_m in trouble.odometry_jump_ne_m.items():
        odometry_ned_m[round(trouble.odometry_jump_s / dt_s) :, station, :2] += jump_ne_m
    odometry_ned_m[..., 2] -= _gauss_markov(
        rng, (steps, count), model.height_std_m, model.height_time_constant_s
    )

    bias_std_m = np.array((model.gps_bias_std_m, model.gps_bias_std_m, model.gps_bias_vertical_std_m))
    fix_ned_m = pos_ned_m + bias_std_m * _gauss_markov(
        rng, (steps, count, 3), 1.0, model.gps_bias_time_constant_s
    )
    for station, off_ned_m in trouble.gps_off_ned_m.items():
        fix_ned_m[round(trouble.gps_off_since_s / dt_s) :, station] += off_ned_m
    fix_ned_m += rng.normal(0.0, model.gps_white_std_m, fix_ned_m.shape)

    distances = _distances(pos_ned_m, rng, model, scheduled=scheduled, trouble=trouble)
    messages = _messages(steps, count, own, distances, rng, trouble)
    return SimulatedFlight(
        model, places_ned_m, own, pos_ned_m, vel_ned_m_s, odometry_ned_m, fix_ned_m, tuple(messages)
    )


def _gauss_markov(
    rng: np.random.Generator, shape: tuple[int, ...], std: float, time_constant_s: float
) -> Array:
    kept = float(np.exp(-GRID_US * 1e-6 / time_constant_s))
    fresh = rng.standard_normal(shape)
    start = std * rng.standard_normal(shape[1:])
    return gauss_markov_path(start, kept, std * float(np.sqrt(1.0 - kept * kept)), fresh)


def _smoothed(path: Array, time_constant_s: float) -> Array:
    kept = float(np.exp(-GRID_US * 1e-6 / time_constant_s))
    return gauss_markov_path(path[0].copy(), kept, 1.0 - kept, path)


def _distances(
    pos_ned_m: Array, rng: np.random.Generator, model: LocalisationModel, *, scheduled: bool, trouble: Trouble
) -> list[Ranged]:
    """Return all measured distances, sorted by time: the pairs in a fixed random order, evenly spread."""
    steps, count, _ = pos_ned_m.shape
    pairs = [(i, j) for i in range(count) for j in range(count) if i != j]
    if scheduled:
        pairs = [(i, j) for i, j in pairs if owner(i, j, count) == i]
    pairs = [pairs[k] for k in rng.permutation(len(pairs))]
    std_m = float(np.hypot(SESSION_STD_M, model.range_floor_std_m))
    found = []
    for m in range(int(len(pairs) * (steps - 1) * GRID_US * 1e-6 / RANGING_PERIOD_S)):
        i, j = pairs[m % len(pairs)]
        at = int((m + 1) * RANGING_PERIOD_S * 1e6 / len(pairs)) // GRID_US
        # The number of draws is constant, so that a fault changes nothing else.
        kept, blocked, excess, noise = rng.random(), rng.random(), rng.exponential(), rng.standard_normal()
        if kept < trouble.loss:
            continue
        distance_m = float(np.linalg.norm(pos_ned_m[at, i] - pos_ned_m[at, j])) + std_m * noise
        if blocked < trouble.nlos_fraction:
            distance_m += trouble.nlos_mean_m * excess
        if at * GRID_US >= trouble.liars_since_s * 1e6:
            distance_m += trouble.liars_m.get(i, 0.0)
        found.append(Ranged(i, j, at * GRID_US, distance_m, SESSION_STD_M))
    return found


def _messages(
    steps: int, count: int, own: int, distances: list[Ranged], rng: np.random.Generator, trouble: Trouble
) -> list[Message]:
    """Return the messages that station ``own`` receives, in order of arrival."""
    end_us = (steps - 1) * GRID_US
    phases_us = GRID_US * rng.integers(0, BEACON_US // GRID_US, count)
    fix_phases_us = GRID_US * rng.integers(0, FIX_US // GRID_US, count)
    measured: list[list[Ranged]] = [[] for _ in range(count)]
    for item in distances:
        measured[item.initiator].append(item)
    messages = []
    for station in range(count):
        period_us = OWN_ODOMETRY_US if station == own else BEACON_US
        newest: dict[int, Ranged] = {}
        done = 0
        for now_us in range(int(phases_us[station]) % period_us, end_us + 1, period_us):
            items = measured[station]
            while done < len(items) and items[done].time_us + SESSION_US <= now_us:
                newest[items[done].responder] = items[done]
                done += 1
            fix_us = now_us - FIX_DELAY_US
            fix_us -= (fix_us - int(fix_phases_us[station])) % FIX_US
            received, echo, delay_us = rng.random(), rng.integers(0, 500_000), GRID_US
            if station == own:
                received, delay_us = 1.0, 0
            if received < trouble.loss:
                continue
            message = Message(now_us + delay_us, station, now_us, max(fix_us, -1), tuple(newest.values()))
            messages.append(message)
            if trouble.shuffled and station != own:
                late_us = now_us + delay_us + int(echo)
                messages.append(Message(late_us, station, now_us, max(fix_us, -1), message.distances))
    messages.sort(key=lambda item: item.arrival_us)
    return [item for item in messages if item.arrival_us <= end_us]
