"""A class of the user as a scenario names it: found, checked, and with converted settings.

A name is that of a class that coflight ships, ``package.module:Class``, or that of an entry point of an
installed distribution. An installed class takes effect only if a scenario names it, so equal scenarios fly
equally on machines on which different packages are installed.
"""

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from foundation.extension_call import ExtensionCall
from foundation.extensions import ExtensionError, convert, is_path, load, registered

NONE_SHIPPED: Mapping[str, str] = MappingProxyType({})


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


def path_of(name: str, group: str, *, field: str, shipped: Mapping[str, str] = NONE_SHIPPED) -> str:
    """Return ``package.module:Name`` for the name of an entry point; a path is returned unchanged.

    ``shipped`` are paths of coflight's own classes by name. Raises ExtensionError.
    """
    if name in shipped:
        return shipped[name]
    if is_path(name):
        return name
    installed = registered(group)
    if name not in installed:
        known = [*shipped, *installed]
        meant = difflib.get_close_matches(name, known, 1)
        hint = f"did you mean {meant[0]}? " if meant else ""
        built_in = f"{', '.join(shipped)}, " if shipped else ""
        there = ", ".join(installed) or "none"
        raise ExtensionError(
            f"{field}: {name!r} is not installed; {hint}expected {built_in}package.module:Class or an entry "
            f"point of {group} ({there})"
        )
    return installed[name]


def load_class(
    name: str, group: str, settings: Mapping[str, Any], *,
    field: str, settings_field: str, protocol: str, members: Sequence[str],
    shipped: Mapping[str, str] = NONE_SHIPPED, search: Path | None = None,
) -> Extension:  # fmt: skip
    """Import a class, check that it has the members of its protocol, and convert its settings.

    Args:
        name: see `path_of`, as ``group`` and ``shipped``.
        settings: the table of settings.
        field: path of the scenario's field with the name.
        settings_field: path of the settings' table.
        protocol: name of the protocol in `coflight`.
        members: names that the class must have.
        search: folder where modules are looked up first, as of `foundation.extensions.load`.

    Raises ExtensionError.
    """
    kind: Any = load(path_of(name, group, field=field, shipped=shipped), field=field, search=search)
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
