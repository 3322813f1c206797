"""What a link simulation counted: frames lost over AWGN, by VHT mode and signal-to-noise ratio.

``vht_tables.csv`` is made by ``python scripts/link_tables.py --seed 1`` from `studies.link_tables`: one
spatial stream, BCC, 80 MHz, ratio per occupied subcarrier. A row ends when 200 frames were lost and as many
were not, or after 20000 frames.
"""

import csv
from importlib.resources import files

Row = tuple[float, int, int, int]
"""Signal-to-noise ratio in dB, bytes of a frame, frames sent, frames lost."""


def _read() -> dict[str, list[Row]]:
    counts: dict[str, list[Row]] = {}
    for row in csv.DictReader((files("netsim.phy") / "vht_tables.csv").read_text("utf-8").splitlines()):
        counted = float(row["snr_db"]), int(row["frame_bytes"]), int(row["frames"]), int(row["lost"])
        counts.setdefault(row["mode"], []).append(counted)
    return counts


VHT_COUNTS = _read()
"""Rows by mode, in order of the ratio."""
