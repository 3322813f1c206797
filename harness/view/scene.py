"""What a run's records show: entries of a 3-D scene, of plots, of state time lines and of a log.

Pure: records in, entries out. All positions are in the site's frame (NED). The scene is drawn at the recorded
instants; frames and ranging sessions are drawn at the next instant after their end.
"""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from autopilot.onboard.application import Layout
from foundation.types import Array
from harness.records import columns
from harness.records.event_words import in_words
from harness.records.flight import Flight
from harness.records.pieces import Event, Piece, Rows
from harness.records.tables import flight_of
from harness.report.formation_error import formation_error
from harness.report.vehicle_colours import vehicle_colours
from harness.scenario.scenario import Scenario
from harness.view import airframe_shape, links
from harness.view.antenna_surface import Surface
from harness.view.entries import Colour, Entry, at_all_times, colour_of
from harness.view.state_lines import StateLines

TRAIL_US = 20_000_000
"""Length of a trail"""
TRAIL_STEP_US = 200_000
SURFACE_ALPHA = 110
"""Opacity of the antenna's pattern, 0 to 255: vehicles and links in it are visible"""
OCCUPANCY_ROWS = 5
"""Records of the channel, by `run.record_rate_hz`, between two points of its occupancy"""
WIND_M_PER_M_S = 0.5
"""Length of an arrow of the wind, for a velocity of the air"""
WIND_M_PER_N = 0.5
"""The same for a force of the wind"""
SIGMAS = 1.0
"""Standard deviations that an ellipsoid of a believed position reaches to"""
HEIGHT_DECIMALS = 3
"""Of plotted heights, m: a plot's axis extends to the values, also to the rounding of their computation"""
NEUTRAL: Colour = (110, 110, 110)
GREY: Colour = (150, 150, 150)
WIND: Colour = (90, 200, 250)
LOBE: Colour = (255, 220, 60)


def vehicle_path(vehicle: int) -> str:
    """Return the path of a vehicle's entity."""
    return f"world/uav-{vehicle}"


