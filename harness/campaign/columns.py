"""What the columns of a campaign's table mean: identification, results, swept fields of the scenario."""

from collections.abc import Iterable

from foundation.docstrings import field_docstrings
from foundation.unit_names import unit_of
from harness.records.columns import Column, TableKind
from harness.scenario.scenario import Scenario

IDENTIFICATION = {
    "case": Column(description="Name of the case."),
    "seed": Column(description="Seed of the run."),
    "status": Column(
        description="How the run ended.",
        values={
            "completed": "its time is over",
            "not_formed": "the formation was not reached in time",
            "failed": "an error",
        },
    ),
    "reason": Column(description="Why it was not formed or failed."),
    "digest": Column(description="Name of the run's files, a hash of scenario, sources and libraries."),
}
_SHAPE = "deviation from the formation's best fit to the vehicles"
_ABSOLUTE = "distance from the places"
RESULTS = {
    "agents": Column(description="Number of UAVs."),
    "simulated_s": Column(description="Simulated time."),
    "formed_s": Column(description="Time at which the formation was reached."),
    "moves_s": Column(description="Time at which the formation began to move."),
    "formation_s": Column(description="Simulated time in formation."),
    "formation_rms_m.absolute": Column(description=f"RMS {_ABSOLUTE}, in formation."),
    "formation_rms_m.shape": Column(description=f"RMS {_SHAPE}, in formation."),
    "formation_rms_m.absolute_horizontal": Column(description=f"RMS horizontal {_ABSOLUTE}, in formation."),
    "formation_rms_m.shape_horizontal": Column(description=f"RMS horizontal {_SHAPE}, in formation."),
    "vehicles_lost": Column(description="Number of lost vehicles at the end."),
    "frames.sent": Column(description="Number of frames on the channel."),
    "frames.delivered": Column(
        description="Sum over the frames of the intended receivers that received them."
    ),
    "frames.collided": Column(description="The same, that lost them to other signals on the channel."),
    "frames.lost_to_noise": Column(description="The same, that lost them to noise."),
    "channel_busy_fraction": Column(
        description="Fraction of the time in which the channel carried a signal."
    ),
    "ftm.format": Column(
        description="Format of the ranging frames and bandwidth of their time stamps.", unit=""
    ),
    "ftm.requested": Column(description="Number of ranging requests that ended."),
    "ftm.completed": Column(description="Number of these with a distance."),
    "ftm.failed": Column(description="Number of these without a distance."),
    "ftm.error_mean_m": Column(description="Mean of measured minus true distance."),
    "ftm.error_std_m": Column(description="Standard deviation of measured minus true distance."),
    "max_gain_dbi.ideal": Column(description="Maximum gain with every vehicle upright in its place."),
    "max_gain_dbi.mean": Column(description="Mean of the maximum gain, in formation."),
    "max_gain_dbi.std": Column(description="Standard deviation of the maximum gain.", unit="dB"),
    "max_gain_dbi.patterns": Column(description="Number of instants with a pattern.", unit=""),
    "max_gain_dbi.missing": Column(description="Number of instants without a pattern.", unit=""),
    "max_gain_dbi.backend": Column(description="Solver of the antenna.", unit=""),
    "max_gain_dbi.accuracy": Column(description="Deviation of the solver from NEC2.", unit=""),
    "max_gain_dbi.note": Column(description="Why a gain is missing.", unit=""),
    "collisions": Column(description="Number of collisions of vehicles."),
    "deterministic": Column(description="Whether the run depends on scenario and seed alone."),
    "log_sha256": Column(description="Hash of events and tables of the run."),
}
"""Columns of a run's summary, by dotted path"""


def kind_of(names: Iterable[str], swept: Iterable[str], scenario: Scenario) -> TableKind:
    """Return the description of a campaign's table with columns ``names``, of which some are ``swept`` paths.

    ``scenario`` is that of a run. A column of another function's summary is described by its name alone.
    """
    paths = set(swept)
    known = IDENTIFICATION | RESULTS
    return TableKind(
        name="table",
        description="Runs of a campaign and their results.",
        row="a run, in the campaign's order",
        columns={
            name: _swept(name, scenario) if name in paths else known.get(name) or Column(description="")
            for name in names
        },
    )


def _swept(path: str, scenario: Scenario) -> Column:
    """Return the description of a field of the scenario, from its docstring."""
    at: object = scenario
    text = ""
    for word in path.split("."):
        if isinstance(at, tuple):
            at = at[int(word)] if word.isdecimal() and int(word) < len(at) else None
        else:
            text = field_docstrings(type(at)).get(word, "")
            at = getattr(at, word, None)
    return Column(description=" ".join(text.split()), unit=unit_of(path.rpartition(".")[2]))
