"""Texts and tables of a run's page: summary, vehicles, channel, ranging, scenario, origin, files."""

import shlex
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from harness.records.run_folder import RunFolder
from harness.report.page.channel_plots import ChannelStatistics
from harness.report.page.content import (
    Card,
    Cell,
    Page,
    Section,
    Table,
    count,
    file_link,
    number,
    percent,
    size_text,
)
from harness.report.page.plots import Plot
from harness.report.page.ranging_plots import RangingStatistics
from harness.report.page.scenario_changes import changes
from harness.report.page.timeline import MOST_EVENTS, EventRow, shown_events
from harness.scenario.scenario import Scenario

MOST_PAIRS = 400
"""Rows of the table of pairs; a larger swarm has the matrices and ftm.parquet"""
TONES = {"completed": "good", "held": "", "interrupted": "", "not_formed": "bad", "failed": "bad"}
FILES = {
    "manifest.json": "what was flown, with which versions, and how it ended",
    "summary.json": "the results of this page as JSON",
    "events.jsonl": "events in simulated time",
    "flight.parquet": "truth and estimates of every vehicle",
    "radio.parquet": "every frame on the channel",
    "ftm.parquet": "every ranging session",
    "air.parquet": "occupancy of the channel",
    "receptions.parquet": "each frame at each station",
    "sensors.parquet": "readings of the scenario's own sensors",
    "radio.pcapng": "capture of the channel, for Wireshark",
    "gains.parquet": "maximum gain over time",
    "antenna.nec": "the array at the instant of median gain, as a NEC deck",
    "patterns.nc": "the patterns over time",
}
"""Files of a run in their order, with what they hold"""


def page_of(
    scenario: Scenario,
    summary: Mapping[str, Any],
    manifest: Mapping[str, Any],
    sections: Sequence[Section],
    *,
    colours: Sequence[str],
) -> Page:
    """Return the page of these sections with its head."""
    status = str(summary["status"])
    vehicles = f"{scenario.agents} UAV{'s' if scenario.agents > 1 else ''}"
    notes = [str(summary["reason"])] if summary.get("reason") else []
    notes += [f"Not deterministic: {cause}" for cause in manifest["nondeterminism"]]
    return Page(
        kind="Run",
        title=scenario.name,
        badge=status.replace("_", " "),
        badge_tone=TONES.get(status, ""),
        subtitle=[
            f"seed {scenario.run.seed}",
            vehicles,
            f"{summary['simulated_s']:.1f} s simulated",
            f"flown {manifest['started_utc']}",
            f"coflight {manifest['versions'].get('coflight', '')}",
        ],
        notes=notes,
        cards=cards(summary),
        sections=sections,
        vehicles=list(colours),
        footer="Written by coflight. The file holds all that it shows and loads nothing; it has the settings "
        "of the scenario and the command line in it.",
    )


def cards(summary: Mapping[str, Any]) -> list[Card]:
    """Return the main results."""
    formation, frames, ftm, gain = (
        summary[key] for key in ("formation_rms_m", "frames", "ftm", "max_gain_dbi")
    )
    lost = sum(not vehicle["alive"] for vehicle in summary["vehicles"])
    receivers = sum(frames[key] for key in ("delivered", "collided", "lost_to_noise"))
    deterministic = bool(summary["deterministic"])
    return [
        Card(
            label="Formation reached at",
            value=number(summary["formed_s"], ".2f", "s"),
            detail=f"{summary['formation_s']:.1f} s in formation",
        ),
        Card(
            label="Shape error, RMS",
            value=number(formation["shape"], ".3f", "m"),
            detail=f"from the places: {number(formation['absolute'], '.3f', 'm')}",
        ),
        Card(
            label="Maximum gain, mean",
            value=number(gain["mean"], ".2f", "dBi"),
            detail=f"ideal {number(gain['ideal'], '.2f', 'dBi')}"
            if gain["mean"] is not None
            else str(gain.get("note") or ""),
        ),
        Card(
            label="Channel busy",
            value=percent(summary["channel_busy_fraction"], 1.0),
            detail=f"{count(frames['sent'])} frames",
        ),
        Card(
            label="Frames delivered",
            value=percent(frames["delivered"], receivers),
            detail=f"{count(frames['collided'])} collided, {count(frames['lost_to_noise'])} lost to noise",
        ),
        Card(
            label="Ranging sessions",
            value=f"{count(ftm['completed'])} of {count(ftm['requested'])}",
            detail=f"error {number(ftm['error_mean_m'], '.3f')} ± {number(ftm['error_std_m'], '.3f', 'm')}",
        ),
        Card(
            label="Vehicles lost",
            value=str(lost),
            tone="bad" if lost else "",
            detail=f"{summary['collisions']} collisions",
        ),
        Card(
            label="Deterministic",
            value="yes" if deterministic else "no",
            tone="good" if deterministic else "bad",
            detail=f"log {str(summary['log_sha256'])[:12]}",
        ),
        Card(
            label="Real-time factor",
            value=number(summary["real_time_factor"], ".2f"),
            detail=f"{number(summary['wall_s'], '.1f', 's')} of wall time",
        ),
    ]