class Scene:
    """Entries of one run, made piece by piece in the order of time."""

    def __init__(self, scenario: Scenario, applications: Layout) -> None:
        self._scenario = scenario
        self._airframes = scenario.airframes()
        self._states = StateLines(columns.flight_kind(applications).columns)
        self._colours = np.array([*map(colour_of, vehicle_colours(scenario.agents))], np.uint8)
        self._standing_m = np.array([airframe.standing_height_m for airframe in self._airframes])
        self._start_us: int | None = None
        self._trail: deque[tuple[int, Array]] = deque()
        self._empty: set[str] = set()
        """Entities that show nothing now"""
        self._air: tuple[int, int] = (0, 0)
        self.formed = False
        """Whether the formation was reached"""

    def static(self) -> list[Entry]:
        """Return what does not change: vehicles in their own frames, colours and names of plots."""
        found = [at_all_times("world", "ViewCoordinates.FRD")]
        axes = np.diag([5.0, 5.0, 1.0])
        found.append(
            at_all_times(
                "world/origin", "Arrows3D", vectors=axes, origins=np.zeros((3, 3)),
                labels=["north", "east", "down"], colors=[GREY] * 3, radii=[-1.0], show_labels=True,
            )
        )  # fmt: skip
        for i, airframe in enumerate(self._airframes):
            path, colour = vehicle_path(i), self._colours[i]
            body, lines = f"{path}/airframe", airframe_shape.arms(airframe) + airframe_shape.nose(airframe)
            found.append(at_all_times(body, "LineStrips3D", strips=lines, colors=[colour], radii=[0.025]))
            half_m = [0.5 * side for side in airframe.body.size_m]
            found.append(
                at_all_times(
                    f"{path}/body", "Boxes3D", half_sizes=[half_m], colors=[colour], fill_mode="solid"
                )
            )
            circles = airframe_shape.rotor_circles(airframe)
            found.append(at_all_times(path, "LineStrips3D", strips=circles, radii=[0.015]))
            found.append(
                at_all_times(
                    f"{path}/name", "Points3D", positions=[[0.0, 0.0, 0.0]], labels=[f"UAV {i}"],
                    colors=[colour], radii=[-5.0], show_labels=True,
                )
            )  # fmt: skip
        translucent = [255, 255, 255, SURFACE_ALPHA]
        found.append(at_all_times("world/antenna/pattern", "Mesh3D", albedo_factor=translucent))
        names = [f"UAV {i}" for i in range(len(self._airframes))]
        found += [
            at_all_times(f"plots/{plot}/uavs", "SeriesLines", names=names, colors=self._colours)
            for plot in ("error", "height", "battery")
        ]
        found += [
            at_all_times(path, "SeriesLines", names=list(lines), colors=list(lines.values()))
            for path, lines in _LINES.items()
        ]
        found.append(
            at_all_times(
                "plots/ranging/error", "SeriesPoints", names=["measured - true"], colors=[LOBE],
                marker_sizes=[2.0],
            )
        )  # fmt: skip
        return found

    def entries(self, piece: Piece, *, thin: bool = False) -> list[Entry]:
        """Return what a piece adds; with ``thin`` its last instant only, for a viewer that is behind."""
        for event in piece.events:
            if event["event"] == "formationmoves":
                self._start_us = event["start_us"]
            self.formed |= event["event"] == "formed"
        found = [self._text(event) for event in piece.events]
        found += self._plots_of_radio(piece)
        flight = piece.flight[-1:] if thin else piece.flight
        if not len(flight):
            return found
        times_us = flight["time_us"][:, 0]
        found += self._vehicles(flight, times_us)
        found += self._places(flight, times_us)
        found += self._wind(flight, times_us)
        found += self._changed(links.link_entries(piece.frames, flight, times_us))
        found += self._changed(links.range_entries(piece.sessions, flight, times_us))
        found += self._trails(flight, times_us)
        found += self._plots_of_flight(flight, times_us)
        found += self._states.entries(flight, times_us)
        return found

    def _changed(self, entries: list[Entry]) -> list[Entry]:
        """Return the entries without those that show nothing, as before."""
        found = []
        for entry in entries:
            is_empty = entry.lengths is not None and not entry.lengths.any()
            if not (is_empty and entry.path in self._empty):
                found.append(entry)
            if is_empty:
                self._empty.add(entry.path)
            else:
                self._empty.discard(entry.path)
        return found

    def flight(self, rows: Rows) -> Flight:
        """Return records (T, N) as a flight, for the analysis."""
        return flight_of(rows, self._scenario, start_us=self._start_us)

    def _vehicles(self, flight: Rows, times_us: NDArray[np.int64]) -> list[Entry]:
        found = []
        for i, airframe in enumerate(self._airframes):
            of_vehicle, path = flight[:, i], vehicle_path(i)
            q_wxyz = of_vehicle["q_ned_frd"]
            rotors = len(airframe.rotors)
            colours = airframe_shape.rotor_colours(airframe, of_vehicle["rotor_speed_rad_s"][:, :rotors])
            spinning = Entry(
                path=path,
                kind="LineStrips3D",
                fields={"colors": colours.reshape(-1, 3)},
                lengths=np.full(len(times_us), rotors),
            )
            found.append(
                Entry(
                    path=path,
                    kind="Transform3D",
                    times_us=times_us,
                    fields={"translation": of_vehicle["pos_ned_m"], "quaternion": q_wxyz[:, [1, 2, 3, 0]]},
                    others=(spinning,),
                )
            )
        return found

    def _places(self, flight: Rows, times_us: NDArray[np.int64]) -> list[Entry]:
        """Return desired places, errors and believed positions with their standard deviations."""
        count = len(times_us)
        place_ned_m = flight["desired_pos_ned_m"].copy()
        place_ned_m[:, :, 2] -= self._standing_m
        each = np.full(count, flight.shape[1])
        colours = np.tile(self._colours, (count, 1))
        lines = np.stack([place_ned_m, flight["pos_ned_m"]], axis=2).reshape(-1, 2, 3)
        shown = (flight["alive"] & np.isfinite(flight["onboard_pos_ned_m"]).all(axis=2)).copy()
        std_m = flight["onboard_pos_std_m"]
        certain = shown & np.isfinite(std_m).all(axis=2)
        vehicle = np.broadcast_to(np.arange(flight.shape[1]), shown.shape)
        return [
            Entry(
                path="world/places", kind="Points3D", times_us=times_us, lengths=each,
                fields={"positions": place_ned_m.reshape(-1, 3), "colors": colours,
                        "radii": np.full(len(colours), -3.0)},
            ),
            Entry(
                path="world/errors", kind="LineStrips3D", times_us=times_us, lengths=each,
                fields={"strips": lines, "colors": colours, "radii": np.full(len(colours), -0.7)},
            ),
            Entry(
                path="world/believed/positions", kind="Points3D", times_us=times_us,
                lengths=shown.sum(axis=1),
                fields={"positions": flight["onboard_pos_ned_m"][shown],
                        "colors": self._colours[vehicle[shown]],
                        "radii": np.full(int(shown.sum()), -2.0)},
            ),
            Entry(
                path="world/believed/uncertainty", kind="Ellipsoids3D", times_us=times_us,
                lengths=certain.sum(axis=1),
                fields={"centers": flight["onboard_pos_ned_m"][certain],
                        "half_sizes": SIGMAS * std_m[certain], "colors": self._colours[vehicle[certain]]},
            ),
        ]  # fmt: skip

    def _wind(self, flight: Rows, times_us: NDArray[np.int64]) -> list[Entry]:
        vectors = WIND_M_PER_M_S * flight["wind_vel_ned_m_s"] + WIND_M_PER_N * flight["wind_force_ned_n"]
        fields = {"origins": flight["pos_ned_m"].reshape(-1, 3), "vectors": vectors.reshape(-1, 3)}
        number = vectors.shape[0] * vectors.shape[1]
        fields |= {"colors": np.tile(np.array(WIND, np.uint8), (number, 1)), "radii": np.full(number, -1.0)}
        each = np.full(len(times_us), flight.shape[1])
        return [Entry(path="world/wind", kind="Arrows3D", times_us=times_us, fields=fields, lengths=each)]

    def _trails(self, flight: Rows, times_us: NDArray[np.int64]) -> list[Entry]:
        for t, time_us in enumerate(times_us.tolist()):
            if not self._trail or time_us >= self._trail[-1][0] + TRAIL_STEP_US:
                self._trail.append((time_us, flight["pos_ned_m"][t].copy()))
        while self._trail and self._trail[0][0] < times_us[-1] - TRAIL_US:
            self._trail.popleft()
        if len(self._trail) < 2:
            return []
        tracks = np.stack([pos_ned_m for _, pos_ned_m in self._trail], axis=1)
        return [
            Entry(
                path="world/trails",
                kind="LineStrips3D",
                times_us=times_us[-1:],
                lengths=np.array([len(tracks)]),
                fields={"strips": tracks, "colors": self._colours, "radii": np.full(len(tracks), -0.8)},
            )
        ]

    def _plots_of_flight(self, flight: Rows, times_us: NDArray[np.int64]) -> list[Entry]:
        error = formation_error(self.flight(flight))
        series: dict[str, Array] = {
            "plots/error/uavs": np.where(flight["alive"], error.absolute.error_m, np.nan),
            "plots/height/uavs": np.round(-flight["pos_ned_m"][:, :, 2], HEIGHT_DECIMALS),
            "plots/battery/uavs": 100.0 * flight["battery_remaining"].astype(np.float64),
        }
        valid = error.shape.valid
        count = np.maximum(valid.sum(axis=1), 1)
        square_m2 = np.where(valid, error.shape.error_m, 0.0) ** 2
        series["plots/error/shape"] = np.where(
            valid.any(axis=1), np.sqrt(square_m2.sum(axis=1) / count), np.nan
        )
        return [scalars(path, times_us, values) for path, values in series.items()]

    def _plots_of_radio(self, piece: Piece) -> list[Entry]:
        found: list[Entry] = []
        if len(piece.air):
            air = piece.air[::-1][::OCCUPANCY_ROWS][::-1]
            time_us = np.concatenate([[self._air[0]], air["time_us"]])
            busy_ns = np.concatenate([[self._air[1]], air["busy_ns"]])
            share = 100.0 * np.diff(busy_ns) / (np.diff(time_us) * 1e3)
            found.append(scalars("plots/channel/busy", air["time_us"], share))
            self._air = int(time_us[-1]), int(busy_ns[-1])
        until_us = np.array([piece.until_us])
        seconds = (piece.until_us - piece.after_us) * 1e-6
        names = ("delivered", "collided", "lost_to_noise")
        rates = np.array([[piece.frames[name].sum() / seconds for name in names]])
        found.append(scalars("plots/frames/receptions", until_us, rates))
        done = piece.sessions[piece.sessions["status"] == b"ok"]
        if len(done):
            found.append(
                scalars(
                    "plots/ranging/error",
                    done["measured_ns"] // 1_000,
                    done["distance_m"] - done["true_distance_m"],
                )
            )
        if piece.gains is not None:
            there = piece.gains[np.isfinite(piece.gains["max_gain_dbi"])]
            if len(there):
                found.append(scalars("plots/gain/maximum", there["time_us"], there["max_gain_dbi"]))
        return found

    def _text(self, event: Event) -> Entry:
        return Entry(
            path=f"log/{event['event']}",
            kind="TextLog",
            times_us=np.array([event["time_us"]]),
            fields={"text": [event_text(event)], "level": [in_words(event).level.value]},
        )


