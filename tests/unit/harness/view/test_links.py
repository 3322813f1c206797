"""Links and ranges: each frame at the instant after its end, between the vehicles that it joined."""

import numpy as np
import pytest

from harness.records.tables import FLIGHT_RECORD
from harness.view import links
from netsim.emulator.log_layout import FRAME_LOG, SESSION_LOG

VEHICLES, TIMES_US = 4, np.array([40_000, 80_000, 120_000])


@pytest.fixture
def flight():
    """Return (3, 4) records of vehicles at (i, t, 0) m."""
    rows = np.zeros((len(TIMES_US), VEHICLES), FLIGHT_RECORD)
    rows["alive"] = True
    rows["pos_ned_m"][:, :, 0] = np.arange(VEHICLES)
    rows["pos_ned_m"][:, :, 1] = np.arange(len(TIMES_US))[:, None]
    return rows


def frame(end_us, source, destination, *, delivered=0, collided=0, lost=0):
    row = np.zeros(1, FRAME_LOG)
    row["end_ns"], row["source"], row["destination"] = end_us * 1_000, source, destination
    row["delivered"], row["collided"], row["lost_to_noise"] = delivered, collided, lost
    return row


def drawn(frames, flight):
    """Return the lines by entity: (instant, from, to) from the places of the vehicles."""
    frames = np.concatenate([np.empty(0, FRAME_LOG), *frames])
    found = {}
    for entry in links.link_entries(frames, flight, TIMES_US):
        at = np.repeat(np.arange(len(TIMES_US)), entry.lengths)
        if entry.kind == "LineStrips3D":
            values = [
                (int(t), *map(int, strip[:, 0])) for t, strip in zip(at, entry.fields["strips"], strict=True)
            ]
            assert all(strip[0, 1] == t for t, strip in zip(at, entry.fields["strips"], strict=True))
        else:
            values = [(int(t), int(place[0])) for t, place in zip(at, entry.fields["positions"], strict=True)]
        if values:
            found[entry.path.rpartition("/")[2]] = values
    return found


def test_a_frame_to_one_station_is_a_line_in_its_outcome_at_the_next_instant(flight):
    frames = [
        frame(40_000, 0, 1, delivered=1),
        frame(40_001, 1, 0, collided=1),
        frame(120_001, 3, 2, lost=1),  # after the last instant
    ]
    assert drawn(frames, flight) == {"delivered": [(0, 0, 1)], "collided": [(1, 1, 0)], "lost": [(2, 3, 2)]}


def test_a_broadcast_that_all_living_vehicles_received_is_a_line_to_each(flight):
    assert drawn([frame(1, 1, -1, delivered=3)], flight) == {"delivered": [(0, 1, 0), (0, 1, 2), (0, 1, 3)]}
    flight["alive"][:, 3] = False
    assert drawn([frame(1, 1, -1, delivered=2)], flight) == {"delivered": [(0, 1, 0), (0, 1, 2)]}


def test_another_broadcast_is_a_mark_of_the_worst_outcome_at_its_transmitter(flight):
    frames = [frame(1, 2, -1, delivered=2, collided=1), frame(50_000, 0, -1, delivered=1, lost=2)]
    assert drawn(frames, flight) == {"broadcast_collided": [(0, 2)], "broadcast_lost": [(1, 0)]}


def test_frames_of_guests_and_without_receivers_are_not_drawn(flight):
    assert drawn([frame(1, 4, 0, delivered=1), frame(1, 0, 4, delivered=1), frame(1, 0, 1)], flight) == {}


def test_completed_ranging_is_a_line_with_the_distance(flight):
    sessions = np.zeros(3, SESSION_LOG)
    sessions["measured_ns"] = [90_000_000, 30_000_000, 30_000_000]
    sessions["initiator"], sessions["peer"] = [0, 1, 2], [3, 2, 3]
    sessions["status"] = [b"ok", b"ok", b"timeout"]
    sessions["distance_m"], sessions["true_distance_m"] = [3.25, 0.9, 0.0], [3.0, 1.0, 1.0]
    (entry,) = links.range_entries(sessions, flight, TIMES_US)
    assert entry.lengths.tolist() == [1, 0, 1]
    assert entry.fields["labels"] == ["0.90 m (-0.10)", "3.25 m (+0.25)"]
    assert [strip.tolist() for strip in entry.fields["strips"]] == [
        [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]],
        [[0.0, 2.0, 0.0], [3.0, 2.0, 0.0]],
    ]
