"""Reading an element from a deck, and writing an array as a deck."""

import numpy as np
import pytest
from antenna_arrays import vertical_snapshot

from antenna.analysis.patterns import directions_deg
from antenna.model.array_deck import write_deck
from antenna.model.config import AntennaConfig
from antenna.model.deck import DeckError, read_element
from antenna.model.elements import Wire

ONE = "GW 1 9 0 0 -0.5 0 0 0.5 0.001"
REST = "GE 0\nEX 0 1 5 0 1 0\nEN\n"


def _read(*cards):
    return read_element("\n".join(cards) + "\n" + REST)


@pytest.mark.parametrize("ground", ["none", "perfect"])
@pytest.mark.parametrize("step_deg", [0.1, 0.8, 1.0, 2.0, 4.0, 5.0, 7.0, 7.2, 10.0, 12.0, 15.0, 20.0, 30.0])
def test_deck_requests_the_directions_of_a_pattern(ground, step_deg):
    """From the pole on, over ground to the horizon alone; 4, 7.2, 12 and 20 have an odd ceil(180 / step)."""
    snapshot = vertical_snapshot(np.array([[0.0, 0.0, 5.0]]), 10.0)
    text = write_deck(snapshot, AntennaConfig(ground=ground), step_deg=step_deg)
    (card,) = [line.split() for line in text.splitlines() if line.startswith("RP")]
    theta_deg, phi_deg = directions_deg(step_deg)
    seen_deg = theta_deg if ground == "none" else theta_deg[theta_deg < 90.0 + 1e-6]
    assert card[1:4] == ["0", str(len(seen_deg)), str(len(phi_deg))]
    assert card[5:7] == card[9:] == ["0", "0"]
    assert float(card[7]) * np.arange(len(seen_deg)) == pytest.approx(seen_deg, abs=1e-5)
    assert float(card[8]) * np.arange(len(phi_deg)) == pytest.approx(phi_deg, abs=1e-5)


@pytest.mark.parametrize(("kind", "length_m", "segments"), [("dipole", 5.0, 11), ("loop", 1.9, 12)])
def test_element_round_trips_through_a_deck(kind, length_m, segments):
    config = AntennaConfig(
        element_kind=kind, element_length_m=length_m, element_radius_m=0.001, segments=segments
    )
    element = config.element()
    found = read_element(write_deck(vertical_snapshot(np.zeros((1, 3)), 10.0), config))
    assert found.feed_segment == element.feed_segment
    for mine, its in zip(found.wires, element.wires, strict=True):
        assert (mine.segments, mine.radius_m) == (its.segments, its.radius_m)
        assert mine.start_m + mine.end_m == pytest.approx(its.start_m + its.end_m, abs=1e-8)


def test_lines_after_the_end_card_are_ignored():
    followed = f"{ONE}\n{REST}GW 2 3 0 1 0 0 2 0 0.001\nEX 0 2 2 0 1 0\nLD 4 0 0 0 50 0 0\nthe end\n"
    assert read_element(followed) == _read(ONE)
    with pytest.raises(DeckError, match=r"^line 2: the deck has no source"):
        read_element(f"{ONE}\nEN\nEX 0 1 5 0 1 0\n")


@pytest.mark.parametrize(
    "card",
    [
        "GW 1,9,0,0,-0.5,0,0,0.5,0.001",
        "GW,1,9,0,0,-0.5,0,0,0.5,0.001",
        "GW 1 , 9 , , , -.5 ,,, .5 , 1e-3",
        "GW 1 9 0, 0, -0.5, 0 0 0.5\t0.001",
        "gw 1,9,,,-0.5,,,0.5,0.001,",
    ],
)
def test_fields_may_be_separated_by_commas_and_empty_ones_are_zero(card):
    assert _read(card) == _read(ONE)


