"""The ``[vehicle]`` table: which airframe each vehicle has."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct

from autopilot.parameters.airframe_settings import settings_of
from autopilot.parameters.config import AutopilotConfig
from foundation.airframe import files
from foundation.airframe.description import Airframe
from foundation.airframe.files import DEFAULT, AirframeError
from foundation.types import Array


class OneVehicle(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One of ``[vehicle.per_uav.N]``."""

    airframe: str
    """As ``vehicle.airframe``, for this vehicle."""


class VehicleTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The scenario's ``[vehicle]`` table."""

    airframe: str = DEFAULT
    """Airframe of all vehicles: the name of a packaged one, a file (.toml) relative to the scenario, or a
    name in ``airframes``."""
    per_uav: dict[str, OneVehicle] = {}
    """Airframes of single vehicles by their number."""
    airframes: dict[str, Airframe] = {}
    """Airframes by name, with the fields of an airframe file; those of the files that are named are added."""

    def name_of(self, instance: int) -> str:
        """Return the name or file of a vehicle's airframe."""
        own = self.per_uav.get(str(instance))
        return self.airframe if own is None else own.airframe

    def airframe_of(self, instance: int) -> Airframe:
        """Return a vehicle's airframe. Raises AirframeError."""
        name = self.name_of(instance)
        return self.airframes[name] if name in self.airframes else _loaded(name)

    def path_of(self, instance: int) -> str:
        """Return the path of the field that names a vehicle's airframe."""
        return f"vehicle.per_uav.{instance}.airframe" if str(instance) in self.per_uav else "vehicle.airframe"


@cache
def _loaded(name: str) -> Airframe:
    return files.load(name)


def with_files(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Add the airframe files that the table names, relative to the folder, to its ``airframes``.

    The table is not validated yet: values of other types are left to the later validation. Raises
    AirframeError, which names the field.
    """
    named = [("vehicle.airframe", table.get("airframe"))]
    if isinstance(of_vehicles := table.get("per_uav"), dict):
        named += [
            (f"vehicle.per_uav.{uav}.airframe", each.get("airframe"))
            for uav, each in of_vehicles.items()
            if isinstance(each, dict)
        ]
    added: dict[str, Any] = {}
    for field, name in named:
        if isinstance(name, str) and files.is_path(name):
            try:
                added[name] = msgspec.to_builtins(files.load(name, folder))
            except AirframeError as error:
                raise AirframeError(f"{field}: {error}") from None
    given = table.get("airframes", {})
    return {**table, "airframes": {**given, **added}} if added and isinstance(given, dict) else table


def check(config: VehicleTable, autopilot: AutopilotConfig, agents: int) -> None:
    """Check the airframes of all vehicles. Raises ValueError with the field's path."""
    for uav in config.per_uav:
        if uav not in map(str, range(agents)):
            raise ValueError(f"vehicle.per_uav: there is no UAV {uav!r} among {agents}")
    checked: list[Airframe] = []
    for instance in range(agents):
        field, name = config.path_of(instance), config.name_of(instance)
        try:
            airframe = config.airframe_of(instance)
        except AirframeError as error:
            raise ValueError(f"{field}: {error}") from None
        if autopilot.is_external(instance) and airframe != files.IRIS:
            raise ValueError(
                f"{field}: {name} for UAV {instance}, which runs {autopilot.kind_of(instance)} with the "
                f"parameters of the Iris; expected {DEFAULT}, or autopilot.kind to be own"
            )
        if not any(airframe is each for each in checked):
            checked.append(airframe)
            try:
                settings_of(airframe)
            except ValueError as error:
                raise ValueError(f"{field}: {name}: {error}") from None


def check_spacing(airframes: Sequence[Airframe], places_ned_m: Array) -> None:
    """Check the distances of the places (n, 3). Raises ValueError."""
    if len(airframes) < 2:
        return
    i, j = np.triu_indices(len(airframes), 1)
    spacing_m = np.array([airframe.spacing_m for airframe in airframes])
    needed_m = 0.5 * (spacing_m[i] + spacing_m[j])
    apart_m = np.linalg.norm(places_ned_m[i] - places_ned_m[j], axis=1)
    tightest = np.argmin(apart_m - needed_m)
    if not apart_m[tightest] >= needed_m[tightest]:
        raise ValueError(
            f"formation: places {apart_m[tightest]:.2f} m apart; vehicles this size need "
            f"{needed_m[tightest]:g} m"
        )
