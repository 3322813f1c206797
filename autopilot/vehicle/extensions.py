"""The user's code that a scenario names for the autopilot: a controller, flight modes and MAVLink services.

Code takes effect only if the scenario names it, by path or by the name of an installed entry point, so equal
scenarios fly equally on machines on which different packages are installed.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from autopilot.commander.mode_table import ModeTraits
from autopilot.parameters.config import AutopilotConfig
from foundation.extension_class import Extension, load_class
from foundation.extensions import ExtensionError

CONTROLLERS, MODES, SERVICES = "coflight.controllers", "coflight.modes", "coflight.services"
"""Groups of entry points."""


class Extensions(NamedTuple):
    """The user's code of one vehicle."""

    controller: Extension | None = None
    modes: tuple[Extension, ...] = ()
    services: tuple[Extension, ...] = ()


def load_extensions(config: AutopilotConfig) -> Extensions:
    """Import the classes that the settings name and convert their settings.

    Raises ExtensionError for the first that cannot be used; the line begins with the field.
    """
    controller, search = None, Path(config.folder)
    if config.controller is not None:
        controller = load_class(
            config.controller, CONTROLLERS, config.controller_settings,
            field="autopilot.controller", settings_field="autopilot.controller_settings",
            protocol="Controller", members=("reset", "update"), search=search,
        )  # fmt: skip
    elif config.controller_settings:
        raise ExtensionError("autopilot.controller_settings: there is no autopilot.controller")
    modes = _load_all(
        config.modes, MODES, config.mode_settings, search, field="autopilot.modes",
        settings_field="autopilot.mode_settings", protocol="FlightModeBehaviour",
        members=("traits", "enter", "update", "next_mode", "course", "apply_limits", "change_speed"),
    )  # fmt: skip
    for number, mode in enumerate(modes):
        if not isinstance(mode.kind.traits, ModeTraits):
            raise ExtensionError(
                f"autopilot.modes[{number}]: {config.modes[number]}.traits is no coflight.ModeTraits"
            )
    services = _load_all(
        config.services, SERVICES, config.service_settings, search, field="autopilot.services",
        settings_field="autopilot.service_settings", protocol="MavlinkService",
        members=("on_message", "on_timer", "next_deadline_us"),
    )  # fmt: skip
    return Extensions(controller, modes, services)


def named(config: AutopilotConfig) -> dict[str, tuple[str, str]]:
    """Return the name of all code that the settings name, and its group of entry points, by field."""
    found = {} if config.controller is None else {"autopilot.controller": (config.controller, CONTROLLERS)}
    for field, names, group in (
        ("autopilot.modes", config.modes, MODES),
        ("autopilot.services", config.services, SERVICES),
    ):
        found |= {f"{field}[{number}]": (name, group) for number, name in enumerate(names)}
    return found


def _load_all(
    names: Sequence[str], group: str, settings: Mapping[str, Mapping[str, Any]], search: Path, *,
    field: str, settings_field: str, protocol: str, members: Sequence[str],
) -> tuple[Extension, ...]:  # fmt: skip
    """Load the classes of a list of names, each of which is in it once."""
    if unused := sorted(settings.keys() - set(names)):
        raise ExtensionError(f"{settings_field}: {unused[0]!r} is not in {field}")
    if len(set(names)) < len(names):
        twice = next(name for number, name in enumerate(names) if name in names[:number])
        raise ExtensionError(f"{field}: {twice!r} is in it twice")
    return tuple(
        load_class(
            name, group, settings.get(name, {}), field=f"{field}[{number}]",
            settings_field=f"{settings_field}.{name}", protocol=protocol, members=members, search=search,
        )
        for number, name in enumerate(names)
    )  # fmt: skip
