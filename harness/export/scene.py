"""The scene as Foxglove's SceneUpdate: vehicles, places, links, trails, wind and believed positions.

Each topic is complete with its last message, but for trails, so that a viewer may begin anywhere.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.airframe.description import Airframe
from foundation.types import Array
from harness.export import colours
from harness.export.enu import enu_of_ned, flu_of_frd
from harness.export.links import SEVERITIES, LinkTable
from harness.export.messages import IDENTITY, SITE, Content, Message, Topic, frame_of, timestamp, vectors
from harness.scenario.scenario import Scenario

VEHICLES, PLACES, LINKS = "/scene/vehicles", "/scene/places", "/scene/links"
TRAILS, WIND, BELIEVED = "/scene/trails", "/scene/wind", "/scene/believed"
_DESCRIPTIONS = {
    VEHICLES: "Airframes in the frames `uavN`, and guests; red in a failsafe, grey when lost. At the "
    "start and when a colour changes.",
    PLACES: "Places of the formation, at the height of a centre of mass over them. At the start and when "
    "they move.",
    LINKS: "Links that carried frames since the message before, in the colour of their worst outcome, 10 "
    "times a second: green delivered, blue ranging, yellow received by some of a group, orange lost to "
    "noise, red collided.",
    TRAILS: "True paths of the last 10 s, twice a second.",
    WIND: "Wind at each vehicle, 0.2 m for 1 N or 1 m/s, 10 times a second.",
    BELIEVED: "Position by the application of each vehicle, with an ellipsoid of its standard deviation, 10 "
    "times a second.",
}
LINK_LIFETIME_NS = 500_000_000
TRAIL_NS, TRAIL_STEP_US, TRAIL_PARTS = 10_000_000_000, 500_000, 32
"""Lifetime of a part of the trails, time between two parts, and number of parts after which names repeat."""
_WIND_SCALE = 0.2
_ORIGIN = {"x": 0.0, "y": 0.0, "z": 0.0}
_LINE_STRIP, _LINE_LIST = 0, 2
_DARK: Content = {"r": 0.15, "g": 0.15, "b": 0.15, "a": 1.0}
_WHITE: Content = {"r": 0.95, "g": 0.95, "b": 0.95, "a": 0.6}
_FONT_PIXELS = 14.0


class Scene:
    """Maps instants of the flight and links to scene updates; it holds what was drawn last."""

    def __init__(self, scenario: Scenario, *, epoch_ns: int) -> None:
        self._airframes, self._epoch_ns = scenario.airframes(), epoch_ns
        self._guests = scenario.channel.guests
        standing_m = np.array([airframe.standing_height_m for airframe in self._airframes])
        self._over_place_enu_m = np.zeros((scenario.agents, 3))
        self._over_place_enu_m[:, 2] = standing_m
        self._states: list[tuple[bool, bool]] = []
        """Whether each vehicle is alive, and in a failsafe, as it was drawn."""
        self._places_enu_m: Array | None = None
        self._trail: list[Array] = []
        """Positions (N, 3) that are not drawn yet, the first one the last that is."""
        self._trail_from_us, self._trail_parts = 0, 0
        self.topics = [
            Topic(name=name, schema="foxglove.SceneUpdate", description=text)
            for name, text in _DESCRIPTIONS.items()
        ]

    def messages(
        self, flight: NDArray[Any], seldom: NDArray[np.bool_], links: LinkTable
    ) -> Iterator[Message]:
        """Yield the messages of (T, N) records; most only at the instants ``seldom`` (T,)."""
        for t, time_us in enumerate(flight["time_us"][:, 0].tolist()):
            rows, time_ns = flight[t], time_us * 1_000
            pos_enu_m = enu_of_ned(rows["pos_ned_m"])
            yield from self._vehicles(time_ns, rows)
            yield from self._trails(time_us, pos_enu_m)
            if seldom[t]:
                yield from self._places(time_ns, rows)
                yield self._links(time_ns, pos_enu_m, self._of_living(rows, links.take(time_ns)))
                yield self._wind(time_ns, rows, pos_enu_m)
                yield self._believed(time_ns, rows)

    def _update(self, time_ns: int, topic: str, *entities: Content) -> Message:
        return Message(time_ns, topic, {"entities": list(entities)})

    def _entity(
        self,
        time_ns: int,
        name: str,
        *,
        frame: str = SITE,
        lifetime_ns: int = 0,
        **parts: Any,  # noqa: ANN401
    ) -> Content:
        return {
            "timestamp": timestamp(self._epoch_ns + time_ns),
            "frame_id": frame,
            "id": name,
            "lifetime": timestamp(lifetime_ns),
            "frame_locked": True,
            **parts,
        }

    def _vehicles(self, time_ns: int, rows: NDArray[Any]) -> Iterator[Message]:
        states = list(zip(rows["alive"].tolist(), rows["failsafe"].tolist(), strict=True))
        if states == self._states:
            return
        self._states = states
        entities = []
        for uav, (airframe, (alive, failsafe)) in enumerate(zip(self._airframes, states, strict=True)):
            colour = colours.LOST if not alive else colours.FAILSAFE if failsafe else colours.of_vehicle(uav)
            name = frame_of(uav)
            parts = airframe_parts(airframe, name if alive else f"{name} (lost)", colour)
            entities.append(self._entity(time_ns, name, frame=name, **parts))
        for guest in self._guests:
            at = vectors(enu_of_ned(np.array([guest.pos_ned_m], dtype=np.float64)))[0]
            cube = {"pose": _pose(at), "size": {"x": 0.3, "y": 0.3, "z": 0.3}, "color": _WHITE}
            text = _text(at | {"z": at["z"] + 0.5}, guest.name, _WHITE)
            entities.append(self._entity(time_ns, f"guest {guest.name}", cubes=[cube], texts=[text]))
        yield self._update(time_ns, VEHICLES, *entities)

    def _places(self, time_ns: int, rows: NDArray[Any]) -> Iterator[Message]:
        places_enu_m = enu_of_ned(rows["desired_pos_ned_m"]) + self._over_place_enu_m
        if self._places_enu_m is not None and np.array_equal(places_enu_m, self._places_enu_m):
            return
        self._places_enu_m = places_enu_m
        spheres = [
            {"pose": _pose(at), "size": _size(0.6 * airframe.span_m), "color": colours.PLACE}
            for at, airframe in zip(vectors(places_enu_m), self._airframes, strict=True)
        ]
        yield self._update(time_ns, PLACES, self._entity(time_ns, "places", spheres=spheres))

    def _of_living(self, rows: NDArray[Any], severity: NDArray[np.int8]) -> NDArray[np.int8]:
        """Return severities without those of lost vehicles, which receive no frame to a group."""
        on_air = np.concatenate([rows["alive"], np.ones(len(self._guests), dtype=np.bool_)])
        return severity * np.outer(on_air, on_air)

    def _links(self, time_ns: int, pos_enu_m: Array, severity: NDArray[np.int8]) -> Message:
        guests_enu_m = [enu_of_ned(np.array(guest.pos_ned_m, dtype=np.float64)) for guest in self._guests]
        stations = vectors(np.vstack([pos_enu_m, *guests_enu_m]))
        lines = []
        for code, colour in enumerate(SEVERITIES):
            pairs = np.argwhere(severity == code) if colour is not None else np.empty((0, 2), np.int64)
            if len(pairs):
                used, indices = np.unique(pairs, return_inverse=True)
                lines.append(
                    {
                        "type": _LINE_LIST,
                        "pose": _pose(_ORIGIN),
                        "thickness": 2.0,
                        "scale_invariant": True,
                        "points": [stations[k] for k in used.tolist()],
                        "color": colour,
                        "indices": indices.ravel().tolist(),
                    }
                )
        entity = self._entity(time_ns, "links", lifetime_ns=LINK_LIFETIME_NS, lines=lines)
        return self._update(time_ns, LINKS, entity)

    def _trails(self, time_us: int, pos_enu_m: Array) -> Iterator[Message]:
        self._trail.append(pos_enu_m)
        if len(self._trail) < 2 or time_us - self._trail_from_us < TRAIL_STEP_US:
            return
        paths = np.stack(self._trail, axis=1)
        lines = [
            {
                "type": _LINE_STRIP,
                "pose": _pose(_ORIGIN),
                "thickness": 1.5,
                "scale_invariant": True,
                "points": vectors(path),
                "color": colours.of_vehicle(uav, alpha=0.7),
            }
            for uav, path in enumerate(paths)
        ]
        name = f"trails {self._trail_parts % TRAIL_PARTS}"
        self._trail, self._trail_from_us = [pos_enu_m], time_us
        self._trail_parts += 1
        entity = self._entity(time_us * 1_000, name, lifetime_ns=TRAIL_NS, lines=lines)
        yield self._update(time_us * 1_000, TRAILS, entity)

    def _wind(self, time_ns: int, rows: NDArray[Any], pos_enu_m: Array) -> Message:
        wind_enu = enu_of_ned(rows["wind_force_ned_n"] + rows["wind_vel_ned_m_s"])  # one of the two is 0
        lengths_m = _WIND_SCALE * np.linalg.norm(wind_enu, axis=1)
        shown = np.flatnonzero(rows["alive"] & (lengths_m > 1e-3)).tolist()
        arrows = [
            _arrow(at, wind_enu[uav], float(lengths_m[uav]), colours.WIND)
            for uav, at in zip(shown, vectors(pos_enu_m[shown]), strict=True)
        ]
        return self._update(time_ns, WIND, self._entity(time_ns, "wind", arrows=arrows))

    def _believed(self, time_ns: int, rows: NDArray[Any]) -> Message:
        pos_enu_m = enu_of_ned(rows["onboard_pos_ned_m"])
        std_enu_m = np.abs(enu_of_ned(rows["onboard_pos_std_m"].astype(np.float64)))
        known = np.isfinite(pos_enu_m).all(axis=1) & np.isfinite(std_enu_m).all(axis=1) & rows["alive"]
        shown = np.flatnonzero(known).tolist()
        places, sizes = vectors(pos_enu_m[shown]), vectors(2.0 * std_enu_m[shown])
        spheres = [
            {"pose": _pose(at), "size": size, "color": colours.of_vehicle(uav, alpha=0.3)}
            for uav, at, size in zip(shown, places, sizes, strict=True)
        ]
        return self._update(time_ns, BELIEVED, self._entity(time_ns, "believed", spheres=spheres))


def airframe_parts(airframe: Airframe, name: str, colour: Content) -> Content:
    """Return a multicopter in its frame FLU: body, arms, the discs of its rotors, a nose and its name.

    The discs of the rotors in front are in the vehicle's colour. The body is drawn smaller than the box that
    collides, which includes the arms.
    """
    span_m, radius_m = airframe.span_m, airframe.propulsion.radius_m
    hubs_frd_m = np.array([rotor.position_frd_m for rotor in airframe.rotors], dtype=np.float64)
    axes_frd = np.array([rotor.thrust_axis_frd for rotor in airframe.rotors], dtype=np.float64)
    hubs = vectors(flu_of_frd(hubs_frd_m))
    length_m, width_m, height_m = airframe.body.size_m
    body = {
        "pose": _pose(_ORIGIN),
        "size": {"x": 0.4 * length_m, "y": 0.3 * width_m, "z": 0.6 * height_m},
        "color": colour,
    }
    discs = [
        {
            "pose": {"position": hub, "orientation": _from_up(axis)},
            "size": {"x": 2.0 * radius_m, "y": 2.0 * radius_m, "z": 0.1 * radius_m},
            "bottom_scale": 1.0,
            "top_scale": 1.0,
            "color": colour | {"a": 0.6} if hub["x"] > 0.0 else _WHITE,
        }
        for hub, axis in zip(hubs, flu_of_frd(axes_frd), strict=True)
    ]
    arms = {
        "type": _LINE_LIST,
        "pose": _pose(_ORIGIN),
        "thickness": 0.04 * span_m,
        "points": [point for hub in hubs for point in (_ORIGIN | {"z": hub["z"]}, hub)],
        "color": _DARK,
    }
    nose = _arrow(_ORIGIN, np.array([1.0, 0.0, 0.0]), 0.6 * span_m, colour)
    label = _text(_ORIGIN | {"z": 0.6 * span_m}, name, colour)
    return {"cubes": [body], "cylinders": discs, "lines": [arms], "arrows": [nose], "texts": [label]}


def _pose(position: Content) -> Content:
    return {"position": position, "orientation": IDENTITY}


def _size(side_m: float) -> Content:
    return {"x": side_m, "y": side_m, "z": side_m}


def _text(position: Content, text: str, colour: Content) -> Content:
    return {
        "pose": _pose(position),
        "billboard": True,
        "font_size": _FONT_PIXELS,
        "scale_invariant": True,
        "color": colour,
        "text": text,
    }


def _arrow(tail: Content, direction: Array, length_m: float, colour: Content) -> Content:
    return {
        "pose": {"position": tail, "orientation": _from_forward(direction)},
        "shaft_length": 0.75 * length_m,
        "shaft_diameter": 0.04 * length_m,
        "head_length": 0.25 * length_m,
        "head_diameter": 0.1 * length_m,
        "color": colour,
    }


def _from_forward(direction: Sequence[float] | Array) -> Content:
    """Return the shortest rotation of the x axis to a direction."""
    x, y, z = (np.asarray(direction) / np.linalg.norm(direction)).tolist()
    if x < -1.0 + 1e-9:
        return {"x": 0.0, "y": 0.0, "z": 1.0, "w": 0.0}
    return _normalised(x=0.0, y=-z, z=y, w=1.0 + x)


def _from_up(axis: Sequence[float] | Array) -> Content:
    """Return the shortest rotation of the z axis to an axis that points upwards."""
    x, y, z = (np.asarray(axis) / np.linalg.norm(axis)).tolist()
    return _normalised(x=-y, y=x, z=0.0, w=1.0 + z)


def _normalised(**q: float) -> Content:
    length = float(np.linalg.norm(list(q.values())))
    return {name: value / length for name, value in q.items()}
