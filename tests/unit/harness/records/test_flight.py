import numpy as np
import pytest

from harness.records.flight import Flight


def _arrays(instants=10, vehicles=3):
    return {
        "time_us": np.arange(instants, dtype=np.int64) * 20_000,
        "pos_ned_m": np.zeros((instants, vehicles, 3)),
        "q_ned_frd": np.tile([1.0, 0.0, 0.0, 0.0], (instants, vehicles, 1)),
        "desired_pos_ned_m": np.broadcast_to(np.zeros((vehicles, 3)), (instants, vehicles, 3)),
        "heading_rad": np.zeros(instants),
        "alive": np.ones((instants, vehicles), bool),
    }


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("time_us", np.arange(9)),
        ("time_us", np.zeros(10, np.int64)),
        ("pos_ned_m", np.zeros((10, 2, 3))),
        ("q_ned_frd", np.zeros((10, 3, 3))),
        ("desired_pos_ned_m", np.zeros((3, 3))),
        ("heading_rad", np.zeros((10, 3))),
        ("alive", np.ones((10, 3))),
    ],
)
def test_inconsistent_arrays_are_refused(name, value):
    Flight(**_arrays())
    with pytest.raises(ValueError):
        Flight(**(_arrays() | {name: value}))


@pytest.mark.parametrize(
    ("instants", "rate_hz", "expected_us"),
    [
        (51, 2.0, [0, 500_000, 1_000_000]),
        (50, 2.0, [0, 500_000]),  # the last record is at 0.98 s
        (6, 30.0, [0, 40_000, 80_000, 100_000]),  # 33, 67 and 100 ms, each at its next record
        (4, 1000.0, [0, 20_000, 40_000, 60_000]),  # never a record twice
        (0, 2.0, []),
    ],
)
def test_sampling_takes_the_records_at_or_after_whole_periods(instants, rate_hz, expected_us):
    np.testing.assert_array_equal(Flight(**_arrays(instants)).sampled(rate_hz).time_us, expected_us)


def test_sampling_counts_from_the_first_record():
    arrays = _arrays(101)
    arrays["time_us"] = arrays["time_us"] + 12_340_000
    sampled = Flight(**arrays).sampled(1.0)
    np.testing.assert_array_equal(sampled.time_us, [12_340_000, 13_340_000, 14_340_000])
    assert sampled.pos_ned_m.shape == (3, 3, 3)


def test_memory_is_released_after_each_copied_field_and_not_by_copies():
    released = []
    flight = Flight(**_arrays(), release=lambda: released.append(1))
    assert flight.at(slice(2, 5)).release is flight.release
    assert released == []
    copied = flight.at(np.arange(3))
    assert len(released) == len(_arrays())
    copied.sampled(10.0)
    assert len(released) == len(_arrays())
