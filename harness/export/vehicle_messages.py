"""Messages of each vehicle: its record, poses, frames and positions on the Earth."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from autopilot.onboard.application import Layout
from foundation.geometry.geodesy import ned_to_geodetic
from foundation.types import Array
from harness.export.colours import of_vehicle
from harness.export.enu import enu_of_ned, q_enu_flu_of
from harness.export.json_rows import row_contents, schema_of
from harness.export.messages import (
    SITE,
    Content,
    Message,
    Topic,
    believed_frame_of,
    frame_of,
    quaternions,
    timestamp,
    vectors,
)
from harness.records.columns import TableKind, flight_kind
from harness.scenario.scenario import Scenario

TRANSFORMS = "/tf"
STATE = "coflight.VehicleState"
_DIAGONAL_KNOWN = 2
"""`LocationFix.PositionCovarianceType` of independent errors along the axes."""
_NAMES = {"mode_name": "mode", "phase_name": "phase", "cause_names": "causes"}
"""Fields with the names of the values of other fields."""


class VehicleMessages:
    """Maps instants of the flight to messages; it holds the last GPS fix of each vehicle."""

    def __init__(
        self, scenario: Scenario, applications: Layout, layout: np.dtype[Any], *, epoch_ns: int
    ) -> None:
        """``layout``: the flight's, `harness.records.tables.flight_record`; ``epoch_ns``: UNIX time of 0."""
        kind = flight_kind(applications)
        self._scenario, self._epoch_ns = scenario, epoch_ns
        self._fields = [name for name in layout.names or () if name != "uav"]
        self._names = value_names(kind)
        self._rotors = scenario.rotors()
        self._last_fix_ned_m = np.full((scenario.agents, 3), np.nan)
        self.topics = [*_swarm_topics(), *self._vehicle_topics(kind, layout)]

    def _vehicle_topics(self, kind: TableKind, layout: np.dtype[Any]) -> Iterator[Topic]:
        own = np.dtype([(name, layout[name]) for name in self._fields])
        more = {name: {"type": "string", "description": f"`{of}` in words."} for name, of in _NAMES.items()}
        schema = schema_of(STATE, kind, own, more=more)
        for uav in range(self._scenario.agents):
            yield Topic(
                name=f"/{frame_of(uav)}/state",
                schema=STATE,
                json_schema=schema,
                description="The vehicle's row of flight.parquet, at every recorded instant.",
            )
            for name, text in (
                ("pose", "True position and attitude in `site`, at every recorded instant."),
                (
                    "believed_pose",
                    (
                        "Position by the application, or by the estimator without one, and attitude by the "
                        "estimator, in `site`."
                    ),
                ),
            ):
                yield Topic(name=f"/{frame_of(uav)}/{name}", schema="foxglove.PoseInFrame", description=text)
            for name, text in (
                ("location", "True position on the Earth, 10 times a second."),
                (
                    "believed_location",
                    (
                        "Position by the application on the Earth, with the covariance that it states, 10 "
                        "times a second."
                    ),
                ),
                ("gps", "The last GPS fix, at the first recorded instant that has it."),
            ):
                yield Topic(name=f"/{frame_of(uav)}/{name}", schema="foxglove.LocationFix", description=text)

    def messages(self, flight: NDArray[Any], seldom: NDArray[np.bool_]) -> Iterator[Message]:
        """Yield the messages of (T, N) records; locations at the instants ``seldom`` (T,) only."""
        times_ns = (flight["time_us"][:, 0] * 1_000).tolist()
        transforms: list[list[Content]] = [[] for _ in times_ns]
        for uav in range(flight.shape[1]):
            yield from self._of_vehicle(uav, flight[:, uav], times_ns, transforms, seldom)
        for time_ns, found in zip(times_ns, transforms, strict=True):
            yield Message(time_ns, TRANSFORMS, {"transforms": found})

    def _of_vehicle(
        self,
        uav: int,
        rows: NDArray[Any],
        times_ns: list[int],
        transforms: list[list[Content]],
        seldom: NDArray[np.bool_],
    ) -> Iterator[Message]:
        yield from self._states(uav, rows, times_ns)
        stamps = [timestamp(self._epoch_ns + time_ns) for time_ns in times_ns]
        true_ned_m, believed_ned_m = rows["pos_ned_m"], believed_pos_ned_m(rows)
        for topic, child, pos_ned_m, q_ned_frd in (
            ("pose", frame_of(uav), true_ned_m, rows["q_ned_frd"]),
            ("believed_pose", believed_frame_of(uav), believed_ned_m, rows["estimator_q_ned_frd"]),
        ):
            places = vectors(enu_of_ned(pos_ned_m))
            turns = quaternions(q_enu_flu_of(q_ned_frd.astype(np.float64)))
            known = (np.isfinite(pos_ned_m).all(axis=1) & np.isfinite(q_ned_frd).all(axis=1)).tolist()
            for k, (time_ns, stamp) in enumerate(zip(times_ns, stamps, strict=True)):
                if not known[k]:
                    continue
                transforms[k].append(
                    {
                        "timestamp": stamp,
                        "parent_frame_id": SITE,
                        "child_frame_id": child,
                        "translation": places[k],
                        "rotation": turns[k],
                    }
                )
                pose = {"position": places[k], "orientation": turns[k]}
                content = {"timestamp": stamp, "frame_id": SITE, "pose": pose}
                yield Message(time_ns, f"/{frame_of(uav)}/{topic}", content)
        yield from self._locations(uav, rows, times_ns, stamps, seldom)

    def _states(self, uav: int, rows: NDArray[Any], times_ns: list[int]) -> Iterator[Message]:
        rotors, topic = self._rotors[uav], f"/{frame_of(uav)}/state"
        for time_ns, content in zip(times_ns, row_contents(rows, self._fields), strict=True):
            content["rotor_speed_rad_s"] = content["rotor_speed_rad_s"][:rotors]
            content["mode_name"] = self._names["mode"].get(content["mode"], str(content["mode"]))
            content["phase_name"] = self._names["phase"].get(content["phase"], str(content["phase"]))
            content["cause_names"] = names_of_bits(content["causes"], self._names["causes"])
            yield Message(time_ns, topic, content)

    def _locations(
        self,
        uav: int,
        rows: NDArray[Any],
        times_ns: list[int],
        stamps: list[Content],
        seldom: NDArray[np.bool_],
    ) -> Iterator[Message]:
        fixes_ned_m = rows["gps_pos_ned_m"]
        before_ned_m = np.vstack([self._last_fix_ned_m[uav], fixes_ned_m[:-1]])[: len(rows)]
        is_new = np.any(fixes_ned_m != before_ned_m, axis=1)
        if len(rows):
            self._last_fix_ned_m[uav] = fixes_ned_m[-1]
        colour = of_vehicle(uav)
        heading_rad, velocity = _headings_rad(rows["q_ned_frd"]), vectors(enu_of_ned(rows["vel_ned_m_s"]))
        variances_m2 = enu_of_ned(rows["onboard_pos_std_m"].astype(np.float64)) ** 2
        for topic, frame, pos_ned_m, chosen in (
            ("location", frame_of(uav), rows["pos_ned_m"], seldom),
            ("believed_location", believed_frame_of(uav), rows["onboard_pos_ned_m"], seldom),
            ("gps", frame_of(uav), fixes_ned_m, is_new),
        ):
            at = np.flatnonzero(chosen & np.isfinite(pos_ned_m).all(axis=1))
            places = (each.tolist() for each in self._geodetic(pos_ned_m[at]))
            for k, latitude_deg, longitude_deg, altitude_m in zip(at.tolist(), *places, strict=True):
                content: Content = {
                    "timestamp": stamps[k],
                    "frame_id": frame,
                    "latitude": latitude_deg,
                    "longitude": longitude_deg,
                    "altitude": altitude_m,
                    "color": colour,
                }
                if topic == "location":
                    content |= {"heading": heading_rad[k], "velocity": velocity[k]}
                elif topic == "believed_location" and np.isfinite(variances_m2[k]).all():
                    content["position_covariance"] = np.diag(variances_m2[k]).ravel().tolist()
                    content["position_covariance_type"] = _DIAGONAL_KNOWN
                yield Message(times_ns[k], f"/{frame_of(uav)}/{topic}", content)

    def _geodetic(self, pos_ned_m: Array) -> tuple[Array, Array, Array]:
        site = self._scenario.site
        return ned_to_geodetic(
            pos_ned_m,
            origin_lat_deg=site.latitude_deg,
            origin_lon_deg=site.longitude_deg,
            origin_alt_m=site.altitude_m,
        )


