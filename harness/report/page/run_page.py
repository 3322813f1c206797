"""Writes ``report.html`` of a run: one file that a browser opens from disk, without a network.

Made of the run's tables, summary and manifest, and of what the report has computed anyway. Equal runs give
equal bytes, except where wall times and facts of the machine are printed.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antenna.analysis.patterns import Pattern
from foundation.records.whole_file import write_whole
from harness.records.columns import flight_kind
from harness.records.run_folder import RunFolder
from harness.report.antenna_report import Aperture
from harness.report.page import flight_plots, run_sections
from harness.report.page.antenna_plots import gain_plots, pattern_plots
from harness.report.page.channel_plots import losses_plot, occupancy_plot
from harness.report.page.content import Page, Section
from harness.report.page.envelope import envelope
from harness.report.page.flight_plots import ErrorEnvelopes
from harness.report.page.plots import Plot
from harness.report.page.replay import Links, Replay, replay_rows
from harness.report.page.run_tables import (
    FlightColumns,
    failsafe_words,
    read_channel,
    read_events,
    read_ranging,
    read_sensors,
    recorded_s,
)
from harness.report.page.timeline import Segment, event_rows, phases_of, segments, timeline_plot
from harness.report.vehicle_colours import vehicle_colours
from harness.scenario.scenario import Scenario

MOST_NUMBERS = 12
"""Numbers of the applications that are drawn"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Computed:
    """What the report has computed besides the tables."""

    errors: ErrorEnvelopes | None
    """None without a formation"""
    antenna: Aperture
    patterns: tuple[Pattern, Pattern] | None
    """Ideal pattern, and that at the instant of median maximum gain"""
    occupancy: tuple[NDArray[np.int64], NDArray[np.float64]]
    """Times in us, and the fraction of the interval before each in which the channel was busy"""


def write_page(
    folder: RunFolder,
    scenario: Scenario,
    computed: Computed,
    *,
    summary: Mapping[str, Any],
    manifest: Mapping[str, Any],
) -> None:
    """Write the page of a run that has its tables. Raises OSError."""
    page = make_page(folder, scenario, computed, summary=summary, manifest=manifest)
    from harness.report.page.html import render  # noqa: PLC0415  Jinja and Plotly: for pages only

    write_whole(folder.page, render(page), private=True)


def make_page(
    folder: RunFolder,
    scenario: Scenario,
    computed: Computed,
    *,
    summary: Mapping[str, Any],
    manifest: Mapping[str, Any],
) -> Page:
    """Return the content of the page. Raises OSError."""
    end_s = recorded_s(folder, float(summary["simulated_s"]))
    flight = FlightColumns(folder.flight, scenario.agents)
    replayed, links = _replay(flight)
    channel = read_channel(folder, end_s, links)
    ranging = read_ranging(folder, end_s, links)
    events = event_rows(read_events(folder))
    happened = Section(
        key="events",
        title="Events",
        plots=[timeline_plot(_lanes(flight, folder), events, vehicles=scenario.agents, end_s=end_s)],
        tables=run_sections.event_tables(events),
    )
    sections = [happened]
    if replayed is not None:
        sections.append(_replay_section(replayed))
    sections.append(
        Section(
            key="flight",
            title="Flight",
            plots=_flight_plots(flight, folder, computed, end_s),
            tables=[run_sections.vehicle_table(summary, scenario)],
        )
    )
    flight.close()
    antenna = computed.antenna
    if antenna.series is not None and antenna.series.patterns:
        plots = gain_plots(antenna.series, antenna.ideal)
        plots += pattern_plots(*computed.patterns) if computed.patterns is not None else []
        sections.append(run_sections.antenna_section(summary["max_gain_dbi"], plots))
    stations = channel.table(channel.by_source)
    occupancy = [] if (plot := occupancy_plot(*computed.occupancy)) is None else [plot]
    by_station = [] if (plot := losses_plot(stations)) is None else [plot]
    sections += [
        Section(
            key="channel",
            title="Channel",
            plots=[*occupancy, *channel.plots(), *by_station],
            tables=run_sections.channel_tables(channel, scenario.agents),
            text="" if stations else "No frame was sent.",
        ),
        Section(
            key="ranging",
            title="Ranging",
            plots=ranging.plots(),
            tables=run_sections.ranging_tables(ranging),
            text="" if ranging.by_status else "No ranging session was requested.",
        ),
        run_sections.scenario_section(scenario),
        run_sections.provenance_section(summary, manifest),
        run_sections.files_section(folder),
    ]
    return run_sections.page_of(
        scenario, summary, manifest, sections, colours=vehicle_colours(scenario.agents)
    )


