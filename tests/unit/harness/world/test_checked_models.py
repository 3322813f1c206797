"""Each wrong result of a user's sensor or fault is one line that names the culprit and what is expected."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import common
from world_models import models, sensor_of, state_of

from foundation.extension_failure import ExtensionFailure
from foundation.extensions import ExtensionError
from harness.records.versions import origin_of
from harness.world import user_models
from harness.world.faults import GpsLoss, UserFault
from harness.world.interfaces import Effects, Reading
from harness.world.sensors.config import ExtraSensor

PLACES = [(0.0, 0.0, -5.0)] * 3
RETURNING, MESSAGES = "user_world_models:Returning", "user_world_models:Messages"


def fault_of(model, settings=None, vehicle=1):
    fault = UserFault(uav=vehicle, model=f"user_world_models:{model}", settings=settings or {})
    return models().fault(fault, 2, vehicle)


@pytest.mark.parametrize(
    ("what", "line"),
    [
        ("raise", r"\.sample: RuntimeError: no reading \(.*user_world_models\.py:\d+\)$"),
        ("write", r"\.sample: ValueError: assignment destination is read-only"),
        ("nan", r"\.sample returned nan for b_m; expected a finite number, or None \(UAV 1\)$"),
        ("infinity", r"\.sample returned inf for a_m; expected a finite number, or None \(UAV 1\)$"),
        ("short", r"\.sample returned 1 values; expected 2 \(UAV 1\)$"),
        ("text", r"\.sample returned str for a_m; expected a number \(UAV 1\)$"),
        ("number", r"\.sample returned float; expected 2 numbers, or None \(UAV 1\)$"),
    ],
)
def test_a_wrong_sample_is_one_line(what, line):
    sensor = sensor_of(RETURNING, {"what": what}, number=3, vehicle=1)
    with pytest.raises(ExtensionFailure, match=rf"^sensors\.extra\[3\]\.model {RETURNING}{line}") as caught:
        sensor.sample(state_of(PLACES, vehicle=1))
    assert "\n" not in str(caught.value)


def test_no_reading_and_no_value_are_allowed():
    assert sensor_of(RETURNING, {"what": "nothing"}).sample(state_of(PLACES)) is None
    values = sensor_of(RETURNING, {"what": "gap"}).sample(state_of(PLACES))
    assert np.isnan(values[0])
    assert values[1] == 2.0


@pytest.mark.parametrize(
    ("what", "line"),
    [
        ("raise", r"\.message: RuntimeError: no message \("),
        ("text", r"\.message returned str; expected a message of pymavlink's common set \(UAV 0\)$"),
        ("clock", r"\.message returned HIL_SENSOR, the vehicle's clock; expected another one"),
        ("range", r"\.message returned a DISTANCE_SENSOR that cannot be packed: .*65535.*\(UAV 0\)$"),
    ],
)
def test_a_wrong_message_is_one_line(what, line):
    sensor = sensor_of(MESSAGES, {"what": what})
    assert sensor.is_for_autopilot
    with pytest.raises(ExtensionFailure, match=rf"^sensors\.extra\[0\]\.model {MESSAGES}{line}"):
        sensor.frame(Reading(0, (1.0, 2.0)), common.MAVLink(None))


@pytest.mark.parametrize(
    ("model", "settings", "line"),
    [
        (
            "range_findr",
            {},
            r"\.model: 'range_findr' is not installed; did you mean range_finder\? expected ",
        ),
        ("user_world_models:Nothing", {}, r"\.model: user_world_models \(.*\) has no Nothing"),
        ("user_world_models:Ramp", {}, r"\.model: .* lacks sample; expected a coflight\.Sensor$"),
        ("range_finder", {"max_m": -1.0}, r"\.settings\.max_m: expected `float` > 0\.0$"),
        ("uwb_tag", {"anchors": []}, r"\.settings: unknown key `anchors`; did you mean `anchors_ned_m`\?$"),
        ("user_world_models:Fast", {"a": 1}, r"\.settings: .* has no settings"),
        ("user_world_models:Fast", {}, r"\.model .*\.period_us: 1000; expected a whole number, 4000 to "),
        (
            "user_world_models:WithoutColumns",
            {},
            r"\.model .*\.columns: None; expected 1 to 58 different names",
        ),
    ],
)
def test_a_sensor_that_cannot_be_created_is_one_line(model, settings, line):
    with pytest.raises(ExtensionError, match=rf"^sensors\.extra\[0\]{line}"):
        sensor_of(model, settings)


@pytest.mark.parametrize(
    ("what", "line"),
    [
        ("raise", r"\.update: RuntimeError: broken \("),
        ("none", r"\.update returned NoneType; expected coflight\.Effects \(UAV 1\)$"),
        ("nan", r"\.update returned Effects with force_ned_n\[0\]: .*float.* \(UAV 1\)$"),
        ("large", r"\.update returned Effects with gyro_offset_frd_rad_s\[1\]: .*<= 35\.0.* \(UAV 1\)$"),
        ("short", r"\.update returned Effects with force_ned_n: .*length 3.* \(UAV 1\)$"),
        ("motor", r"\.update returned rotor 4; expected 0 to 3 \(UAV 1\)$"),
        ("object", r"\.update returned Effects with .*Failing.*\(UAV 1\)$"),
    ],
)
def test_a_wrong_effect_is_one_line(what, line):
    fault = fault_of("Failing", {"what": what})
    with pytest.raises(ExtensionFailure, match=rf"^faults\[2\]\.model user_world_models:Failing{line}"):
        fault.update(state_of(PLACES, vehicle=1), 0.0)


def test_effects_may_have_arrays():
    class Gust:
        def update(self, inputs, since_s):  # noqa: ARG002
            return Effects(force_ned_n=np.array((1.0, 2.0, 3.0)), baro_offset_m=np.float64(2.0))

    fault = fault_of("Ramp")
    fault._model = Gust()
    effects = fault.update(state_of(PLACES, vehicle=1), 0.0)
    assert (effects.force_ned_n, effects.baro_offset_m) == ((1.0, 2.0, 3.0), 2.0)


def test_a_generator_depends_on_seed_vehicle_and_name_only():
    def draws(number=0, vehicle=0, name="", seed=1):
        sensor = sensor_of("user_world_models:Draws", number=number, vehicle=vehicle, name=name, seed=seed)
        return sensor.sample(state_of(PLACES))

    assert draws() == draws(number=5)  # other sensors before it
    others = [draws(vehicle=1), draws(name="other"), draws(seed=2)]
    assert len({draws(), *others}) == 4


def test_entry_points_are_looked_up_in_their_group(monkeypatch):
    points = {"coflight.sensors": {"count": "user_world_models:Counter"}}
    monkeypatch.setattr("foundation.extension_class.registered", points.__getitem__)
    assert sensor_of("count").columns == ("samples", "height_m")


def test_the_manifest_lists_code_of_users_and_not_that_of_coflight():
    sensors = [ExtraSensor(model="range_finder"), ExtraSensor(model="user_world_models:Counter")]
    faults = [GpsLoss(uav=0), UserFault(uav=0, model="user_world_models:Ramp")]
    named = user_models.named(sensors, faults)
    assert named == {
        "sensors.extra[1]": ("user_world_models:Counter", "coflight.sensors"),
        "faults[1]": ("user_world_models:Ramp", "coflight.faults"),
    }
    assert origin_of(*named["faults[1]"])["path"] == "user_world_models:Ramp"
