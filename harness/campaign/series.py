"""Series of a run over time, as bytes of Parquet: what is kept beside its numbers if it is asked for."""

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from harness.flight import Array, Flight
from harness.motion_start import flown_start_us, since_start_s
from harness.run_folder import RunFolder
from harness.scenario import Scenario


class NoSeries(RuntimeError):
    """A run has no such series; the text is one line that says why."""


def read_series(folder: RunFolder, names: Sequence[str], *, antenna_note: str | None) -> dict[str, bytes]:
    """Give series by their names (`harness.campaign.definition.KEPT`) from a run's folder, as they are there.

    ``antenna_note`` is the summary's: why there are no gains, if there are none. Raises `NoSeries`, OSError.
    """
    if "gains" in names and not folder.gains.exists():
        raise NoSeries(f"no gains to keep: {antenna_note}")
    return {name: (folder.path / f"{name}.parquet").read_bytes() for name in names}


def read_flight(folder: RunFolder, scenario: Scenario) -> Flight:
    """Read a run that has been reported, as the analysis takes it; raises OSError."""
    return make_flight(pq.read_table(folder.flight), scenario, start_us=flown_start_us(folder.events))


def make_flight(columns: pa.Table, scenario: Scenario, *, start_us: int | None) -> Flight:
    """Make a flight of a run's table of that name, which a campaign may have kept.

    ``start_us``: when the formation began to move; None if it never did.
    """

    def vectors(name: str, labels: str) -> Array:
        parts = [columns.column(f"{name}.{label}").to_numpy() for label in labels]
        stacked: Array = np.stack(parts, axis=-1).reshape(-1, scenario.agents, len(labels))
        return stacked

    time_us = columns.column("time_us").to_numpy()[:: scenario.agents].astype(np.int64)
    return Flight(
        time_us=time_us,
        pos_ned_m=vectors("pos_ned_m", "ned"),
        q_ned_frd=vectors("q_ned_frd", "wxyz"),
        desired_pos_ned_m=vectors("desired_pos_ned_m", "ned"),
        heading_rad=scenario.plan().headings(since_start_s(time_us, start_us)),
        alive=columns.column("alive").to_numpy().astype(np.bool_).reshape(-1, scenario.agents),
        believed_pos_ned_m=vectors("onboard_pos_ned_m", "ned"),
    )