@pytest.mark.parametrize(
    ("cards", "said"),
    [
        (["GW 1 9 0 0 0 0 0 1e300 0.001"], "line 1: GW: expected finite numbers of at most 1e+15"),
        (["GW 1 9 0 0 0 0 0 nan 0.001"], "line 1: GW: expected finite numbers of at most 1e+15"),
        (["GW 1 1e300 0 0 0 0 0 1 0.001"], "line 1: GW: expected finite numbers of at most 1e+15"),
        (["CE", "GW 1 9 0 0 0 0 0 1001 1"], "line 2: GW: length of 1001 m; expected 1e-06 to 1000"),
        (["GW 1 9 0 0 0 0 0 1e-320 1e-9"], "line 1: GW: length of 9.99989e-321 m; expected 1e-06 to 1000"),
        (["GW 1 9 0 0 0 0 0 1 1e-320"], "line 1: GW: radius of 9.99989e-321 m; expected 1e-09 to 10"),
        (["GW 1 9 0 0 0 0 0 900 11"], "line 1: GW: radius of 11 m; expected 1e-09 to 10"),
        ([ONE, "GM 0 0 0 0 0 0 0 2e3"],
         "line 1: GW: end 2000.5 m from the vehicle; expected at most 1000"),
        ([ONE, "GS 0 0 5000"], "line 1: GW: length of 5000 m; expected 1e-06 to 1000"),
        ([ONE, "GS 0 0 1e10", "GS 0 0 1e10"], "line 3: GS: expected lengths of at most 1e+15 m"),
        ([ONE, *["GS 0 0 1e-15"] * 30], "line 1: GW: length of 0 m; expected 1e-06 to 1000"),
    ],
)  # fmt: skip
def test_sizes_out_of_range_are_rejected_with_the_line(cards, said):
    with pytest.raises(DeckError) as caught:
        _read(*cards)
    assert str(caught.value) == said


def test_lengths_are_scaled_before_the_range_check():
    """In micrometres the same dipole is a million long."""
    assert _read("GW 1 9 0 0 -5e5 0 0 5e5 1e3", "GS 0 0 1e-6").wires == (
        Wire(start_m=(0.0, 0.0, -0.5), end_m=(0.0, 0.0, 0.5), radius_m=pytest.approx(0.001), segments=9),
    )


@pytest.mark.parametrize(
    ("second", "said"),
    [
        (ONE, "that of line 2"),
        ("GW 2 9 0 0 0.5 0 0 -0.5 0.001", "that of line 2"),
        ("GW 2 9 0 0 0.5 0 0 -0.2 0.001", "that of line 2"),
        ("GW 2 9 0 0 -0.1 0 0 0.1 0.0005", "that of line 2"),
        ("GW 2 9 0 0.0019 -0.5 0 0.0019 0.5 0.001", "that of line 2"),
        ("GW 2 9 -0.5 0 0.01 0.5 0 0.01 0.001", "that of line 2"),
        ("GW 2 3 0 0 0.5 0 0.1 -0.2 0.001\nGW 3 9 -0.5 0.05 0.15 0.5 0.05 0.15 0.001", None),
        ("GW 2 3 0 0 0.1 0 0.5 0.1 0.001", "that of line 2"),
        ("GW 2 3 0 0 0.502 0 0.5 0.502 0.001", "that of line 2"),
        ("GM 1 1 0 0 0 0 0 0.9", "its own copy"),
        ("GM 1 1 0 0 0 0 0.001 0", "its own copy"),
    ],
    ids=["identical", "reversed", "folded back", "within", "beside", "crossing", "joined, and crossing",
         "T", "nearly joined", "copy", "copy beside"],
)  # fmt: skip
def test_crossing_wires_are_rejected_with_both_lines(second, said):
    with pytest.raises(DeckError) as caught:
        _read("CE", ONE, second)
    line = 2 if said == "its own copy" else 3
    if said is None:
        line, said = 4, "that of line 3"
    expected = f"line {line}: GW: the wire touches or crosses {said}; wires may meet only at ends of both"
    assert str(caught.value) == expected


@pytest.mark.parametrize(
    "others",
    [
        ["GW 2 3 0 0 0.5 0.3 0 0.6 0.001", "GW 3 3 0 0 0.5 -0.3 0 0.6 0.001"],
        ["GW 2 9 0 0 0.5 0 0 1.5 0.001"],
        ["GW 2 9 0 0.0031 -0.5 0 0.0031 0.5 0.001"],
        ["GW 2 5 0 0 0.5 0 0.4 0 0.001", "GW 3 5 0 0.4 0 0 0 -0.5 0.001"],
        ["GW 2 9 0 0 0.50001 0 0.5 0.50001 0.001"],
        ["GM 1 1 0 0 0 0 0 1"],
        ["GM 1 3 0 0 0 0 0.01 0"],
    ],
    ids=[
        "branches",
        "end to end",
        "beside",
        "ring",
        "joined within NEC's tolerance",
        "copy on top",
        "copies",
    ],
)
def test_wires_joined_at_their_ends_are_accepted(others):
    assert len(_read("CE", ONE, *others).wires) > 1


def test_a_thousand_wires_are_checked_against_each_other():
    """A row 10 mm apart, of 2 mm wires; the last one across it touches the first of all that it crosses."""
    row = [ONE, "GM 0 998 0 0 0 0 0.01 0"]
    assert len(_read(*row).wires) == 999
    with pytest.raises(DeckError, match=r"^line 3: GW: the wire touches or crosses that of line 1;"):
        _read(*row, "GW 2 9 0 0.001 0 0 9.981 0 0.0005")