def event_tables(events: Sequence[EventRow]) -> list[Table]:
    """Return the events as a table; none without an event."""
    if not events:
        return []
    rows: list[list[Cell]] = [
        [f"{each.time_s:.3f}", "run" if each.vehicle is None else f"UAV {each.vehicle}", each.text]
        for each in shown_events(events)
    ]
    note = (
        f"{MOST_EVENTS} of {len(events)}, failures before others; events.jsonl has all."
        if len(events) > MOST_EVENTS
        else ""
    )
    return [Table(heads=("Time (s)", "Of", "Event"), rows=rows, numeric=(0,), note=note, is_long=True)]


def vehicle_table(summary: Mapping[str, Any], scenario: Scenario) -> Table:
    """Return the vehicles with their errors and losses."""
    rotors = scenario.rotors()
    rows: list[list[Cell]] = [
        [
            f"UAV {each['uav']}",
            str(rotors[each["uav"]]),
            scenario.autopilot.kind_of(each["uav"]),
            "yes" if each["alive"] else "no",
            number(each["absolute_rms_m"]),
            number(each["shape_rms_m"]),
            "; ".join(filter(None, (each["lost"], each["application_lost"]))) or "–",
        ]
        for each in summary["vehicles"]
    ]
    heads = (
        "UAV",
        "Rotors",
        "Autopilot",
        "Alive at the end",
        "RMS from place (m)",
        "RMS of shape (m)",
        "Lost",
    )
    return Table(title="Vehicles", heads=heads, rows=rows, numeric=(1, 4, 5), is_long=True)


def antenna_section(gain: Mapping[str, Any], plots: Sequence[Plot]) -> Section:
    """Return the section of the antenna."""
    facts: list[tuple[str, Cell]] = [
        ("Ideal maximum", number(gain["ideal"], ".3f", "dBi")),
        ("Flown maximum", f"{number(gain['mean'], '.3f', 'dBi')} ± {number(gain['std'], '.3f', 'dB')}"),
        ("Instants", f"{gain['patterns']} with a pattern, {gain['missing']} without"),
        ("Computed by", ": ".join(filter(None, (gain["backend"], gain["accuracy"]))) or "–"),
    ]
    return Section(key="antenna", title="Antenna", facts=facts, plots=plots, text=str(gain.get("note") or ""))


def channel_tables(channel: ChannelStatistics, vehicles: int) -> list[Table]:
    """Return frames by kind, by transmission mode and by station; none without a frame."""
    if not channel.by_kind:
        return []
    heads = ("Frames", "Bytes", "Airtime (s)", "Delivered", "Collided", "Lost to noise", "Lost (%)")
    tables = []
    for title, first, sums in (
        ("Frames by kind", "Kind", channel.by_kind),
        ("Frames by transmission mode", "Mode", channel.by_mode),
        ("Frames by station", "Station", channel.by_source),
    ):
        rows: list[list[Cell]] = [
            [
                _station(each["name"], vehicles),
                count(each["frames"]),
                count(each["bytes"]),
                f"{each['airtime_s']:.3f}",
                *(count(each[key]) for key in ("delivered", "collided", "lost_to_noise")),
                percent(
                    each["collided"] + each["lost_to_noise"],
                    each["delivered"] + each["collided"] + each["lost_to_noise"],
                ),
            ]
            for each in channel.table(sums)
        ]
        tables.append(
            Table(title=title, heads=(first, *heads), rows=rows, numeric=range(1, 8), is_long=len(rows) > 12)
        )
    tables[-1] = Table(
        title=tables[-1].title,
        heads=tables[-1].heads,
        rows=tables[-1].rows,
        numeric=range(1, 8),
        is_long=tables[-1].is_long,
        note="Delivered, collided and lost count intended receivers: a broadcast has several.",
    )
    return tables


def _station(name: object, vehicles: int) -> str:
    if not isinstance(name, int):
        return str(name)
    return f"UAV {name}" if name < vehicles else f"guest {name - vehicles}"


