"""A user's sensors and faults, named by tests as ``user_world_models:Class``."""

# ruff: noqa: ARG002 - methods have the signatures of the protocols

import math

from msgspec import Struct
from pymavlink.dialects.v20 import common

from coflight import Effects


class Counter:
    """A sensor that counts its samples, and has settings for its times."""

    class Settings(Struct, frozen=True, forbid_unknown_fields=True):
        period_us: int = 20_000
        delay_us: int = 0

    columns = ("samples", "height_m")

    def __init__(self, context, settings):
        self.period_us, self.delay_us, self.count = settings.period_us, settings.delay_us, 0

    def sample(self, inputs):
        self.count += 1
        return self.count, -inputs.pos_ned_m[2]


class Draws(Counter):
    """Returns draws of its generator."""

    def __init__(self, context, settings):
        super().__init__(context, settings)
        self.rng = context.rng

    def sample(self, inputs):
        return list(self.rng.standard_normal(2))


class Returning:
    """Returns, or raises, what its settings name."""

    class Settings(Struct, frozen=True):
        what: str

    columns = ("a_m", "b_m")
    period_us, delay_us = 20_000, 0

    def __init__(self, context, settings):
        self.what, self.truth = settings.what, None

    def sample(self, inputs):
        match self.what:
            case "raise":
                raise RuntimeError("no\nreading")
            case "write":
                inputs.pos_ned_m[0] = 1.0
        return {
            "nan": (1.0, math.nan), "infinity": (math.inf, 1.0), "short": (1.0,), "text": ("1", 2.0),
            "number": 3.0, "nothing": None, "gap": (None, 2.0),
        }[self.what]  # fmt: skip


class Messages(Returning):
    """Returns the message that its settings name."""

    def sample(self, inputs):
        return 1.0, 2.0

    def message(self, reading):
        if self.what == "raise":
            raise RuntimeError("no message")
        return {
            "text": "DISTANCE_SENSOR",
            "clock": common.MAVLink_hil_sensor_message(*([0] * 15)),
            "range": common.MAVLink_distance_sensor_message(0, 0, 70_000, 0, 0, 0, 0, 0),
        }[self.what]


class WithoutColumns:
    period_us, delay_us = 20_000, 0

    def __init__(self, context):
        pass

    def sample(self, inputs):
        return (1.0,)


class Fast(WithoutColumns):
    columns = ("a_m",)
    period_us = 1_000


class Offsets:
    """A fault with constant effects, given by its settings."""

    class Settings(Struct, frozen=True):
        effects: dict

    def __init__(self, context, settings):
        fields = {name: tuple(v) if isinstance(v, list) else v for name, v in settings.effects.items()}
        if "rotor_effectiveness" in fields:
            fields["rotor_effectiveness"] = {int(k): v for k, v in fields["rotor_effectiveness"].items()}
        self.effects = Effects(**fields)

    def update(self, inputs, since_s):
        return self.effects


class Ramp:
    """A fault whose force grows with time and with the height of its vehicle."""

    def __init__(self, context):
        self.uav = context.uav

    def update(self, inputs, since_s):
        return Effects(force_ned_n=(since_s, float(self.uav), inputs.pos_ned_m[2]))


class Failing:
    class Settings(Struct, frozen=True):
        what: str

    def __init__(self, context, settings):
        self.what = settings.what

    def update(self, inputs, since_s):
        if self.what == "late" and since_s < 1.0:
            return Effects()
        if self.what in ("raise", "late"):
            raise RuntimeError("broken")
        return {
            "none": None, "nan": Effects(force_ned_n=(math.nan, 0.0, 0.0)),
            "large": Effects(gyro_offset_frd_rad_s=(0.0, 36.0, 0.0)),
            "short": Effects(force_ned_n=(1.0, 2.0)),
            "motor": Effects(rotors_stopped=(4,)), "object": Effects(baro_offset_m=self),
        }[self.what]  # fmt: skip


class Jamming:
    """A fault that drops or changes readings of the sensor of a name."""

    class Settings(Struct, frozen=True):
        sensor: str
        added: float | None = None

    def __init__(self, context, settings):
        self.settings = settings

    def update(self, inputs, since_s):
        return Effects()

    def reading(self, sensor, values):
        if sensor != self.settings.sensor:
            return values
        added = self.settings.added
        return None if added is None else [value + added for value in values]
