"""Parameters that a PX4 is started with, checked by PX4's own list.

They are those that suit this simulator, those of the simulated receiver, and the scenario's. A SITL build
contains the list of its parameters with their ranges, ``etc/extras/parameters.json.xz``. Names differ between
versions, so parameters of the first two kinds that a build does not have are left out, while a scenario's are
an error.
"""

import difflib
import functools
import lzma
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from harness.world.sensors.config import GpsModel

SIMULATION_PARAMETERS: Mapping[str, float] = {"EKF2_HGT_REF": 0, "EKF2_GPS_CTRL": 5, "SENS_BAR_AUTOCAL": 0}
"""Height from the barometer (PX4: 1, GPS); GPS position and velocity without height (PX4: 7); no calibration
of the barometer by GPS heights on the ground, which shifts it by metres (PX4 from v1.17: 1).

The vertical error of a consumer receiver is metres, the drift of the barometer decimetres.
"""
PARAMETER_LIST = Path("etc") / "extras" / "parameters.json.xz"
_MS_PER_S = 1e3
_DRIFT_FILTER_S = 10.0
"""Time constant of the filter of a fix's drift on the ground in PX4's estimator."""
_DRIFT_SIGMAS = 5.0
_LEAST_DRIFT_M_S, _MOST_DRIFT_M_S = {"H": 0.1, "V": 0.2}, {"H": 1.0, "V": 1.5}
"""PX4's default and maximum of EKF2_REQ_HDRIFT and EKF2_REQ_VDRIFT."""


class Px4Parameter(Struct, frozen=True):
    """One entry of PX4's list, in its units."""

    name: str
    min: float | None = None
    max: float | None = None


class _ParameterList(Struct, frozen=True):
    parameters: list[Px4Parameter]


def known_parameters(build: Path) -> dict[str, Px4Parameter] | None:
    """Return the parameters of a build by name; None if it contains no readable list."""
    path = build / PARAMETER_LIST
    try:
        return _read(path, path.stat().st_mtime_ns)
    except (OSError, EOFError, lzma.LZMAError, msgspec.DecodeError):
        return None


@functools.lru_cache(maxsize=4)
def _read(path: Path, changed_ns: int) -> dict[str, Px4Parameter]:  # noqa: ARG001  another list if changed
    """Return the parameters of a list, which is read once for all vehicles."""
    with lzma.open(path) as file:
        listed = msgspec.json.decode(file.read(), type=_ParameterList)
    return {parameter.name: parameter for parameter in listed.parameters}


def error_in(params: Mapping[str, float], known: Mapping[str, Px4Parameter]) -> str | None:
    """Return a line on the first parameter that PX4 does not have or whose value is out of its range."""
    for name, value in params.items():
        parameter = known.get(name)
        if parameter is None:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"; {near[0]} exists" if near else ""
            return f"{name}: this PX4 has no such parameter{hint}"
        low = -math.inf if parameter.min is None else parameter.min
        high = math.inf if parameter.max is None else parameter.max
        if not low <= value <= high:
            return f"{name}: {value:g} is out of its range, {low:g} to {high:g}"
    return None


def known_ones(params: Mapping[str, float], known: Mapping[str, Any] | None) -> dict[str, float]:
    """Return the parameters that a build has; all if its list is None."""
    return {name: value for name, value in params.items() if known is None or name in known}


def receiver_parameters(model: GpsModel) -> dict[str, float]:
    """Return the parameters that follow from the simulated receiver.

    PX4 rejects fixes that drift on the ground, by their filtered rate with time constant T = 10 s. For a
    first-order Gauss-Markov error of std σ and time constant τ this rate has a std of σ / T sqrt(T / (T +
    τ)).
    """
    parameters = {"EKF2_GPS_DELAY": model.delay_s * _MS_PER_S}
    share = _DRIFT_FILTER_S / (_DRIFT_FILTER_S + model.bias_time_constant_s)
    for axis, std_m in (("H", model.horizontal_bias_std_m), ("V", model.vertical_bias_std_m)):
        most_m_s = _DRIFT_SIGMAS * std_m / _DRIFT_FILTER_S * math.sqrt(share)
        if most_m_s > _LEAST_DRIFT_M_S[axis]:
            parameters[f"EKF2_REQ_{axis}DRIFT"] = min(round(most_m_s, 3), _MOST_DRIFT_M_S[axis])
    return parameters
