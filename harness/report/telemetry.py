"""Counts of the frames that carried MAVLink between vehicles and ground stations on the radio."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from harness.records.outcome import ProcessRecord


def telemetry_frames(processes: Iterable[ProcessRecord]) -> dict[str, dict[str, int]]:
    """Return sums over the vehicles, at their end of the links, by ground station; empty without any.

    They are those of `autopilot.mavlink.radio_carrier.FrameCounts`. A vehicle that was killed reports none.
    """
    sums: dict[str, dict[str, int]] = {}
    for details in _vehicles(processes):
        link = details.get("links", {}).get("ground_station", {})
        for station, counts in link.get("frames", {}).items():
            of_station = sums.setdefault(station, dict.fromkeys(counts, 0))
            for name, count in counts.items():
                of_station[name] += count
    return sums


def _vehicles(processes: Iterable[ProcessRecord]) -> Iterator[Mapping[str, Any]]:
    """Yield the details of the vehicles, which in a run of one process are parts of the simulation's."""
    for process in processes:
        for name, details in (process.name, process.details), *process.details.items():
            if name.startswith("uav ") and isinstance(details, Mapping):
                yield details
