"""Series of a run over time, as bytes of Parquet: what is kept beside its numbers if it is asked for."""

from collections.abc import Sequence

from harness.records.run_folder import RunFolder


class NoSeries(RuntimeError):
    """A run has no such series; the text is one line that says why."""


def read_series(folder: RunFolder, names: Sequence[str], *, antenna_note: str | None) -> dict[str, bytes]:
    """Give series by their names (`harness.campaign.definition.KEPT`) from a run's folder, as they are there.

    ``antenna_note`` is the summary's: why there are no gains, if there are none. Raises `NoSeries`, OSError.
    """
    if "gains" in names and not folder.gains.exists():
        raise NoSeries(f"no gains to keep: {antenna_note}")
    return {name: (folder.path / f"{name}.parquet").read_bytes() for name in names}
