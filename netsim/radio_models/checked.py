"""Models of users, wrapped so that each wrong result is one line with the model's name and what is expected.

The lines begin with the field that selects the model, such as ``radio.path_loss``.
"""

import traceback
from collections.abc import Callable
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.extensions import ExtensionError
from netsim.phy.modes import PhyMode
from netsim.phy.path_loss import Doubles


def describe(error: BaseException) -> str:
    """Return type, text and place of an exception in one line."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text} at {last.filename}:{last.lineno}"


def _read_only(argument: object) -> object:
    if not isinstance(argument, np.ndarray):
        return argument
    view = argument.view()
    view.flags.writeable = False
    return view


class _Checked:
    """A model that ``field`` of the scenario selects by ``name``."""

    def __init__(self, model: Any, field: str, name: str) -> None:  # noqa: ANN401
        self._model = model
        self._at = f"{field}: {name}"

    def _call(self, method: str, *arguments: object) -> Any:  # noqa: ANN401
        """Return the result of a method. Raises ExtensionError if the method raises an exception.

        Arrays are passed as views that the method cannot change: they belong to the emulator.
        """
        try:
            return getattr(self._model, method)(*map(_read_only, arguments))
        except (Exception, SystemExit) as error:
            raise ExtensionError(f"{self._at}.{method} raised {describe(error)}") from error

    def _array(self, method: str, shape: tuple[int, ...], what: str, *arguments: object) -> Doubles:
        """Return the result of a method as an array. Raises ExtensionError if it has another shape."""
        result = self._call(method, *arguments)
        try:
            values = np.asarray(result)
        except ValueError:  # rows of different lengths
            values = np.asarray(None)
        if values.dtype.kind not in "fiu":
            raise ExtensionError(
                f"{self._at}.{method} returned {type(result).__name__}; expected an array of floats, {what}"
            )
        if values.shape != shape:
            raise ExtensionError(
                f"{self._at}.{method} returned the shape {values.shape}; expected {shape}, {what}"
            )
        return values.astype(np.float64, copy=False)

    def _refuse(
        self, method: str, values: Doubles, valid: NDArray[np.bool_], where: Doubles | None, expected: str
    ) -> None:
        """Raise ExtensionError with the first value that is not valid, if there is one."""
        if valid.all():
            return
        first = np.unravel_index(int(np.argmin(valid)), valid.shape)
        at = "" if where is None else f" at a distance of {where[first]:g} m"
        raise ExtensionError(f"{self._at}.{method} returned {values[first]:g}{at}; expected {expected}")


class _CheckedLinks(_Checked):
    """A model of links between positions."""

    def check_reciprocity(
        self, method: str, from_ned_m: Doubles, to_ned_m: Doubles, distance_m: Doubles
    ) -> None:
        """Call a method for both directions. Raises ExtensionError if the results differ."""
        call = getattr(self, method)
        there_db, back_db = call(from_ned_m, to_ned_m, distance_m), call(to_ned_m, from_ned_m, distance_m.T).T
        different = ~np.isclose(there_db, back_db, rtol=1e-6, atol=1e-6)
        if different.any():
            i, j = np.argwhere(different)[0]
            raise ExtensionError(
                f"{self._at}.{method} returned {there_db[i, j]:g} dB from {from_ned_m[i].tolist()} to "
                f"{to_ned_m[j].tolist()}, and {back_db[i, j]:g} dB back; expected equal values"
            )


class CheckedPathLoss(_CheckedLinks):
    """See `netsim.phy.interfaces.PathLoss`."""

    def loss_db(self, from_ned_m: Doubles, to_ned_m: Doubles, distance_m: Doubles) -> Doubles:
        """See `netsim.phy.interfaces.PathLoss`."""
        what = "a loss for each distance"
        losses_db = self._array("loss_db", distance_m.shape, what, from_ned_m, to_ned_m, distance_m)
        expected = "losses of 0 dB or more, since less is a gain above 1"
        self._refuse("loss_db", losses_db, losses_db >= 0.0, distance_m, expected)
        return losses_db

    def check_places(self, pos_ned_m: Doubles) -> None:
        """Check the vehicles' places (n, 3), if the model has such a check. Raises ExtensionError."""
        if hasattr(self._model, "check_places"):
            try:
                self._model.check_places(pos_ned_m)
            except ValueError as error:
                raise ExtensionError(f"{self._at}: {error}") from None


