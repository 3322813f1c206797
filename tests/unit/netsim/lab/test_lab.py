"""The emulator compared with ns-3 and theory, without a flight."""

import csv
import json
import math
import socket
import sys

import pytest
from paths import REFERENCE

from netsim.__main__ import main as serve_run
from netsim.lab.bench import HEIGHT_M, RadioBench
from netsim.lab.broadcast import broadcast
from netsim.lab.cli import main
from netsim.lab.ranging import range_mesh, range_pair
from netsim.lab.saturation import saturate
from netsim.model.config import FtmConfig, RadioConfig
from netsim.wire.messages import FtmRequest, FtmResult


def rows(name, **cells):
    """Return the rows of a reference table with these cells."""
    with (REFERENCE / name).open() as file:
        found = [
            row for row in csv.DictReader(file) if all(row[key] == value for key, value in cells.items())
        ]
    assert found
    return found


@pytest.mark.parametrize("rts", [False, True])
@pytest.mark.parametrize("stations", [1, 5, 20])
def test_saturated_throughput_matches_ns3(stations, rts):
    (row,) = rows("ns3_saturation.csv", n=str(stations), rts=str(int(rts)), rate="OfdmRate6Mbps")
    result = saturate(stations=stations, rts=rts, mode="ofdm6", payload_bytes=1000, seconds=4.0)
    # the collisions of 4 s alone scatter by 1 %
    assert result.throughput_mbps == pytest.approx(float(row["throughput_mbps"]), rel=0.03)


def test_collisions_match_bianchis_fixed_point():
    # tau = 2 / (1 + W + p W sum_{i<m} (2p)^i), p = 1 - (1 - tau)^(n - 1); W = 16 and six doublings
    n, w, m = 10, 16, 6
    low, high = 0.0, 1.0
    for _ in range(60):
        p = (low + high) / 2
        tau = 2 / (1 + w + p * w * sum((2 * p) ** i for i in range(m)))
        low, high = (p, high) if 1 - (1 - tau) ** (n - 1) > p else (low, p)
    result = saturate(stations=n, rts=False, mode="ofdm6", payload_bytes=1000, seconds=10.0)
    # no station may use the frozen slot after every exchange, so simulated stations collide slightly less
    assert result.collisions_fraction == pytest.approx(p, abs=0.03)
    assert result.dropped == 0


@pytest.mark.parametrize(("rate_mbps", "bianchi_mbps"), [(6, 4.7087), (54, 29.8324)])
def test_bianchis_table_is_reproduced_with_its_packet_size(rate_mbps, bianchi_mbps, capsys):
    """Five stations; our frames have IP and UDP headers in front of the 1500 bytes, 1.8 % more than its."""
    command = f"saturation --stations 5 --rate-mbps {rate_mbps} --payload 1500 --seconds 6 --json"
    assert main(command.split()) == 0
    assert json.loads(capsys.readouterr().out)["throughput_mbps"] == pytest.approx(bianchi_mbps, rel=0.03)


def test_retry_limit_drops_frames_and_reduces_throughput():
    unlimited = saturate(stations=50, rts=False, mode="ofdm6", payload_bytes=1000, seconds=3.0)
    limited = saturate(stations=50, rts=False, mode="ofdm6", payload_bytes=1000, seconds=3.0, retry_limit=6)
    assert unlimited.dropped == 0 < limited.dropped
    assert limited.collisions_fraction > unlimited.collisions_fraction


@pytest.mark.parametrize(
    ("stations", "period_s", "jitter_s"), [(8, "0.1", "0.002"), (16, "0.1", "0.01"), (32, "0.1", "0.0005")]
)
def test_periodic_broadcasts_match_ns3(stations, period_s, jitter_s):
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
    assert (result.mean_delay_ms, result.p50_ms, result.p95_ms, result.p99_ms) == (None, None, None, None)


