"""What a link simulation counted: frames lost over AWGN, by VHT mode and signal-to-noise ratio.

``vht_tables.csv`` is made by ``python scripts/link_tables.py --seed 1`` from `studies.link_tables`: one
spatial stream, BCC, 80 MHz, ratio per occupied subcarrier. A row ends when 200 frames were lost and as many
were not, or after 20000 frames.
"""

import csv
from importlib.resources import files

from netsim.model.config import Mode

Row = tuple[float, int, int, int]
"""Signal-to-noise ratio in dB, bytes of a frame, frames sent, frames lost."""


def vht_counts(mode: Mode) -> list[Row]:
    """Return the rows of a VHT mode in order of the ratio."""
    lines = (files("netsim.phy") / "vht_tables.csv").read_text("utf-8").splitlines()
    return [
        (float(snr_db), int(frame_bytes), int(frames), int(lost))
        for name, snr_db, frame_bytes, frames, lost in csv.reader(lines)
        if name == mode
    ]