def _lanes(flight: FlightColumns, folder: RunFolder) -> dict[str, tuple[list[Segment], dict[str, str]]]:
    """Return phases, modes and failsafes of the vehicles as segments, with the meanings of their values."""
    columns = flight_kind(folder.applications()).columns
    time_s, alive = flight.time_s, flight.alive
    causes = np.where(flight.column("failsafe"), flight.column("causes"), -1)
    failsafes = segments(time_s, causes, alive)
    words = failsafe_words(sorted({each.value for each in failsafes}), columns["causes"].values)
    return {
        "Phase": (segments(time_s, phases_of(flight.column("phase")), alive), dict(columns["phase"].values)),
        "Mode": (segments(time_s, flight.column("mode"), alive), dict(columns["mode"].values)),
        "Failsafe": (failsafes, words),
    }


def _replay(flight: FlightColumns) -> tuple[Replay | None, Links | None]:
    """Return the replay, whose links are to be added; None without two instants."""
    rows, rate_hz = replay_rows(flight.time_s, flight.vehicles)
    if len(rows) < 2:
        return None, None
    links = Links(flight.time_s[rows], flight.vehicles)
    replay = Replay(
        time_s=flight.time_s[rows],
        rate_hz=rate_hz,
        pos_ned_m=flight.vectors("pos_ned_m", rows),
        desired_pos_ned_m=flight.vectors("desired_pos_ned_m", rows),
        believed_pos_ned_m=flight.vectors("onboard_pos_ned_m", rows),
        alive=flight.alive[rows],
        links=links,
    )
    return replay, links


def _replay_section(replay: Replay) -> Section:
    content = replay.content()
    parts = [
        f"{replay.rate_hz:.3g} instants per second",
        "links are the ranging sessions and datagrams to one receiver since the instant before",
        "a red halo: some receivers lost broadcasts of that UAV, and its size is their share",
    ]
    if (until_s := replay.links.until_s()) is not None:
        parts.append(f"links after {until_s:.2f} s are left out, as they are too many")
    if content["stretch"] > 1.0:
        parts.append(f"heights are stretched {content['stretch']:.3g} times")
    note = "; ".join(parts)
    return Section(
        key="replay-section", title="Replay", replay=content, replay_note=note[0].upper() + note[1:] + "."
    )


def _flight_plots(flight: FlightColumns, folder: RunFolder, computed: Computed, end_s: float) -> list[Plot]:
    """Return the figures of the flight; none without a recorded instant."""
    if not len(flight):
        return []
    time_s, plots = flight.time_s, list[Plot]()
    rows = flight_plots.map_rows(len(flight), flight.vehicles)
    pos_ned_m = flight.vectors("pos_ned_m", rows)
    pos_ned_m[~flight.alive[rows]] = np.nan
    step_s = (time_s[-1] - time_s[0]) / max(len(rows) - 1, 1)
    note = f"true positions, every {step_s:.3g} s; dotted: desired, if the formation moves"
    plots.append(
        flight_plots.map_plot(time_s[rows], pos_ned_m, flight.vectors("desired_pos_ned_m", rows), note=note)
    )
    down_m = envelope(flight.living("pos_ned_m.d"))
    desired_m = envelope(flight.column("desired_pos_ned_m.d"))
    bin_s = flight_plots.bin_seconds(time_s, down_m)
    plots.append(flight_plots.heights_plot(time_s, down_m, desired_m, bin_s=bin_s))
    if computed.errors is not None:
        plots += flight_plots.error_plots(computed.errors)
    made = (
        flight_plots.vehicle_plot(
            "localisation",
            "Error of the position that UAVs believe",
            "Error (m)",
            time_s,
            flight.length("onboard_pos_ned_m", "pos_ned_m"),
            digits=3,
            unit="m",
            rangemode="tozero",
            note="on-board localisation against the truth",
        ),
        flight_plots.vehicle_plot(
            "speed",
            "Speed",
            "Speed (m/s)",
            time_s,
            flight.length("vel_ned_m_s"),
            unit="m/s",
            rangemode="tozero",
        ),
        flight_plots.vehicle_plot(
            "tilt",
            "Tilt",
            "Angle from upright (°)",
            time_s,
            flight.tilt_deg(),
            digits=1,
            unit="°",
            rangemode="tozero",
        ),
        flight_plots.vehicle_plot(
            "battery",
            "Battery",
            "Charge left (%)",
            time_s,
            100.0 * flight.living("battery_remaining"),
            digits=1,
            unit="%",
        ),
        *(
            flight_plots.number_plot(f"app-{k}", name, time_s, flight.living(name))
            for k, name in enumerate(flight.application_columns()[:MOST_NUMBERS])
        ),
    )
    plots += [plot for plot in made if plot is not None]
    series, edges_s, left_out = read_sensors(folder, flight.vehicles, end_s)
    return plots + flight_plots.sensor_plots(series, edges_s, left_out=left_out)