_LINES: dict[str, dict[str, Colour]] = {
    "plots/error/shape": {"shape, RMS": NEUTRAL},
    "plots/channel/busy": {"channel busy, %": NEUTRAL},
    "plots/frames/receptions": {
        "delivered": links.DELIVERED, "collided": links.COLLIDED, "lost to noise": links.LOST,
    },
    "plots/gain/maximum": {"maximum gain, dBi": LOBE},
}  # fmt: skip
"""Names and colours of lines by plot"""


def event_text(event: Event) -> str:
    """Return an event in one line."""
    _, vehicle, text = in_words(event)
    return text if vehicle is None else f"UAV {vehicle}: {text}"


def scalars(path: str, times_us: NDArray[np.int64], values: Array) -> Entry:
    """Return values over time, (T,) without those that are not finite, or of several lines (T, n)."""
    if values.ndim == 2:
        lengths = np.full(len(values), values.shape[1])
        return Entry(
            path=path, kind="Scalars", times_us=times_us, fields={"scalars": values.ravel()}, lengths=lengths
        )
    there = np.isfinite(values)
    return Entry(path=path, kind="Scalars", times_us=times_us[there], fields={"scalars": values[there]})


def surface_entries(surface: Surface, time_us: int) -> list[Entry]:
    """Return the antenna's pattern, its main lobe and its gain at an instant."""
    at = np.array([time_us])
    share = np.clip((surface.gain_dbi - surface.max_gain_dbi + 20.0) / 20.0, 0.0, 1.0)
    colours = np.stack([60 + 195 * share, 70 + 110 * share, 200 - 160 * share], axis=1)
    vertices = {"vertex_positions": surface.vertices_ned_m, "vertex_colors": colours.astype(np.uint8)}
    count = len(surface.vertices_ned_m)
    lobe = {"origins": surface.centre_ned_m[None], "vectors": 1.15 * surface.lobe_ned_m[None]}
    label = f"{surface.max_gain_dbi:.1f} dBi" if math.isfinite(surface.max_gain_dbi) else ""
    return [
        Entry(
            path="world/antenna/pattern", kind="Mesh3D", times_us=at, lengths=np.array([count]),
            fields=vertices,
        ),
        Entry(
            path="world/antenna/pattern", kind="Mesh3D", times_us=at,
            lengths=np.array([len(surface.triangles)]), fields={"triangle_indices": surface.triangles},
        ),
        Entry(
            path="world/antenna/main_lobe", kind="Arrows3D", times_us=at,
            fields=lobe | {"labels": [label], "colors": [LOBE], "radii": [-2.0]},
        ),
    ]  # fmt: skip