@pytest.mark.parametrize(
    ("width_mhz", "mode", "round_trip_m"), [(20, None, 0.384), (40, None, 0.161), (80, "ofdm24", 0.384)]
)
def test_ranging_has_the_measured_noise_and_no_bias(width_mhz, mode, round_trip_m):
    bias_m, sessions, frames = 0.7, 2000, 4
    result = range_pair(
        distance_m=30.0,
        width_mhz=width_mhz,
        sessions=sessions,
        ftms_per_burst=frames,
        bias_m=bias_m,
        mode=mode,
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


def test_ranging_of_all_pairs_saturates_at_the_predicted_airtime():
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
        ("uwb --distance 20 --exchanges 3", {"error_mean_m", "error_std_m", "rx_power_dbm", "exchange_ms"}),
        (
            "uwb-mesh --stations 3 --seconds 0.5 --method ss --access aloha --each-pair-once",
            {"completed_fraction", "noise_std_m", "collided_fraction", "airtime_fraction"},
        ),
    ],
)
def test_every_command_prints_json_and_a_table(command, fields, capsys):
    assert main([*command.split(), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert fields <= set(answer)
    assert all(math.isfinite(value) for value in answer.values())
    assert main(command.split()) == 0
    assert "─" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("per --mode ofdm7 --snr-db 3", "'ofdm7' is not a mode"),
        ("per --mode vht_mcs9 --width 20 --snr-db 3", "VHT MCS 9 does not exist on a 20 MHz channel"),
        ("saturation --rate-mbps 11", "'ofdm11' is not a mode"),
        ("ftm --width 30", "30: the channel width must be 20, 40 or 80 MHz"),
        ("saturation --payload 2269", "less than or equal to 2268"),
        ("broadcast --stations 1", "greater than or equal to 2"),
        ("per --mode ofdm6 --snr-db 1e5", "'--snr-db'"),
        ("per --mode ofdm6 --snr-db nan", "'--snr-db'"),
        ("per --mode ofdm6 --snr-db=-inf", "'--snr-db'"),
        ("per --mode ofdm6 --snr-db 3 --bytes 1000000000000", "'--bytes'"),
        ("broadcast --period inf", "'--period'"),
        ("broadcast --period nan", "'--period'"),
        ("broadcast --jitter inf", "'--jitter'"),
        ("broadcast --jitter nan", "'--jitter'"),
        ("broadcast --seconds nan", "'--seconds'"),
        ("saturation --retry-limit 10000000000", "'--retry-limit'"),
        ("ftm --bias inf", "'--bias'"),
        ("ftm --bias 1e300", "'--bias'"),
        ("ftm --distance nan", "'--distance'"),
        ("ftm --width 20 --mode vht_mcs9", "VHT MCS 9 does not exist on a 20 MHz channel"),
        ("ftm-mesh --period 1e300", "'--period'"),
        ("uwb --method tdoa", "--method tdoa: expected ss or ds"),
        ("uwb-mesh --access csma", "--access csma: expected aloha or slots"),
        ("uwb --settings /nowhere/uwb.json", "/nowhere/uwb.json: No such file"),
        ("serve --port 0 --radius inf", "'--radius'"),
        ("serve --port 0 --speed inf", "'--speed'"),
        ("serve --port 70000", "'--port'"),
        ("serve --port 0 --settings /nowhere/radio.json", "/nowhere/radio.json: No such file"),
    ],
)
def test_bad_input_is_one_line(command, says, capsys):
    assert main(command.split()) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1


CONTRADICTORY = '{"control_mode":"vht_mcs0"}'


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        (CONTRADICTORY, "control_mode: RTS needs a non-HT mode, vht_mcs0 is VHT"),
        (
            '{"guests":[{"name":"x","pos_ned_m":[0,0,0]},{"name":"x","pos_ned_m":[0,9,0]}]}',
            "guests[1].name: duplicate name 'x'",
        ),
        ('{"frequency_mhz":1e-300}', "frequency_mhz"),
        ('{"ftm":{"burst_duration_us":250}}', "ftm.burst_duration_us"),
        ("{", "radio.json"),
        (b"\xff", "radio.json"),
    ],
)
def test_invalid_settings_are_reported_in_one_line(settings, says, tmp_path, capsys):
    path = tmp_path / "radio.json"
    path.write_bytes(settings if isinstance(settings, bytes) else settings.encode())
    assert main(f"serve --port 0 --settings {path}".split()) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1


