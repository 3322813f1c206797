"""The ``[formation]`` table: places of the vehicles, which carry the antenna's elements.

Shapes are defined in the antenna's frame: x to the right of the heading, the broadside axis; y along it, the
end-fire axis; z up from the formation's height; the origin over the site's.
"""

import csv
import math
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta, Struct

from antenna.model.geometry import grid
from autopilot.parameters.config import AnyMotion
from foundation.text_file import TextFileError, read_text
from foundation.types import Array

Spacing = Annotated[float, Meta(gt=0.0, le=1000.0)]

FARTHEST_M = 10_000.0
LOWEST_M = 2.0
"""Least height of a place over the site, for take-off and landing."""
Coordinate = Annotated[float, Meta(ge=-FARTHEST_M, le=FARTHEST_M)]
COLUMNS = ("x_m", "y_m", "z_m")
"""Columns of a file of places; the last is optional."""


class FormationFileError(ValueError):
    """An invalid file of places; the text is one line that names file, row and column."""


class FormationConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The ``[formation]`` table; settings of other shapes than ``shape`` are ignored."""

    shape: Literal["grid", "line", "ring", "file"] = "grid"
    """Shape of the formation; ``file`` takes the places from ``file`` or ``points_m``."""
    columns: Annotated[int, Meta(ge=1, le=254)] = 4
    """Elements of a grid along the broadside axis."""
    rows: Annotated[int, Meta(ge=1, le=254)] = 2
    """Elements of a grid along the end-fire axis."""
    broadside_spacing_lambda: Spacing = 0.85
    """Of a grid: spacing of the columns, wavelengths."""
    endfire_spacing_lambda: Spacing = 0.25
    """Of a grid: spacing of the rows, wavelengths."""
    spacing_m: Spacing = 5.0
    """Spacing of a line, which is along the broadside axis."""
    radius_m: Spacing = 10.0
    """Radius of a ring; the first place is ahead of the centre, the others follow clockwise."""
    file: str | None = None
    """CSV file of places, relative to the scenario: a header with x_m, y_m and optionally z_m, then one row
    per UAV."""
    points_m: tuple[tuple[Coordinate, Coordinate, Coordinate], ...] = ()
    """Contents of the file, or instead of a file: x, y, z of each place."""
    height_m: Annotated[float, Meta(ge=LOWEST_M, le=500.0)] = 10.0
    """Height of the antenna frame's origin above the site, metres."""
    heading_deg: Annotated[float, Meta(ge=-360.0, le=360.0)] = 0.0
    """Compass direction of the end-fire axis, the direction of the main lobe."""
    motion: AnyMotion | None = None
    """Motion of the formation once it is formed; None: it hovers."""


def places_ned_m(config: FormationConfig, agents: int, wavelength_m: float) -> Array:
    """Return the places (agents, 3) before the formation moves, in the site's NED frame.

    Raises ValueError with the field's path if there are too few places or one is too low.
    """
    xyz_m = _places_m(config, agents, wavelength_m)
    if not np.abs(xyz_m).max() <= FARTHEST_M:
        raise ValueError(
            f"formation: {agents} places do not fit within {FARTHEST_M:g} m; reduce agents, the formation's"
            " spacing or antenna.wavelength_m"
        )
    height_m = config.height_m + xyz_m[:, 2]
    lowest = int(height_m.argmin())
    if height_m[lowest] < LOWEST_M:
        raise ValueError(
            f"formation.points_m[{lowest}]: {height_m[lowest]:.2f} m over the site, "
            f"where {LOWEST_M:g} m is the least"
        )
    c, s = math.cos(math.radians(config.heading_deg)), math.sin(math.radians(config.heading_deg))
    x_m, y_m = xyz_m[:, 0], xyz_m[:, 1]
    return np.stack([y_m * c - x_m * s, y_m * s + x_m * c, -height_m], axis=1)


def _places_m(config: FormationConfig, agents: int, wavelength_m: float) -> Array:
    """Return the places (agents, 3) in the antenna's frame."""
    match config.shape:
        case "grid":  # the first places; more rows for more vehicles
            return grid(
                max(agents, config.columns * config.rows),
                config.columns,
                config.broadside_spacing_lambda * wavelength_m,
                config.endfire_spacing_lambda * wavelength_m,
            )[:agents]
        case "line":
            return grid(agents, agents, config.spacing_m, config.spacing_m)
        case "ring":
            angle_rad = 2.0 * math.pi / agents * np.arange(agents)
            ring_m = [config.radius_m * np.sin(angle_rad), config.radius_m * np.cos(angle_rad)]
            return np.stack([*ring_m, np.zeros(agents)], axis=1)
        case "file":
            if len(config.points_m) < agents:
                there = f"{len(config.points_m)} places" if config.points_m or config.file else "no file"
                raise ValueError(f"formation.file: {there} for {agents} vehicles")
            return np.array(config.points_m[:agents], float)


def with_points(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Store the contents of ``file``, relative to the folder, in ``points_m`` of a table not validated yet.

    Raises FormationFileError.
    """
    file = table.get("file")
    if table.get("shape") != "file" or not isinstance(file, str):
        return table
    return {**table, "points_m": read_points(folder / file)}


def read_points(path: Path) -> tuple[tuple[float, float, float], ...]:
    """Read a file of places; raises FormationFileError."""
    try:
        text = read_text(path)
    except TextFileError as error:
        raise FormationFileError(str(error)) from None
    rows = csv.reader(text.splitlines(), strict=True, skipinitialspace=True)
    points: list[tuple[float, float, float]] = []
    header: list[str] | None = None
    try:
        for row in rows:
            fields = [field.strip() for field in row]
            if not any(fields):
                continue
            if header is None:
                header = fields
                if sorted(header) not in (sorted(COLUMNS), sorted(COLUMNS[:2])):
                    raise ValueError(f"expected the columns x_m,y_m or x_m,y_m,z_m, not {','.join(header)}")  # noqa: TRY301  # one place that adds file and line
                continue
            if len(fields) != len(header):
                raise ValueError(f"expected {len(header)} columns, not {len(fields)}")  # noqa: TRY301
            values = {name: _coordinate(name, field) for name, field in zip(header, fields, strict=True)}
            points.append((values["x_m"], values["y_m"], values.get("z_m", 0.0)))
    except (ValueError, csv.Error) as error:
        raise FormationFileError(f"{path}:{rows.line_num}: {error}") from None
    return tuple(points)


def _coordinate(name: str, field: str) -> float:
    """Parse a field. Raises ValueError that names its column."""
    try:
        value = float(field)
    except ValueError:
        raise ValueError(f"{name}: expected a number, not {field[:20]!r}") from None
    if not abs(value) <= FARTHEST_M:
        raise ValueError(f"{name}: {field[:20]} is not within {FARTHEST_M:g} m")
    return value
