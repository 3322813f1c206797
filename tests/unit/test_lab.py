"""The emulator alone against ns-3's runs and theory; docs/radio.md has the whole of it."""

import csv
import json
import math
from pathlib import Path

import pytest

from netsim.lab.broadcast import broadcast
from netsim.lab.cli import main
from netsim.lab.ranging import range_mesh, range_pair
from netsim.lab.saturation import saturate

REFERENCE = Path(__file__).parents[1] / "reference"


def rows(name, **wanted):
    """Rows of a reference table whose cells are the wanted ones."""
    with (REFERENCE / name).open() as file:
        found = [
            row for row in csv.DictReader(file) if all(row[key] == value for key, value in wanted.items())
        ]
    assert found
    return found


@pytest.mark.parametrize("rts", [False, True])
@pytest.mark.parametrize("stations", [1, 5, 20])
def test_saturated_throughput_is_ns3s(stations, rts):
    (row,) = rows("ns3_saturation.csv", n=str(stations), rts=str(int(rts)), rate="OfdmRate6Mbps")
    result = saturate(stations=stations, rts=rts, mode="ofdm6", payload_bytes=1000, seconds=4.0)
    # the collisions of 4 s alone scatter by 1 %
    assert result.throughput_mbps == pytest.approx(float(row["throughput_mbps"]), rel=0.03)


def test_collisions_are_those_of_bianchis_fixed_point():
    # tau = 2 / (1 + W + p W sum_{i<m} (2p)^i), p = 1 - (1 - tau)^(n - 1); W = 16 and six doublings
    n, w, m = 10, 16, 6
    low, high = 0.0, 1.0
    for _ in range(60):
        p = (low + high) / 2
        tau = 2 / (1 + w + p * w * sum((2 * p) ** i for i in range(m)))
        low, high = (p, high) if 1 - (1 - tau) ** (n - 1) > p else (low, p)
    result = saturate(stations=n, rts=False, mode="ofdm6", payload_bytes=1000, seconds=10.0)
    # a frozen slot that nobody may use follows every exchange, so real stations collide a little less often
    assert result.collisions_fraction == pytest.approx(p, abs=0.03)
    assert result.dropped == 0


def test_a_retry_limit_gives_frames_up_and_costs_throughput_as_the_window_falls_back():
    unlimited = saturate(stations=50, rts=False, mode="ofdm6", payload_bytes=1000, seconds=3.0)
    limited = saturate(stations=50, rts=False, mode="ofdm6", payload_bytes=1000, seconds=3.0, retry_limit=6)
    assert unlimited.dropped == 0 < limited.dropped
    assert limited.collisions_fraction > unlimited.collisions_fraction


@pytest.mark.parametrize(
    ("stations", "period_s", "jitter_s"), [(8, "0.1", "0.002"), (16, "0.1", "0.01"), (32, "0.1", "0.0005")]
)
def test_periodic_broadcasts_fare_as_in_ns3(stations, period_s, jitter_s):
    (row,) = rows("ns3_broadcast.csv", n=str(stations), period_s=period_s, jitter_s=jitter_s)
    result = broadcast(
        stations=stations,
        payload_bytes=300,
        period_s=float(period_s),
        jitter_s=float(jitter_s),
        seconds=600 * float(period_s),
    )
    assert result.delivery_ratio == pytest.approx(float(row["delivery_ratio"]), abs=0.03)
    assert result.mean_delay_ms == pytest.approx(float(row["mean_delay_ms"]), rel=0.10)


def test_stations_that_broadcast_in_the_same_instant_all_collide():
    result = broadcast(stations=8, payload_bytes=300, period_s=0.1, jitter_s=0.0, seconds=2.0)
    assert result.delivery_ratio == 0.0


