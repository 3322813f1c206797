"""The user's code that a scenario names for the autopilot: a controller, flight modes and MAVLink services.

Code takes effect only if the scenario names it, by path or by the name of an installed entry point, so equal
scenarios fly equally on machines on which different packages are installed.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from autopilot.commander.mode_table import ModeTraits
from autopilot.parameters.config import AutopilotConfig
from foundation.extension_call import ExtensionCall
from foundation.extensions import ExtensionError, convert, is_path, load, registered

CONTROLLERS, MODES, SERVICES = "coflight.controllers", "coflight.modes", "coflight.services"
"""Groups of entry points."""


class Extension(NamedTuple):
    """A class of the user, with its settings."""

    title: str
    """Field and name in the scenario, with which the lines of its failures begin."""
    kind: Any
    """The class."""
    settings: tuple[object, ...]
    """The converted settings; empty if it has none."""

    def make(self, context: object) -> Any:  # noqa: ANN401  an object of the user's class
        """Create an object. Raises ExtensionFailure for an exception of the user's code."""
        with ExtensionCall(self.title):
            return self.kind(context, *self.settings)


class Extensions(NamedTuple):
    """The user's code of one vehicle."""

    controller: Extension | None = None
    modes: tuple[Extension, ...] = ()
    services: tuple[Extension, ...] = ()


def load_extensions(config: AutopilotConfig) -> Extensions:
    """Import the classes that the settings name and convert their settings.

    Raises ExtensionError for the first that cannot be used; the line begins with the field.
    """
    controller = None
    if config.controller is not None:
        controller = _load(
            config.controller, CONTROLLERS, config.controller_settings,
            field="autopilot.controller", settings_field="autopilot.controller_settings",
            protocol="Controller", members=("reset", "update"),
        )  # fmt: skip
    elif config.controller_settings:
        raise ExtensionError("autopilot.controller_settings: there is no autopilot.controller")
    modes = _load_all(
        config.modes, MODES, config.mode_settings, field="autopilot.modes",
        settings_field="autopilot.mode_settings", protocol="FlightModeBehaviour",
        members=("traits", "enter", "update", "next_mode", "course", "apply_limits", "change_speed"),
    )  # fmt: skip
    for number, mode in enumerate(modes):
        if not isinstance(mode.kind.traits, ModeTraits):
            raise ExtensionError(
                f"autopilot.modes[{number}]: {config.modes[number]}.traits is no coflight.ModeTraits"
            )
    services = _load_all(
        config.services, SERVICES, config.service_settings, field="autopilot.services",
        settings_field="autopilot.service_settings", protocol="MavlinkService",
        members=("on_message", "on_timer", "next_deadline_us"),
    )  # fmt: skip
    return Extensions(controller, modes, services)


def path_of(name: str, group: str, *, field: str) -> str:
    """Return ``package.module:Name`` for the name of an entry point; a path is returned unchanged.

    Raises ExtensionError.
    """
    if is_path(name):
        return name
    installed = registered(group)
    if name not in installed:
        there = ", ".join(installed) or "none"
        raise ExtensionError(
            f"{field}: {name!r} is not installed; expected package.module:Class or an entry point of {group} "
            f"({there})"
        )
    return installed[name]


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
    names: Sequence[str], group: str, settings: Mapping[str, Mapping[str, Any]], *,
    field: str, settings_field: str, protocol: str, members: Sequence[str],
) -> tuple[Extension, ...]:  # fmt: skip
    """Load the classes of a list of names, each of which is in it once."""
    if unused := sorted(settings.keys() - set(names)):
        raise ExtensionError(f"{settings_field}: {unused[0]!r} is not in {field}")
    if len(set(names)) < len(names):
        twice = next(name for number, name in enumerate(names) if name in names[:number])
        raise ExtensionError(f"{field}: {twice!r} is in it twice")
    return tuple(
        _load(
            name, group, settings.get(name, {}), field=f"{field}[{number}]",
            settings_field=f"{settings_field}.{name}", protocol=protocol, members=members,
        )
        for number, name in enumerate(names)
    )  # fmt: skip


def _load(
    name: str, group: str, settings: Mapping[str, Any], *,
    field: str, settings_field: str, protocol: str, members: Sequence[str],
) -> Extension:  # fmt: skip
    """Import a class, check that it has the members of its protocol, and convert its settings."""
    kind: Any = load(path_of(name, group, field=field), field=field)
    if not isinstance(kind, type):
        raise ExtensionError(f"{field}: {name} is a {type(kind).__name__}; expected a class")
    missing = [member for member in members if not hasattr(kind, member)]
    if missing:
        raise ExtensionError(f"{field}: {name} lacks {', '.join(missing)}; expected a coflight.{protocol}")
    settings_kind = getattr(kind, "Settings", None)
    if settings_kind is None:
        if settings:
            raise ExtensionError(f"{settings_field}: {name} has no settings; expected a class Settings in it")
        return Extension(f"{field} {name}", kind, ())
    if not isinstance(settings_kind, type):
        raise ExtensionError(f"{field}: {name}.Settings is no class")
    return Extension(f"{field} {name}", kind, (convert(settings, settings_kind, field=settings_field),))
