"""Airframe files: shipped ones, derived values by hand, and the line for each wrong file."""

import math

import pytest

from foundation.airframe.files import FOLDER, IRIS, AirframeError, load, names

TEXT = (FOLDER / "x500.toml").read_text()


def test_the_shipped_airframes():
    assert names() == ("crazyflie", "hexacopter", "iris", "octocopter", "x500")
    rotors = {name: len(load(name).rotors) for name in names()}
    assert rotors == {"crazyflie": 4, "hexacopter": 6, "iris": 4, "octocopter": 8, "x500": 4}


def test_hover_of_the_iris():
    """1.55 kg on four rotors of 5.84e-6 N s^2: 3.80 N, 806.7 rad/s; 0.494 m between hubs, 0.256 m discs."""
    assert IRIS.hover_thrust_n == pytest.approx(3.800, abs=1e-3)
    assert IRIS.hover_rad_s == pytest.approx(806.66, abs=0.01)
    assert IRIS.hover_share == pytest.approx((806.66**2 - 100.0**2) / (1100.0**2 - 100.0**2), abs=1e-5)
    assert IRIS.propulsion.thrust_model_factor == 5.0 / 6.0
    assert IRIS.span_m == pytest.approx(math.hypot(0.26, 0.42) + 0.256)
    assert IRIS.spacing_m == 0.8
    assert (IRIS.motor_current_a, IRIS.current_speed_rad_s, IRIS.average_current_a) == (4.0, 806.7, 15.0)


@pytest.mark.parametrize("name", names())
def test_derived_current_is_that_of_the_momentum_theory(name):
    """A rotor of twice the radius induces half the speed, and takes half of the current."""
    airframe = load(name)
    unit = airframe.propulsion
    power_w = airframe.hover_thrust_n * math.sqrt(
        airframe.hover_thrust_n / (2.0 * 1.225 * math.pi * unit.radius_m**2)
    )
    expected_a = power_w / (0.5 * 3.7 * airframe.battery.cells)
    assert airframe.motor_current_a == pytest.approx(expected_a, rel=1e-9 if name != "iris" else 0.1)


def test_tilted_rotors_lift_by_their_upward_component(tmp_path):
    """All axes 30 degrees from upright, in pairs: the vehicle needs 1 / cos(30 deg) of the thrust."""
    text = TEXT
    for turns, side in (('"ccw"', 1.0), ('"cw"', -1.0)):
        text = text.replace(
            f"turns = {turns}", f"turns = {turns}\naxis_frd = [0.0, {side * 0.5}, -0.8660254]"
        )
    path = tmp_path / "tilted.toml"
    path.write_text(text)
    tilted = load("tilted.toml", tmp_path)
    assert tilted.hover_thrust_n == pytest.approx(load("x500").hover_thrust_n / math.cos(math.radians(30.0)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mass_kg = 2.064", "", "missing key `mass_kg`"),
        ("mass_kg = 2.064", "mass_kg = -1.0", "mass_kg: expected `float` >= 0.0001"),
        ("mass_kg = 2.064", "mass = 2.064", "unknown key `mass`; did you mean `mass_kg`?"),
        ("moment_m = 0.016", 'moment_m = "big"', "propulsion.moment_m: expected `float`, got `str`"),
        ("moment_m = 0.016", "moment = 0.016", "propulsion: unknown key `moment`; did you mean `moment_m`?"),
        ('turns = "ccw"', 'turns = "left"', "rotors[0].turns: invalid enum value 'left'"),
        ("[0.174, 0.174, -0.06]", "[0.174, 0.174]", "rotors[0].position_frd_m: expected `array` of length 3"),
        (
            "[0.174, 0.174, -0.06]", "[17.4, 0.174, 0.0]",
            "rotors[0].position_frd_m[0]: expected `float` <= 10.0",
        ),
        (
            "[-0.174, -0.174, -0.06]", "[0.174, 0.174, -0.06]",
            "rotors[1].position_frd_m: that of rotors[0], too",
        ),
        (
            'turns = "ccw"', 'turns = "ccw"\naxis_frd = [0.0, 0.0, 1.0]',
            "axis_frd: expected a direction at most 60 degrees from (0, 0, -1)",
        ),
        (
            "[0.02166667, 0.02166667, 0.04]", "[0.02166667, 0.02166667, 0.05]",
            "inertia_kg_m2: no rigid body has a moment of inertia above the sum of the two others",
        ),
        ("mass_kg = 2.064", "mass_kg = 20.0", "propulsion.thrust_n_s2: hover takes 5.84 of the thrust range"),
        ("idle_rad_s = 150.0", "idle_rad_s = 800.0", "propulsion.idle_rad_s: the idle rotors lift more than"),
        ("[battery]", "[battery", "not TOML"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_one_line_with_file_and_field(tmp_path, old, new, message):
    assert old in TEXT
    path = tmp_path / "mine.toml"
    path.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(AirframeError) as caught:
        load("mine.toml", tmp_path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_three_rotors_are_refused(tmp_path):
    """They cannot produce thrust and three torques independently."""
    head, *rotors = TEXT.split("[[rotors]]")
    path = tmp_path / "tri.toml"
    path.write_text("[[rotors]]".join((head, *rotors[1:])))
    with pytest.raises(AirframeError, match="rotors: expected `array` of length >= 4"):
        load("tri.toml", tmp_path)


def test_what_does_not_exist_is_named():
    with pytest.raises(
        AirframeError, match=r"there is no airframe 'x501'; expected one of crazyflie, .*x500"
    ):
        load("x501")
    with pytest.raises(AirframeError, match=r"nowhere\.toml: there is no such file"):
        load("nowhere.toml")