def test_emulator_process_rejects_inconsistent_settings_in_one_line(tmp_path, capsys, monkeypatch):
    path = tmp_path / "radio.json"
    path.write_text(f'{{"run_id":"x","stations":2,"seed":1,"radio":{CONTRADICTORY}}}')
    clock, master = socket.socketpair()
    monkeypatch.setattr(sys, "argv", ["netsim", "--config", str(path), "--interval-fd", str(clock.detach())])
    with master:
        assert serve_run() == 2
    error = capsys.readouterr().err
    assert error == "radio: control_mode: RTS needs a non-HT mode, vht_mcs0 is VHT\n"


def test_settings_made_in_python_are_range_checked():
    places_ned_m = [(0.0, 0.0, -HEIGHT_M)] * 2
    with pytest.raises(ValueError, match="frequency_mhz"):
        RadioBench(RadioConfig(frequency_mhz=-1.0), places_ned_m, 1)
    with pytest.raises(ValueError, match="calibration_bias_m"):
        RadioBench(RadioConfig(ftm=FtmConfig(calibration_bias_m=math.inf)), places_ned_m, 1)


@pytest.mark.parametrize(
    ("width_mhz", "ftm"),
    [
        (80, FtmConfig(burst_duration_us=500, min_delta_us=300)),
        (20, FtmConfig(burst_duration_us=500, min_delta_us=300, mode="ofdm6")),
        (80, FtmConfig(burst_duration_us=250, min_delta_us=100, mode="vht_mcs9")),
    ],
)
def test_shortest_accepted_bursts_complete_a_round_trip(width_mhz, ftm):
    """Each has at least 40 us more than two frames take, and AC_VO's backoff draws 0 to 3 slots of 9 us.

    The first frame comes SIFS, ACK and AIFS after the burst begins, but the last may end after it.
    """
    config = RadioConfig(bandwidth_mhz=width_mhz, rician_k_db=None, ftm=ftm)
    bench = RadioBench(config, [(0.0, 0.0, -HEIGHT_M), (10.0, 0.0, -HEIGHT_M)], 1)
    for session in range(20):
        bench.submit(0, FtmRequest(seq=session + 1, at_us=200_000 * session, peer=1))
    results = [item for _, item in bench.run(4_200_000) if isinstance(item, FtmResult)]
    assert len(results) == 20
    assert sum(result.status == "ok" for result in results) >= 15


@pytest.mark.parametrize(
    ("command", "unknown"),
    [
        ("ftm --distance 4000 --sessions 2", {"error_mean_m", "error_std_m", "round_trip_std_m"}),
        ("ftm --sessions 1 --ftms-per-burst 2", {"error_std_m", "round_trip_std_m"}),
        ("uwb --distance 500 --exchanges 2", {"error_mean_m", "error_std_m", "rx_power_dbm"}),
        ("broadcast --seconds 0.5", {"mean_delay_ms", "p50_ms", "p95_ms", "p99_ms"}),
        # 380 sessions in a millisecond, the duration of one: none completes
        ("ftm-mesh --stations 20 --period 0.001 --seconds 0.003", {"mean_delay_ms"}),
    ],
)
def test_undefined_values_are_null_and_a_dash(command, unknown, capsys):
    assert main([*command.split(), "--json"]) == 0
    line = capsys.readouterr().out
    assert line.count("\n") == 1
    assert {name for name, value in json.loads(line).items() if value is None} == unknown
    assert main(command.split()) == 0
    words = capsys.readouterr().out.split()
    assert words.count("-") >= len(unknown)  # a mesh has a row for fewer stations too


def test_figure_of_meshes_without_completed_sessions_is_drawn(tmp_path):
    path = tmp_path / "mesh.png"
    command = f"ftm-mesh --stations 20 --period 0.001 --seconds 0.003 --json --figure {path}"
    assert main(command.split()) == 0
    assert path.read_bytes().startswith(b"\x89PNG")


def test_a_figure_of_the_mesh_is_written(tmp_path):
    path = tmp_path / "figures" / "mesh.png"
    assert main(f"ftm-mesh --stations 3 --period 0.1 --seconds 0.3 --json --figure {path}".split()) == 0
    assert path.read_bytes().startswith(b"\x89PNG")
