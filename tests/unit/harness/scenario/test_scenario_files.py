"""Files of a scenario: places of a formation, and the deck of an element."""

import msgspec
import numpy as np
import pytest
from paths import ROOT

from harness.scenario.scenario import Scenario, ScenarioError
from harness.scenario.scenario_file import load

ARTICLE = ROOT / "scenarios" / "article.toml"


def _with_file(folder, text, *settings):
    (folder / "v.csv").write_text(text)
    lines = ["agents = 3", "[formation]", 'shape = "file"', 'file = "v.csv"', *settings]
    (folder / "v.toml").write_text("\n".join(lines))
    return load(folder / "v.toml")


@pytest.mark.parametrize(
    "text",
    [
        "x_m,y_m,z_m\n-4,-3,0\n0,0.5,1.5\n4,-3.0,0\n",
        "\ufeffz_m; y_m; x_m\r\n0; -3; -4\r\n\r\n1.5; 5e-1; 0\r\n0; -3; 4\r\n100; 0; 0".replace(";", ","),
    ],
)
def test_places_of_a_file_are_stored_in_the_scenario(tmp_path, text):
    """The processes read the scenario without the file; surplus rows are ignored."""
    scenario = _with_file(tmp_path, text, "heading_deg = 90.0", "height_m = 20.0")
    # heading east: the file's x, to the right, is south, and its y, ahead, is east
    expected_m = [[4.0, -3.0, -20.0], [0.0, 0.5, -21.5], [-4.0, -3.0, -20.0]]
    np.testing.assert_allclose(scenario.places_ned_m(), expected_m, atol=1e-12)
    (tmp_path / "v.csv").unlink()
    again = msgspec.json.decode(msgspec.json.encode(scenario), type=Scenario)
    np.testing.assert_array_equal(again.places_ned_m(), scenario.places_ned_m())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x_m,y_m\n0,0\n1,b\n", "v.csv:3: y_m: expected a number, not 'b'"),
        ("x_m,y_m\n0,0\n\n1,\n", "v.csv:4: y_m: expected a number, not ''"),
        ("x_m,y_m\n0,nan\n", "v.csv:2: y_m: nan is not within 10000 m"),
        ("x_m,y_m\n0,-1e9\n", "v.csv:2: y_m: -1e9 is not within 10000 m"),
        ("x_m,y_m\n0,0,0\n", "v.csv:2: expected 2 columns, not 3"),
        ("x_m,height_m\n0,0\n", "v.csv:1: expected the columns x_m,y_m or x_m,y_m,z_m, not x_m,height_m"),
        ("x_m,y_m,y_m\n0,0,0\n", "v.csv:1: expected the columns"),
        ('x_m,y_m\n"0,0\n', "v.csv:2: unexpected end of data"),
        ("x_m,y_m\n0,0\n0,5\n", "v.toml: formation.file: 2 places for 3 vehicles"),
        ("", "v.toml: formation.file: 0 places for 3 vehicles"),
        ("x_m,y_m\n0,0\n0,5\n0,5.7\n", "v.toml: formation: places 0.70 m apart"),
        (
            "x_m,y_m,z_m\n0,0,0\n0,5,-8.5\n5,0,0\n",
            "v.toml: formation.points_m[1]: 1.50 m over the site, where 2 m is the least",
        ),
    ],
)
def test_errors_in_a_file_of_places_are_named(tmp_path, text, message):
    with pytest.raises(ScenarioError) as caught:
        _with_file(tmp_path, text)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


MONOPOLE = """CE an arm at the top
GW 1 9 0 0 -0.5 0 0 0.5 0.001
GW 2 3 0 0 0.5 0.3 0 0.6 0.001
EX 0 1 5 0 1 0
"""


def _with_deck(folder, text, *settings, overrides=()):
    (folder / "a.nec").write_bytes(text if isinstance(text, bytes) else text.encode())
    lines = ["[antenna]", 'element_file = "a.nec"', *(settings or ('element_kind = "deck"',))]
    (folder / "v.toml").write_text("\n".join(lines))
    return load(folder / "v.toml", overrides)