def ranging_tables(ranging: RangingStatistics) -> list[Table]:
    """Return sessions by status and by pair; none without a session."""
    if not ranging.by_status:
        return []
    total = sum(ranging.by_status.values())
    statuses: list[list[Cell]] = [
        [status, count(each), percent(each, total)] for status, each in sorted(ranging.by_status.items())
    ]
    pairs = ranging.pair_rows()
    rows: list[list[Cell]] = [
        [
            str(initiator),
            str(peer),
            count(sessions),
            percent(completed, sessions, ".1f"),
            number(mean, ".4f"),
            number(spread, ".4f"),
        ]
        for initiator, peer, sessions, completed, mean, spread in pairs[:MOST_PAIRS]
    ]
    note = f"The first {MOST_PAIRS} of {len(pairs)} pairs." if len(pairs) > MOST_PAIRS else ""
    heads = ("Initiator", "Peer", "Sessions", "Completed", "Mean error (m)", "Standard deviation (m)")
    return [
        Table(
            title="Sessions by status", heads=("Status", "Sessions", "Share"), rows=statuses, numeric=(1, 2)
        ),
        Table(title="Sessions by pair", heads=heads, rows=rows, numeric=range(6), note=note, is_long=True),
    ]


def scenario_section(scenario: Scenario) -> Section:
    """Return what of the scenario differs from its defaults, and all of it."""
    rows: list[list[Cell]] = [
        [each.path, each.value, each.default, each.description] for each in changes(scenario)
    ]
    table = Table(heads=("Field", "Value", "Default", "Meaning"), rows=rows, is_long=len(rows) > 16)
    whole = msgspec.json.format(msgspec.json.encode(scenario), indent=2).decode()
    return Section(
        key="scenario",
        title="Scenario",
        tables=[table] if rows else [],
        text="Fields that differ from their defaults." if rows else "All fields have their defaults.",
        source=whole,
        source_title="All fields",
    )


def provenance_section(summary: Mapping[str, Any], manifest: Mapping[str, Any]) -> Section:
    """Return what the run was flown with, and what it depended on."""
    checkout = manifest["checkout"]
    commit = (
        "–"
        if checkout is None
        else str(checkout["commit"]) + (", changed files" if checkout["dirty"] else "")
    )
    facts: list[tuple[str, Cell]] = [
        ("Deterministic", "yes: it depends on scenario and seed alone" if summary["deterministic"] else "no"),
        *(("Depends also on", str(cause)) for cause in manifest["nondeterminism"]),
        *(("Intervention", str(each)) for each in manifest["interventions"]),
        ("Hash of the logs", str(summary["log_sha256"])),
        ("Messages of stations", count(manifest["ground_messages"])),
        ("Command", shlex.join(map(str, manifest["command"]))),
        ("Started", str(manifest["started_utc"])),
        ("Requested speed", f"{manifest['speed']}"),
        ("Commit", commit),
        ("Platform", str(manifest["platform"])),
    ]
    versions: list[list[Cell]] = [[name, str(version)] for name, version in manifest["versions"].items()]
    tables = [Table(title="Versions", heads=("Package", "Version"), rows=versions)]
    if manifest["extensions"]:
        extensions: list[list[Cell]] = [
            [field, *(str(origin.get(key) or "–") for key in ("name", "path", "distribution", "version"))]
            for field, origin in manifest["extensions"].items()
        ]
        heads = ("Field", "Name", "Path", "Distribution", "Version")
        tables.append(Table(title="Your own code", heads=heads, rows=extensions))
    processes: list[list[Cell]] = [[str(each["name"]), str(each["ending"])] for each in manifest["processes"]]
    if processes:
        tables.append(Table(title="Processes", heads=("Process", "End"), rows=processes, is_long=True))
    return Section(key="provenance", title="Versions and determinism", facts=facts, tables=tables)


def files_section(folder: RunFolder) -> Section:
    """Return links to the files of the folder, relative to the page. Raises OSError."""
    rows: list[list[Cell]] = []
    names = [name for name in FILES if (folder.path / name).is_file()]
    others = (path for suffix in ("lua", "params", "tlog", "ulg") for path in folder.path.glob(f"*.{suffix}"))
    for name in (*names, *sorted(path.name for path in others)):
        size = (folder.path / name).stat().st_size
        rows.append([file_link(name), FILES.get(name, ""), size_text(size)])
    for part, what in (("figures", "figure"), ("logs", "messages of a process")):
        for path in sorted((folder.path / part).glob("*")):
            name = f"{part}/{path.name}"
            rows.append([file_link(name), what, size_text(path.stat().st_size)])
    return Section(
        key="files",
        title="Files",
        tables=[Table(heads=("File", "Content", "Size"), rows=rows, numeric=(2,), is_long=True)],
        text="Links lead to the files beside this page, if they are still there.",
    )
