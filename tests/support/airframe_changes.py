"""Airframes with some of their values changed."""

from msgspec import structs

from foundation.airframe.files import IRIS


def changed(airframe=IRIS, *, body=None, propulsion=None, **fields):
    """Return an airframe with other fields, and other values in its tables ``body`` and ``propulsion``."""
    return structs.replace(
        airframe,
        body=structs.replace(airframe.body, **(body or {})),
        propulsion=structs.replace(airframe.propulsion, **(propulsion or {})),
        **fields,
    )
