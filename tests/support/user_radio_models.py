"""Models of the radio as a user writes them, right and wrong ones."""

import sys
import threading
from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np

from netsim.model.random_streams import Model, RandomStreams
from netsim.phy.errors import ERRORS
from netsim.phy.fading import RicianFading, gain
from netsim.phy.interfaces import RadioContext
from netsim.phy.path_loss import Doubles, friis_loss_db


@dataclass(frozen=True)
class ExponentSettings:
    exponent: Annotated[float, msgspec.Meta(ge=1.0, le=8.0)]


class PowerLaw:
    """The built-in power law."""

    Settings = ExponentSettings

    def __init__(self, radio: RadioContext, settings: ExponentSettings) -> None:
        self._exponent = settings.exponent
        self._at_1_m_db = friis_loss_db(1.0, radio.config.frequency_mhz)

    def loss_db(self, _from_ned_m: Doubles, _to_ned_m: Doubles, distance_m: Doubles) -> Doubles:
        return self._at_1_m_db + 10.0 * self._exponent * np.log10(distance_m)


def free_space(distance_m: Doubles) -> Doubles:
    return friis_loss_db(1.0, 5210.0) + 20.0 * np.log10(distance_m)


class Wall:
    """30 dB of shadow between stations on different sides of the plane north = 5 m."""

    def gain_db(self, from_ned_m: Doubles, to_ned_m: Doubles, _distance_m: Doubles) -> Doubles:
        return np.where((from_ned_m[:, 0] > 5.0)[:, None] != (to_ned_m[:, 0] > 5.0), -30.0, 0.0)


class Cardioid:
    """A pattern with its peak ahead and a null behind."""

    def gain_db(self, direction_frd: Doubles) -> Doubles:
        with np.errstate(divide="ignore"):
            return 20.0 * np.log10(0.5 + 0.5 * direction_frd[..., 0])


class Dipole:
    """The gain of a half-wave dipole along the body's z axis, without its polarisation."""

    def gain_db(self, direction_frd: Doubles) -> Doubles:
        cosine = direction_frd[..., 2]
        field = np.cos(0.5 * np.pi * cosine) / np.sqrt(np.maximum(1.0 - cosine**2, 1e-12))
        return 20.0 * np.log10(np.maximum(np.abs(field), 1e-9))


class Rician:
    """The built-in fading, called from Python for every frame."""

    def __init__(self, radio: RadioContext) -> None:
        config = radio.config
        self._stations = radio.stations
        self._waves = RicianFading(
            k_db=config.rician_k_db or 0.0,
            doppler_hz=config.fading_doppler_hz,
            frequency_mhz=config.frequency_mhz,
            stations=radio.stations,
            streams=radio.streams,
        )
        self.move = self._waves.move

    def gains(self, source: int, at_ns: int) -> Doubles:
        receivers = range(self._stations)
        return np.array([gain(self._waves.block, self._stations, source, r, at_ns) for r in receivers])


class Published:
    """The built-in error model."""

    def hazard(self, mode):
        return ERRORS.hazard(mode)


class LossPerBit:
    """Loses the same share of bits at every ratio up to a limit."""

    def hazard(self, _mode):
        return lambda snr_db: 1e-3 if snr_db < 40.0 else 0.0


class Drawn:
    """A loss that is drawn once, from the random stream of path losses."""

    def __init__(self, radio: RadioContext) -> None:
        same = RandomStreams(np.random.SeedSequence(1)).generator(Model.PATH_LOSS, 7)
        self.loss = float(radio.generator(7).uniform(60.0, 70.0))
        self.of_seed_1 = float(same.uniform(60.0, 70.0))

    def loss_db(self, _from_ned_m: Doubles, _to_ned_m: Doubles, distance_m: Doubles) -> Doubles:
        return np.full_like(distance_m, self.loss)


# --- wrong ones

UNTIL = threading.Event()
"""Set to let `waits` return."""


class WithoutMethod:
    pass


class WithoutMove:
    def gains(self, _source, _at_ns):
        return np.ones(2)


class RaisesAtStart:
    def __init__(self, _radio):
        raise KeyError("level")


class RefusesSettings:
    Settings = ExponentSettings

    def __init__(self, _radio, _settings):
        raise ValueError("exponent: 3 and 4 only")


def wrong_shape(distance_m):
    return distance_m[0]


def not_a_number(distance_m):
    return np.where(distance_m > 100.0, np.nan, 60.0)


def gain_above_one(distance_m):
    return 20.0 * np.log10(distance_m / 1e6)


def no_array(_distance_m):
    return "60 dB"


def raises(distance_m):
    return distance_m / {}


def exits(_distance_m):
    sys.exit(3)


def changes_distances(distance_m):
    distance_m += 5.0
    return 60.0 + distance_m


def waits(distance_m):
    UNTIL.wait()
    return 60.0 + 0.0 * distance_m


class RefusesRadio:
    def __init__(self, _radio):
        raise ValueError("5 GHz only")


class UpwardsOnly:
    """A loss that differs between the two directions of a link."""

    def loss_db(self, from_ned_m, to_ned_m, distance_m):
        return 60.0 + np.maximum(to_ned_m[:, 2] - from_ned_m[:, None, 2], 0.0) + 0.0 * distance_m


def fine_until_far(distance_m):
    """Return losses that are right for the positions with which a model is checked."""
    return np.where(distance_m > 1_000.0, np.nan, 60.0)


class InfiniteShadow:
    def gain_db(self, _from_ned_m, _to_ned_m, distance_m):
        return np.full_like(distance_m, -np.inf)


class InfiniteGain:
    def gain_db(self, direction_frd):
        return np.full(direction_frd.shape[:-1], np.inf)


class NegativeFading:
    def move(self, _at_ns, _pos_ned_m, _vel_ned_m_s):
        pass

    def gains(self, _source, _at_ns):
        return np.array([1.0, -0.5])


class NoFunction:
    def hazard(self, _mode):
        return 1e-3


class NegativeHazard:
    def hazard(self, _mode):
        return lambda snr_db: 1e-3 - 1e-4 * snr_db
