"""What a scenario says of its autopilots, checked at the door: parameters, geofence, mission."""

from pathlib import Path

from msgspec import structs

from autopilot import parameter_file, site_plan
from autopilot.config import AutopilotConfig, Site
from autopilot.params import ParameterError, ParameterSet, Settings


def with_parameter_file(config: AutopilotConfig, folder: Path) -> AutopilotConfig:
    """Put the parameter file's values, of a path relative to the scenario's folder, below ``params``.

    Raises ParameterFileError.
    """
    if config.params_file is None:
        return config
    values = parameter_file.load(folder / config.params_file)
    return structs.replace(config, params={**values, **config.params}, params_file=None)


def check(config: AutopilotConfig, site: Site, agents: int) -> None:
    """Raise ValueError with the field's path for what no autopilot could be started with."""
    _check_parameters(config.params, "autopilot.params")
    for uav, params in config.per_uav.items():
        if uav not in map(str, range(agents)):
            raise ValueError(f"autopilot.per_uav: there is no UAV {uav!r} among {agents}")
        _check_parameters(params, f"autopilot.per_uav.{uav}")
    try:
        site_plan.fence_shapes(config.fence, site)
        site_plan.mission(config.mission, site)
    except ValueError as error:
        raise ValueError(f"autopilot: {error}") from None


def _check_parameters(params: dict[str, float], path: str) -> None:
    try:
        ParameterSet(Settings(), params)
    except ParameterError as error:
        raise ValueError(f"{path}: {error}") from None
