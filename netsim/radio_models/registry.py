"""Creates the models of a run's radio by the names in ``[radio]``.

A name is that of a built-in model, that of an entry point of the group `GROUP` without the kind before its
first dot (``path_loss.two_slopes`` is ``two_slopes`` for the path loss), or ``package.module:Class``.
"""

import difflib
from collections.abc import Callable
from functools import partial
from inspect import isclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from foundation.extensions import ExtensionError, check_bounded, convert, is_path, load, registered
from netsim.model.config import RadioConfig, RadioModel
from netsim.model.random_streams import Model, RandomStreams
from netsim.phy.antenna import Dipole
from netsim.phy.errors import ERRORS
from netsim.phy.fading import RicianFading, SampledFading
from netsim.phy.interfaces import RadioContext
from netsim.phy.models import RadioModels
from netsim.phy.modes import phy_mode
from netsim.phy.path_loss import Doubles, PowerLaw, TwoRay
from netsim.phy.shadowing import LogNormalShadowing
from netsim.radio_models.checked import (
    CheckedAntennaPattern,
    CheckedErrorModel,
    CheckedFading,
    CheckedPathLoss,
    CheckedShadowing,
    LossOfDistance,
    describe,
)

GROUP = "coflight.radio"
"""Group of entry points; their names are ``kind.name``."""
STREAMS = {
    "path_loss": Model.PATH_LOSS,
    "shadowing": Model.SHADOWING,
    "fading": Model.FADING,
    "error_model": Model.ERROR_MODEL,
    "antenna": Model.ANTENNA,
}
"""Kinds of models, which are fields of ``[radio]``, with the streams of their random generators."""
EXPECTED = {rf"radio\.({'|'.join(STREAMS)})": "the name of a model, or a table with model and settings"}
"""Expected values of fields, for `harness.scenario.validation_errors.explain`."""
METHODS = {
    "path_loss": ("loss_db(from_ned_m, to_ned_m, distance_m)",),
    "shadowing": ("gain_db(from_ned_m, to_ned_m, distance_m)",),
    "fading": ("gains(source, at_ns)", "move(at_ns, pos_ned_m, vel_ned_m_s)"),
    "error_model": ("hazard(mode)",),
    "antenna": ("gain_db(direction_frd)",),
}
"""Methods that a model must have; see `netsim.phy.interfaces`."""


def _shadowing(context: RadioContext) -> LogNormalShadowing | None:
    config = context.config
    if config.shadowing_std_db == 0.0:
        return None
    return LogNormalShadowing(config.shadowing_std_db, config.shadowing_distance_m, context.streams)


def _rician(context: RadioContext) -> RicianFading | None:
    config = context.config
    if config.rician_k_db is None:
        return None
    return RicianFading(
        k_db=config.rician_k_db,
        doppler_hz=config.fading_doppler_hz,
        frequency_mhz=config.frequency_mhz,
        stations=context.stations,
        streams=context.streams,
    )


def _two_ray(context: RadioContext) -> TwoRay:
    config = context.config
    return TwoRay(frequency_mhz=config.frequency_mhz, bandwidth_mhz=config.bandwidth_mhz)


BUILT_IN: dict[str, dict[str, Callable[[RadioContext], object]]] = {
    "path_loss": {
        "friis": lambda _: PowerLaw(2.0),
        "log_distance": lambda context: PowerLaw(context.config.path_loss_exponent),
        "two_ray": _two_ray,
    },
    "shadowing": {"log_normal": _shadowing, "none": lambda _: None},
    "fading": {"rician": _rician, "none": lambda _: None},
    "error_model": {"published": lambda _: ERRORS},
    "antenna": {"isotropic": lambda _: None, "dipole": lambda _: Dipole()},
}
"""Models by kind and name that take their settings from other fields of ``[radio]``."""
SHIPPED = {
    "path_loss": {
        "table": "netsim.radio_models.table:LossTable",
        "grid": "netsim.radio_models.grid:LossGrid",
    }
}
"""Models by kind and name that are created as those of users."""


def make_models(config: RadioConfig, stations: int, streams: RandomStreams) -> RadioModels:
    """Return the models that the settings select, for vehicles and guests.

    Raises ExtensionError with one line that begins with the field, such as ``radio.path_loss``. So do the
    models' methods if a user's model raises an exception or returns anything wrong.
    """
    create = partial(_create, config, stations, streams)
    models: dict[str, Any] = {kind: create(kind) for kind in STREAMS}
    if isinstance(models["fading"], CheckedFading):
        models["fading"] = SampledFading(models["fading"], stations)
    own_antennas: dict[int, Any] = {
        each.station: create("antenna", each.antenna, f"radio.stations[{number}].antenna")
        for number, each in enumerate(config.stations)
        if each.antenna is not None
    }
    return RadioModels(**models, own_antennas=own_antennas)


