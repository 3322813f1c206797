"""Series of a run over time as Parquet bytes, which a campaign stores on request."""

from collections.abc import Sequence

from harness.records.run_folder import RunFolder


class NoSeries(RuntimeError):
    """A run has no such series; the text is the reason in one line."""


def read_series(folder: RunFolder, names: Sequence[str], *, antenna_note: str | None) -> dict[str, bytes]:
    """Return series of a run's folder by their names (`harness.campaign.definition.KEPT`).

    ``antenna_note`` is the summary's reason for missing gains. Raises `NoSeries`, OSError.
    """
    if "gains" in names and not folder.gains.exists():
        raise NoSeries(f"no gains to keep: {antenna_note}")
    return {name: (folder.path / f"{name}.parquet").read_bytes() for name in names}