@pytest.mark.parametrize(("width_mhz", "round_trip_m"), [(20, 0.384), (40, 0.161)])
def test_ranging_has_the_measured_noise_and_no_bias_of_its_own(width_mhz, round_trip_m):
    bias_m, sessions, frames = 0.7, 2000, 4
    result = range_pair(
        distance_m=30.0, width_mhz=width_mhz, sessions=sessions, ftms_per_burst=frames, bias_m=bias_m
    )
    assert result.completed == sessions
    assert result.round_trip_std_m == pytest.approx(round_trip_m, rel=0.10)
    error_of_mean_m = round_trip_m / math.sqrt((frames - 1) * sessions)
    assert abs(result.error_mean_m - bias_m) < 0.01
    assert 1.9 * error_of_mean_m < 0.01  # so many sessions are enough for the line above
    # N frames give N - 1 round trips, whose white errors average
    assert result.error_std_m == pytest.approx(round_trip_m / math.sqrt(frames - 1), rel=0.10)


@pytest.mark.parametrize(
    ("width_mhz", "mode", "airtime_ms"), [(20, "ofdm6", 1.75), (20, "ofdm24", 1.18), (80, "vht_mcs0", 1.50)]
)
def test_airtime_of_a_session(width_mhz, mode, airtime_ms):
    result = range_pair(distance_m=10.0, width_mhz=width_mhz, sessions=20, ftms_per_burst=8, mode=mode)
    assert result.airtime_ms == pytest.approx(airtime_ms, rel=0.05)


def test_ranging_of_all_pairs_saturates_where_its_airtime_says():
    few, many = (range_mesh(stations=n, period_s=0.1, seconds=3.0) for n in (4, 12))
    # 12 sessions of 1.5 ms in 100 ms fit with ease; 132 do not
    assert few.airtime_fraction == pytest.approx(12 * 1.5 / 100, rel=0.05)
    assert few.completed_fraction > 0.99
    assert many.airtime_fraction > 1.9
    assert many.completed_fraction < 0.9
    assert many.mean_delay_ms > 3 * few.mean_delay_ms
    assert many.busy_fraction > 0.6
    assert few.round_trips_mean > 6.9
    # what does get through takes the time there is
    served = many.completed_fraction * many.round_trips_mean / 7 * many.airtime_fraction
    assert 0.8 < served < 1.05


@pytest.mark.parametrize(
    ("command", "fields"),
    [
        (
            "saturation --stations 2 --seconds 0.2 --rts --rate-mbps 54",
            {"throughput_mbps", "collisions_fraction"},
        ),
        (
            "broadcast --stations 3 --period 0.1 --jitter 0.01 --seconds 1",
            {"delivery_ratio", "mean_delay_ms", "p50_ms", "p95_ms", "p99_ms"},
        ),
        ("per --mode vht_mcs3 --width 80 --bytes 300 --snr-db 10", {"per"}),
        (
            "ftm --distance 20 --width 40 --sessions 3 --ftms-per-burst 4",
            {"error_mean_m", "error_std_m", "round_trip_std_m", "airtime_ms", "completed", "failed"},
        ),
        (
            "ftm-mesh --stations 3 --period 0.1 --seconds 0.5",
            {"completed_fraction", "mean_delay_ms", "busy_fraction"},
        ),
    ],
)
def test_every_command_answers_in_json_and_in_a_table(command, fields, capsys):
    assert main([*command.split(), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert fields <= set(answer)
    assert all(math.isfinite(value) for value in answer.values())
    assert main(command.split()) == 0
    assert "─" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("per --mode ofdm7 --snr-db 3", "'ofdm7' is no mode"),
        ("per --mode vht_mcs9 --width 20 --snr-db 3", "VHT MCS 9 does not exist on a 20 MHz channel"),
        ("saturation --rate-mbps 11", "'ofdm11' is no mode"),
        ("ftm --width 30", "30: the channel is 20, 40 or 80 MHz wide"),
        ("broadcast --stations 1", "greater than or equal to 2"),
        ("serve --port 0 --settings /nowhere/radio.json", "/nowhere/radio.json: No such file"),
    ],
)
def test_bad_input_is_one_line(command, says, capsys):
    assert main(command.split()) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1


def test_a_figure_of_the_mesh_is_written(tmp_path):
    path = tmp_path / "figures" / "mesh.png"
    assert main(f"ftm-mesh --stations 3 --period 0.1 --seconds 0.3 --json --figure {path}".split()) == 0
    assert path.read_bytes().startswith(b"\x89PNG")
