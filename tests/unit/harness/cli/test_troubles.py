"""Vehicles in trouble, and a machine that is too slow, are found in the messages of a run."""

from collections.abc import Iterable

from application_phases import standing

from harness.cli.troubles import FAR_M, STUCK_S, Lag, Troubles
from harness.simulator.messages import Progress, VehicleLost, VehicleSilent, VehicleTruth


def vehicle(
    *,
    alive: bool = True,
    armed: bool = True,
    mode: str = "Offboard",
    phase: str = "on station",
    height_m: float = 10.0,
    error_m: float = 0.3,
) -> VehicleTruth:
    return VehicleTruth(
        alive=alive, armed=armed, mode=mode, **standing(phase), pos_ned_m=(0.0, 0.0, -height_m),
        vel_ned_m_s=(0.0, 0.0, 0.0), q_ned_frd=(1.0, 0.0, 0.0, 0.0), error_m=error_m,
    )  # fmt: skip


def progress(time_s: float, *vehicles: VehicleTruth, lag_s: float = 0.0, paused: bool = False) -> Progress:
    return Progress(
        time_us=round(time_s * 1e6), wall_s=time_s, channel_busy_fraction=0.0, vehicles=vehicles, lag_s=lag_s,
        paused=paused,
    )  # fmt: skip


def texts(newest: Progress, *before: Progress | VehicleLost | VehicleSilent, forms: bool = True) -> list[str]:
    """Return the troubles after the messages, as ``INSTANCE TEXT``."""
    troubles = Troubles(forms=forms)
    for message in (*before, newest):
        troubles.update(message)
    return [f"{each.instance} {each.text}" for each in troubles.found(newest)]


def test_a_healthy_fleet_has_no_troubles() -> None:
    on_the_ground = vehicle(phase="localising", armed=False, height_m=0.05)
    climbing = vehicle(phase="take off", height_m=4.0, error_m=FAR_M + 1.0)
    assert texts(progress(12.0, vehicle(), on_the_ground, climbing)) == []


def test_troubles_are_sorted_by_urgency_and_each_vehicle_has_its_worst() -> None:
    vehicles = (
        vehicle(error_m=FAR_M + 2.31),
        vehicle(phase="yielded", mode="Return"),
        vehicle(armed=False),
        vehicle(error_m=FAR_M + 1.0),
        vehicle(alive=False, armed=False, error_m=99.0),
        vehicle(phase="landed", mode="Land", armed=False, height_m=0.05),
    )
    silent = VehicleSilent(time_us=12_000_000, instance=3, wall_silence_s=2.04)
    lost = VehicleLost(time_us=11_000_000, instance=4, reason="its connection broke")
    assert texts(progress(12.0, *vehicles), lost, silent) == [
        "4 lost: its connection broke",
        "3 silent for 2.0 s of wall time",
        "2 disarmed at a height of 10.0 m",
        "1 has left the formation: mode Return, 10.0 m high",
        "5 has left the formation: mode Land, 0.1 m high",
        "0 7.3 m from its place",
    ]


def test_a_silent_vehicle_that_answers_is_fine_again() -> None:
    silent = VehicleSilent(time_us=12_000_000, instance=0, wall_silence_s=2.0)
    assert texts(progress(12.0, vehicle()), silent) != []
    assert texts(progress(12.2, vehicle()), silent) == []


def test_a_vehicle_that_a_ground_station_flies_is_not_in_trouble() -> None:
    flown = (
        vehicle(phase="held", mode="Mission", error_m=500.0),
        vehicle(phase="yielded", mode="Return", error_m=500.0),
        vehicle(phase="", mode="Land", error_m=500.0),
        vehicle(phase="held", armed=False, height_m=0.05),
    )
    assert texts(progress(500.0, *flown), progress(0.0, *flown), forms=False) == []


def test_no_progress_is_neither_another_phase_nor_another_place() -> None:
    def at(height_m: float, phase: str = "take off") -> VehicleTruth:
        return vehicle(phase=phase, height_m=height_m)

    begin, end = 10.0, 11.0 + STUCK_S
    assert texts(progress(end, at(2.0)), progress(begin, at(2.0))) == [
        f"0 no progress for {end - begin:.0f} s: take off"
    ]
    assert texts(progress(end, at(2.0)), progress(begin, at(2.0)), progress(20.0, at(6.0))) == []
    assert texts(progress(end, at(2.0, "joining")), progress(begin, at(2.0))) == []
    assert texts(progress(end, at(2.0, "on station")), progress(begin, at(2.0, "on station"))) == []


def advice(lags: Iterable[tuple[float, float]], *, paused: bool = False) -> list[str]:
    lag = Lag()
    lines = (lag.update(progress(wall_s, lag_s=lag_s, paused=paused), 0.62) for wall_s, lag_s in lags)
    return [line for line in lines if line is not None]


def test_a_machine_that_is_steadily_too_slow_is_reported_once_with_what_to_do() -> None:
    (line,) = advice((0.2 * i, 0.2 * i * 0.38) for i in range(500))
    assert "0.62 x real time" in line
    for remedy in ("--agents", "--speed", "other programs"):
        assert remedy in line


def test_no_advice_for_a_single_stop_a_small_lag_or_a_past_one() -> None:
    walls_s = [0.2 * i for i in range(500)]
    assert advice((wall_s, 4.0 if wall_s > 1.0 else 0.0) for wall_s in walls_s) == []
    assert advice((wall_s, 0.09 * wall_s) for wall_s in walls_s) == []
    # 9 s, then the speed is reduced
    assert advice((wall_s, 0.5 * min(wall_s, 9.0)) for wall_s in walls_s) != []
    assert advice((wall_s, 0.5 * min(wall_s, 4.5)) for wall_s in walls_s) == []
    assert advice(((wall_s, 0.5 * wall_s) for wall_s in walls_s), paused=True) == []