def with_folder(config: RadioConfig, folder: Path) -> RadioConfig:
    """Return the settings with the folder of the scenario's file in all models that may need it."""
    changes: dict[str, RadioModel] = {}
    for kind in STREAMS:
        choice = chosen(config, kind)
        if choice.model not in BUILT_IN[kind]:
            absolute = str((folder / choice.folder).resolve())
            changes[kind] = msgspec.structs.replace(choice, folder=absolute)
    stations = tuple(
        msgspec.structs.replace(each, antenna=antenna_with_folder(each.antenna, folder))
        for each in config.stations
    )
    if not changes and stations == config.stations:
        return config
    return msgspec.structs.replace(config, stations=stations, **changes)


def antenna_with_folder(antenna: str | RadioModel | None, folder: Path) -> str | RadioModel | None:
    """Return the model of a station's antenna with the folder in which it is looked up, if it may need it."""
    if antenna is None:
        return None
    choice = _table(antenna)
    if choice.model in BUILT_IN["antenna"]:
        return antenna
    return msgspec.structs.replace(choice, folder=str((folder / choice.folder).resolve()))


def check_models(config: RadioConfig, stations: int, places_ned_m: Doubles) -> None:
    """Create the models that are not built in, and call each with a few positions.

    ``places_ned_m`` (n, 3) are the vehicles' places in the formation.

    Raises ExtensionError as `make_models`, and for a model that does not return.
    """
    for kind in STREAMS:
        name = chosen(config, kind).model
        if name not in BUILT_IN[kind]:
            check_bounded(
                partial(_check_model, config, stations, kind, places_ned_m), f"radio.{kind}: {name}"
            )
        else:
            _create(config, stations, RandomStreams(np.random.SeedSequence(0)), kind)
    for number, each in enumerate(config.stations):
        if each.antenna is not None:
            check_antenna(config, stations, each.antenna, f"radio.stations[{number}].antenna")


def check_antenna(config: RadioConfig, stations: int, antenna: str | RadioModel, field: str) -> None:
    """Create a station's antenna, and call its methods, as `check_models`; lines begin with ``field``."""

    def try_it() -> None:
        streams = RandomStreams(np.random.SeedSequence(0))
        _try_antenna(_create(config, stations, streams, "antenna", antenna, field))

    if _table(antenna).model in BUILT_IN["antenna"]:
        try_it()
    else:
        check_bounded(try_it, f"{field}: {_table(antenna).model}")


def _try_antenna(model: object) -> None:
    if isinstance(model, CheckedAntennaPattern):
        model.gain_db(np.stack((np.eye(3), -np.eye(3))))


def _check_model(config: RadioConfig, stations: int, kind: str, places_ned_m: Doubles) -> None:
    """Create a model, and call its methods with a few positions."""
    streams = RandomStreams(np.random.SeedSequence(0))
    from_ned_m = np.array([(0.0, 0.0, -10.0), (30.0, 0.0, -10.0)])
    to_ned_m = np.array([(0.0, 50.0, -20.0), (300.0, 400.0, -5.0), (2.0, 2.0, -1.0)])
    distance_m = np.linalg.norm(to_ned_m - from_ned_m[:, None], axis=2)
    match _create(config, stations, streams, kind):
        case CheckedPathLoss() as model:
            model.check_reciprocity("loss_db", from_ned_m, to_ned_m, distance_m)
            model.check_places(places_ned_m)
        case CheckedShadowing() as model:
            model.check_reciprocity("gain_db", from_ned_m, to_ned_m, distance_m)
        case CheckedAntennaPattern() as model:
            _try_antenna(model)
        case CheckedFading() as model:
            model.move(0, np.zeros((stations, 3)), np.zeros((stations, 3)))
            model.gains(0, 0)
        case CheckedErrorModel() as model:
            hazard = model.hazard(phy_mode(config.control_mode, config.bandwidth_mhz))
            for snr_db in (-10.0, 5.0, 20.0):
                hazard(snr_db)


def chosen(config: RadioConfig, kind: str) -> RadioModel:
    """Return the table of a kind of model; a name alone is one without settings."""
    return _table(getattr(config, kind))


def _table(choice: str | RadioModel) -> RadioModel:
    return RadioModel(model=choice) if isinstance(choice, str) else choice