class CheckedShadowing(_CheckedLinks):
    """See `netsim.phy.interfaces.Shadowing`."""

    def gain_db(self, from_ned_m: Doubles, to_ned_m: Doubles, distance_m: Doubles) -> Doubles:
        """See `netsim.phy.interfaces.Shadowing`."""
        what = "a gain for each distance"
        gains_db = self._array("gain_db", distance_m.shape, what, from_ned_m, to_ned_m, distance_m)
        self._refuse("gain_db", gains_db, np.isfinite(gains_db), distance_m, "finite gains in dB")
        return gains_db


class CheckedAntennaPattern(_Checked):
    """See `netsim.phy.interfaces.AntennaPattern`."""

    def gain_db(self, direction_frd: Doubles) -> Doubles:
        """See `netsim.phy.interfaces.AntennaPattern`."""
        gains_db = self._array(
            "gain_db", direction_frd.shape[:-1], "a gain for each direction", direction_frd
        )
        self._refuse("gain_db", gains_db, gains_db < inf, None, "gains in dB, or -inf")
        return gains_db


class CheckedFading(_Checked):
    """See `netsim.phy.interfaces.Fading`."""

    def __init__(self, model: Any, field: str, name: str, stations: int) -> None:  # noqa: ANN401
        super().__init__(model, field, name)
        self._stations = stations

    def gains(self, source: int, at_ns: int) -> Doubles:
        """See `netsim.phy.interfaces.Fading`."""
        gains = self._array("gains", (self._stations,), "a gain for each station", source, at_ns)
        valid = (gains >= 0.0) & (gains < inf)
        self._refuse("gains", gains, valid, None, "linear power gains of 0 or more")
        return gains

    def move(self, at_ns: int, pos_ned_m: Doubles, vel_ned_m_s: Doubles) -> None:
        """See `netsim.phy.interfaces.Fading`."""
        self._call("move", at_ns, pos_ned_m, vel_ned_m_s)


class CheckedErrorModel(_Checked):
    """See `netsim.phy.interfaces.ErrorModel`."""

    def hazard(self, mode: PhyMode) -> Callable[[float], float]:
        """See `netsim.phy.interfaces.ErrorModel`."""
        function = self._call("hazard", mode)
        if not callable(function):
            raise ExtensionError(
                f"{self._at}.hazard returned {type(function).__name__} for {mode.name}; expected a function "
                "of the SNR in dB"
            )

        def checked(snr_db: float) -> float:
            try:
                hazard = float(function(snr_db))
            except (Exception, SystemExit) as error:
                raise ExtensionError(f"{self._at}.hazard({mode.name}) raised {describe(error)}") from error
            if not 0.0 <= hazard < inf:
                raise ExtensionError(
                    f"{self._at}.hazard({mode.name}) returned {hazard:g} at {snr_db:g} dB; expected a loss "
                    "rate per bit of 0 or more"
                )
            return hazard

        return checked


class LossOfDistance:
    """Path loss by a function of the distance (m, n) alone; see `netsim.phy.interfaces.PathLoss`."""

    def __init__(self, function: Callable[[Doubles], Doubles]) -> None:
        self._function = function

    def loss_db(self, _from_ned_m: Doubles, _to_ned_m: Doubles, distance_m: Doubles) -> Doubles:
        """See `netsim.phy.interfaces.PathLoss`."""
        return self._function(distance_m)
