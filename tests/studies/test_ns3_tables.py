"""Tables that ns-3 made: complete, and equal to numbers that follow from the standard's timing."""

from fractions import Fraction
from math import ceil
from pathlib import Path

import pytest
import typer

from studies.common.reference import REFERENCE, reference_table
from studies.ns3.cases import Arguments, Table, tables
from studies.ns3.runner import ns3_references

TABLES = {table.name: table for table in tables()}
SPEED_OF_LIGHT_M_NS = 0.299792458
HE_SUBCARRIERS = {20: 234, 80: 980}
HE_BITS = {0: Fraction(1, 2), 5: Fraction(6 * 2, 3), 11: Fraction(10 * 5, 6)}
"""Data bits of a subcarrier and symbol, by MCS."""


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
def test_a_table_has_the_columns_and_one_row_of_each_run(table: Table) -> None:
    header = (REFERENCE / f"{table.name}.csv").read_text(encoding="utf-8").splitlines()[0]
    assert tuple(header.split(",")) == table.columns
    rows = reference_table(f"{table.name}.csv")
    left_out = table.name == "ns3_he_airtime"  # PPDUs that are too long
    assert len(rows) < len(table.runs) if left_out else len(rows) == len(table.runs)
    if table.name != "ns3_range":
        results = table.columns.index("psdu_bytes" if table.name == "ns3_he_airtime" else "seconds")
        conditions = {tuple(row.values())[:results] for row in rows}
        assert len(conditions) == len(rows)


def test_frames_are_acknowledged_while_the_round_trip_is_shorter_than_a_slot() -> None:
    """ns-3 rounds the delay to nanoseconds; at 1349 m both events then fall on the same one."""
    for row in reference_table("ns3_range.csv"):
        in_time = 2 * round(float(row["distance_m"]) / SPEED_OF_LIGHT_M_NS) < 1000 * float(row["slot_us"])
        assert int(row["acknowledged"]) == (int(row["datagrams"]) if in_time else 0), row


def test_he_air_times_are_those_of_whole_symbols_after_the_preamble() -> None:
    for row in reference_table("ns3_he_airtime.csv"):
        preamble_us = 36 + 8 * int(row["streams"])
        run: Arguments = {
            "width": int(row["width_mhz"]), "streams": int(row["streams"]), "mcs": int(row["mcs"]),
            "gi": int(row["guard_interval_ns"]), "mpdus": int(row["mpdus"]),
        }  # fmt: skip
        assert float(row["preamble_us"]) == preamble_us
        assert float(row["ppdu_us"]) == pytest.approx(_he_us(run), abs=1e-6), row


def test_throughput_of_an_ampdu_pair_is_that_of_its_cycle() -> None:
    """A cycle: AIFS of 43 us, 7.5 slots of backoff, PPDU, SIFS, Block Ack of 32 B at 6 or 24 Mbit/s."""
    for row in reference_table("ns3_ampdu.csv"):
        plain = all(row[name] == "0" for name in ("amsdu_bytes", "loss", "hidden", "rts"))
        if not plain or row["senders"] != "1" or row["standard"] != "vht" or float(row["mpdus_per_ppdu"]) < 2:
            continue
        block_ack_us = 68 if row["mcs"] == "0" else 32
        cycle_us = 43 + 7.5 * 9 + float(row["ppdu_us"]) + 16 + block_ack_us
        mbps = float(row["mpdus_per_ppdu"]) * 8 * int(row["payload_bytes"]) / cycle_us
        assert float(row["throughput_mbps"]) == pytest.approx(mbps, rel=0.01), row


@pytest.mark.parametrize(
    ("option", "message"),
    [({"only": "ns3_rain"}, "no table is called ns3_rain"), ({"only": "ns3_he"}, "build it")],
)
def test_bad_input_ends_with_one_line(
    option: dict[str, str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(typer.Exit) as end:
        ns3_references(build=tmp_path, out=tmp_path, workers=1, **option)
    assert end.value.exit_code == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def _he_us(run: Arguments) -> float:
    """Return HE SU's air time: preamble, then symbols of 12.8 us and guard interval; 22 bits are not data."""
    mpdu_bytes = 1400 + 28 + 8 + 30
    padded_bytes = 4 * ceil(mpdu_bytes / 4)
    psdu_bytes = (int(run["mpdus"]) - 1) * (4 + padded_bytes) + 4 + mpdu_bytes
    streams = int(run["streams"])
    bits = HE_SUBCARRIERS[int(run["width"])] * HE_BITS[int(run["mcs"])] * streams
    symbols = ceil(Fraction(22 + 8 * psdu_bytes) / int(bits))
    return 36 + 8 * streams + symbols * (12.8 + 1e-3 * float(run["gi"]))