def _swarm_topics() -> Iterator[Topic]:
    yield Topic(
        name=TRANSFORMS,
        schema="foxglove.FrameTransforms",
        description="Frames `uavN` (truth) and `uavN_believed` (as the vehicle estimates) in `site`, at "
        "every recorded instant.",
    )


def believed_pos_ned_m(rows: NDArray[Any]) -> Array:
    """Return the positions (..., 3) that vehicles estimate: the application's, else the estimator's."""
    onboard_ned_m: Array = rows["onboard_pos_ned_m"]
    known = np.isfinite(onboard_ned_m).all(axis=-1, keepdims=True)
    return np.where(known, onboard_ned_m, rows["estimator_pos_ned_m"])


def _headings_rad(q_ned_frd: Array) -> list[float]:
    """Return the headings of attitudes (n, 4), clockwise from north, -pi to pi."""
    w, x, y, z = (q_ned_frd[:, k] for k in range(4))
    found: list[float] = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)).tolist()
    return [each if math.isfinite(each) else 0.0 for each in found]


def value_names(kind: TableKind) -> dict[str, dict[int, str]]:
    """Return the names of the values of mode, phase and causes."""
    return {
        name: {int(value): text for value, text in kind.columns[name].values.items()}
        for name in _NAMES.values()
    }


def names_of_bits(bits: int, names: dict[int, str]) -> str:
    """Return the names of the bits that are set, separated by commas."""
    return ", ".join(name for bit, name in names.items() if bits & bit)
