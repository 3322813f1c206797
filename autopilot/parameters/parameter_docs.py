"""The table of parameters for people: names, units, ranges and defaults, and what each one means.

The meaning is the docstring of the setting's field, which begins with PX4's name; it is read from the
settings' source, so that it is written down once.
"""

import re
from itertools import groupby
from operator import attrgetter

from autopilot.parameters.inert import STATED, Stated
from autopilot.parameters.table import TABLE, ParameterSet, Row, Settings
from foundation.docstrings import field_docstrings

PREFIXES = {
    "BAT": "Battery", "BAT1": "Battery", "CBRK": "Circuit breakers", "CF": "Of this project alone",
    "COM": "Commander and failsafes", "EKF2": "Estimator", "FD": "Failure detector", "GF": "Geofence",
    "HTE": "Hover thrust estimator", "IMU": "Inertial sensors", "LNDMC": "Land detector",
    "MC": "Attitude and rate control", "MIS": "Missions", "MPC": "Position control and modes",
    "NAV": "Navigation", "RTL": "Return", "SENS": "Sensors", "SIM": "Simulated battery", "THR": "Motors",
}  # fmt: skip
_MORE_PREFIXES = {
    "CA": "Geometry", "CAL": "Calibration", "CP": "Obstacles", "MAN": "Manual control", "MAV": "MAVLink",
    "MNT": "Gimbal", "RC": "Remote control", "SDLOG": "Log", "SYS": "System",
    "TRIG": "Camera", "UAVCAN": "CAN bus",
}  # fmt: skip
"""Of the parameters without effect alone."""


def group(row: Row) -> str:
    """What a parameter belongs to, by the beginning of its name."""
    return (PREFIXES | _MORE_PREFIXES)[row.name.partition("_")[0]]


_NAMED = re.compile(r"(\w+)[:,;]?\s*")
_THERE_IN = re.compile(r"^\(there in [^)]*\)[:,;]?\s*")
_UNIT = re.compile(r"(1|s|m|rad|s\^2)(/\w+(\^\d)?)?")
_SUFFIX = re.compile(r"(_(rad|m|s|us|hz|a|v|1|s2|s3|gauss|ohm|mah))+$")


def meaning(parameter: Row) -> str:
    """What the docstring of the parameter's setting says beyond the name; if nothing, the setting's name."""
    if isinstance(parameter, Stated):
        return parameter.meaning
    *parents, field = parameter.path.split(".")
    owner = attrgetter(".".join(parents))(Settings())
    text = field_docstrings(type(owner)).get(field, "")
    text = " ".join(text.split())
    if (named := _NAMED.match(text)) is not None and named[1] == parameter.name:
        text = text[named.end() :]
    text = _THERE_IN.sub("", text)
    if not text or _UNIT.fullmatch(text):
        text = _SUFFIX.sub("", field).replace("_", " ")
    return text[:1].upper() + text[1:]


def markdown() -> str:
    """Give the whole table as a page."""
    parameters = ParameterSet(Settings())
    lines = [
        "# Parameters",
        "",
        f"The autopilot's {len(TABLE)} parameters, by PX4's names and in its units. Set them in a scenario",
        "(`[autopilot.params]`, `[autopilot.per_uav.3]` for one vehicle, `params_file`), with",
        "`--set autopilot.params.NAME=VALUE`, or from a ground station, also in flight: all act at once but",
        f"EKF2_GPS_DELAY. {len(STATED)} more of PX4's stand at the end: ground stations' pages expect them,",
        "and nothing here depends on them. This page is made by `scripts/list_parameters.py`.",
    ]
    for title, rows in groupby(TABLE, key=lambda parameter: PREFIXES[parameter.name.partition("_")[0]]):
        lines += [
            "",
            f"## {title}",
            "",
            "| name | default | unit | range | meaning |",
            "|---|---|---|---|---|",
        ]
        for parameter in rows:
            default = f"{parameters.get(parameter.name):.6g}"
            limits = f"{parameter.minimum:g} .. {parameter.maximum:g}"
            lines.append(
                f"| {parameter.name} | {default} | {parameter.unit} | {limits} | {meaning(parameter)} |"
            )
    lines += [
        "",
        "## Without effect",
        "",
        "Kept, listed, saved and loaded like the others, but nothing here depends on them. The names are",
        "PX4's, and so are the defaults, of its simulated Iris. Those without a range say what the vehicle",
        "is and are read only.",
        "",
        "| name | default | unit | range | meaning in PX4 |",
        "|---|---|---|---|---|",
    ]
    for row in STATED:
        limits = "" if row.read_only else f"{row.minimum:.9g} .. {row.maximum:.9g}"
        lines.append(f"| {row.name} | {row.default:.9g} | {row.unit} | {limits} | {row.meaning} |")
    return "\n".join(lines) + "\n"