def named(config: RadioConfig) -> dict[str, tuple[str, str]]:
    """Return the names of all models of users, and their group of entry points, by field."""
    found: dict[str, tuple[str, str]] = {}
    for kind in STREAMS:
        name = chosen(config, kind).model
        if name not in BUILT_IN[kind] and name not in SHIPPED.get(kind, {}):
            found[f"radio.{kind}"] = (name if is_path(name) else f"{kind}.{name}", GROUP)
    for number, each in enumerate(config.stations):
        if each.antenna is not None and (name := _table(each.antenna).model) not in BUILT_IN["antenna"]:
            path = name if is_path(name) else f"antenna.{name}"
            found[f"radio.stations[{number}].antenna"] = (path, GROUP)
    return found


def names(kind: str) -> list[str]:
    """Return the names of a kind of model: built-in ones, then those of entry points."""
    return list(dict.fromkeys((*BUILT_IN[kind], *SHIPPED.get(kind, {}), *_installed(kind))))


def _installed(kind: str) -> dict[str, str]:
    """Return the paths of a kind's entry points by name."""
    points = ((*name.partition("."), path) for name, path in registered(GROUP).items())
    return {name: path for point_kind, _, name, path in points if point_kind == kind}


def _create(
    config: RadioConfig, stations: int, streams: RandomStreams, kind: str,
    own: str | RadioModel | None = None, own_field: str = "",
) -> object:  # fmt: skip
    """Return the model of a kind; a user's is wrapped by a class of `netsim.radio_models.checked`.

    ``own`` and its field replace that of the settings, for one station.
    """
    choice = chosen(config, kind) if own is None else _table(own)
    field, name = own_field or f"radio.{kind}", choice.model
    context = RadioContext(
        config=config, stations=stations, folder=Path(choice.folder), streams=streams, stream=STREAMS[kind]
    )
    if name in BUILT_IN[kind]:
        if choice.settings:
            raise ExtensionError(f"{field}.settings: {name} has none; expected fields of [radio]")
        return BUILT_IN[kind][name](context)
    model = _instance(_loaded(kind, choice, field), choice, context, field)
    for method in METHODS[kind]:
        if not callable(getattr(model, method.partition("(")[0], None)):
            raise ExtensionError(
                f"{field}: {name} has no method {method}; docs/how-to/radio-models.md describes it"
            )
    if kind == "fading":
        return CheckedFading(model, field, name, stations)
    checked = {
        "path_loss": CheckedPathLoss,
        "shadowing": CheckedShadowing,
        "error_model": CheckedErrorModel,
        "antenna": CheckedAntennaPattern,
    }
    return checked[kind](model, field, name)


def _loaded(kind: str, choice: RadioModel, field: str) -> object:
    """Return the class or function that a name stands for."""
    name = choice.model
    path = SHIPPED.get(kind, {}).get(name)
    if path is None and is_path(name):
        return load(name, field=field, search=Path(choice.folder))
    if path is None and (path := _installed(kind).get(name)) is None:
        known = names(kind)
        meant = difflib.get_close_matches(name, known, 1)
        hint = f"did you mean {meant[0]}? " if meant else ""
        raise ExtensionError(
            f"{field}: no model {name!r}; {hint}expected {', '.join(known)}, or package.module:Class"
        )
    return load(path, field=field)


def _instance(found: object, choice: RadioModel, context: RadioContext, field: str) -> object:
    """Return the model of a class, or a path loss of a function of the distance."""
    name = choice.model
    if not isclass(found):
        if field == "radio.path_loss" and callable(found):
            if choice.settings:
                raise ExtensionError(f"{field}.settings: {name} is a function, which has none")
            return LossOfDistance(found)
        raise ExtensionError(f"{field}: {name} is a {type(found).__name__}; expected a class")
    kind = getattr(found, "Settings", None)
    arguments: tuple[object, ...] = () if found.__init__ is object.__init__ else (context,)
    if kind is not None:
        # the same values as in the process that reads them from a file
        values = msgspec.json.decode(msgspec.json.encode(choice.settings))
        arguments = context, convert(values, kind, field=f"{field}.settings")
    elif choice.settings:
        raise ExtensionError(f"{field}.settings: {name} has none; expected a class Settings within it")
    try:
        return found(*arguments)
    except ValueError as error:
        text = " ".join(str(error).split())
        known = text.partition(":")[0] in choice.settings
        where = f"{field}.settings." if known else f"{field}: {name}: "
        raise ExtensionError(f"{where}{text}") from error
    except (Exception, SystemExit) as error:
        raise ExtensionError(f"{field}: {name} raised {describe(error)}") from error