@pytest.mark.parametrize("text", [MONOPOLE, "\ufeff" + MONOPOLE.replace("\n", "\r\n")])
def test_an_elements_deck_is_stored_in_the_scenario(tmp_path, text):
    """The processes read the scenario without the deck."""
    scenario = _with_deck(tmp_path, text)
    (tmp_path / "a.nec").unlink()
    again = msgspec.json.decode(msgspec.json.encode(scenario), type=Scenario)
    element = again.antenna.element()
    assert [wire.segments for wire in element.wires] == [9, 3]
    assert element.feed_segment == 4  # the fifth


def test_a_deck_is_named_by_an_override_as_well(tmp_path):
    _with_deck(tmp_path, MONOPOLE)
    (tmp_path / "b.nec").write_text(MONOPOLE.replace("EX 0 1 5", "EX 0 2 3"))
    assert load(tmp_path / "v.toml", ["antenna.element_file=b.nec"]).antenna.element().feed_segment == 11
    settings = [f"antenna.element_file={tmp_path / 'b.nec'}", "antenna.element_kind=deck"]
    assert load(ARTICLE, settings).antenna.element().feed_segment == 11


@pytest.mark.parametrize(
    ("text", "settings", "message"),
    [
        (MONOPOLE + "LD 5 0 0 0 1e6\n", (), "a.nec: line 5: card 'LD' is not supported"),
        (MONOPOLE.replace("0.3", "x"), (), "a.nec: line 3: GW: expected numbers"),
        ("CE nothing\n", (), "a.nec: line 1: the deck has no wires"),
        (MONOPOLE[:-15], (), "a.nec: line 3: the deck has no source"),
        ("", (), "a.nec: line 0: the deck has no wires"),
        (b"\xff\xfe\x00", (), "a.nec: it is not text"),
        (MONOPOLE, ("segments = 9",), "element_file: only for element_kind deck, not dipole"),
        (MONOPOLE, ('element_kind = "helix"',), "antenna.element_kind: invalid enum value 'helix'"),
    ],
)
def test_errors_in_an_elements_deck_are_named(tmp_path, text, settings, message):
    with pytest.raises(ScenarioError) as caught:
        _with_deck(tmp_path, text, *settings)
    assert message in str(caught.value)
    assert "v.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_deck_is_named(tmp_path):
    with pytest.raises(
        ScenarioError, match=r"v\.toml: antenna\.element_file: .*b\.nec: there is no such file"
    ):
        _with_deck(tmp_path, MONOPOLE, overrides=["antenna.element_file=b.nec"])
    with pytest.raises(ScenarioError, match="element_file: element_kind deck requires"):
        load(ARTICLE, ["antenna.element_kind=deck"])
    with pytest.raises(ScenarioError, match=r"antenna\.element_file: expected `str`"):
        load(ARTICLE, ["antenna.element_file=1", "antenna.element_kind=deck"])


def test_a_missing_and_a_binary_file_of_places_are_named(tmp_path):
    _with_file(tmp_path, "x_m,y_m\n0,0\n0,5\n5,0\n")
    with pytest.raises(ScenarioError, match=r"formation\.file: .*w\.csv: there is no such file"):
        load(tmp_path / "v.toml", ["formation.file=w.csv"])
    (tmp_path / "w.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match=r"w\.csv: it is not text"):
        load(tmp_path / "v.toml", ["formation.file=w.csv"])
    with pytest.raises(ScenarioError, match=r"formation\.file: no file for 8 vehicles"):
        load(ARTICLE, ["formation.shape=file"])
    # other shapes ignore it
    assert (
        len(load(tmp_path / "v.toml", ["formation.file=x.csv", "formation.shape=ring"]).places_ned_m()) == 3
    )
