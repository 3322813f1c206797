"""A flight with programs: its scenario as text, and what is left of it to judge."""

import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow.parquet as pq
from msgspec import Struct
from numpy.typing import NDArray

from harness.launch.swarm import Swarm, SwarmError, SwarmTimeoutError
from netsim.model.config import RadioConfig

NO_APPLICATION = """
[onboard]
enabled = false
"""
"""No application: the channel has the programs' frames alone."""
SNAP_AND_MAC_BYTES = 8 + 28
"""LLC/SNAP header, and MAC header with check sequence, of a packet's frame."""
UDP_AND_IP_BYTES = 8 + 20
_PIECE_S = 0.5
"""Simulated time between two looks at the output of a program"""


class Lateness(Struct, frozen=True, kw_only=True):
    """By how much packets were later than their simulated time, in wall time."""

    late_fraction: float
    """Share of the packets that were more than 20 ms late at the channel or at their receiver"""
    mean_ms: float
    """Of receptions, from the end of the frame to the receiver's interface"""
    largest_ms: float

    @property
    def text(self) -> str:
        """Mean, largest, and share of late packets."""
        return f"{self.mean_ms:.1f} / {self.largest_ms:.0f} ms, {100.0 * self.late_fraction:.1f} %"


LATENESS_COLUMN = "late: mean / largest, share over 20 ms"


class Flown(NamedTuple):
    """Records of a flight."""

    logs: dict[tuple[int, str], str]
    """Output of the programs by vehicle and name"""
    frames: dict[str, NDArray[Any]]
    """Columns of radio.parquet"""
    lateness: Lateness
    radio: RadioConfig
    """Settings of the flight's radio"""


def program(
    name: str, uav: int | str, command: Sequence[str], *, environment: Mapping[str, str] | None = None
) -> str:
    """Return the table ``[[programs]]`` of a program."""
    lines = ["", "[[programs]]", f"name = {_toml(name)}", f"uav = {_toml(uav)}"]
    lines.append(f"command = {_toml(list(command))}")
    if environment:
        pairs = ", ".join(f"{key} = {_toml(text)}" for key, text in environment.items())
        lines.append(f"environment = {{ {pairs} }}")
    return "\n".join(lines) + "\n"


def until_success(*command: object) -> list[str]:
    """Return a command that repeats another one until it succeeds, and then prints its output.

    So a client waits for its server. The status of iperf3 with ``--json`` is 0 although it has failed.
    """
    failed = """printf %s "$report" | grep -q '"error"'"""
    script = f'until report=$("$@") && ! {failed}; do sleep 0.5; done; echo "$report"'
    return ["sh", "-c", script, "sh", *map(str, command)]


def after(wall_s: float, *command: object) -> list[str]:
    """Return a command that starts another one after ``wall_s``."""
    return ["sh", "-c", f'sleep {wall_s:g}; exec "$@"', "sh", *map(str, command)]


def fly(scenario: str, *, speed: float, seed: int, course: Callable[[Swarm], object]) -> Flown:
    """Fly a scenario as ``course`` does and return the records. Raises SwarmError."""
    with tempfile.TemporaryDirectory(prefix="coflight-") as folder:
        path = Path(folder) / "programs.toml"
        path.write_text(scenario, encoding="utf-8")
        with Swarm(path, speed=speed, seed=seed) as swarm:
            course(swarm)
        swarm.summary(draw=False)
        return read(swarm.path, swarm.scenario.radio)


def run_until_report(swarm: Swarm, uav: int, name: str, *, limit_s: float) -> None:
    """Fly until a program has written its output, as iperf3 does at its end. Raises SwarmTimeoutError."""
    log = swarm.path / "logs" / f"uav-{uav}-{name}.log"
    end_s = swarm.truth.t_s + limit_s
    while not log.exists() or not log.read_bytes().rstrip().endswith(b"}"):
        if swarm.truth.t_s >= end_s:
            raise SwarmTimeoutError(f"{name} of uav {uav} has not ended within {limit_s:g} s")
        swarm.run_for(_PIECE_S)


def iperf_report(log: str) -> dict[str, Any]:
    """Return the report of an iperf3 with ``--json``. Raises SwarmError if it has failed."""
    try:
        report: dict[str, Any] = json.loads(log)
    except ValueError:
        raise SwarmError(f"iperf3: {log.strip() or 'no report'}") from None
    if not report["intervals"]:
        raise SwarmError(f"iperf3: {report.get('error', 'no intervals')}")
    return report


def read(run: Path, radio: RadioConfig) -> Flown:
    """Return the records of a run's folder."""
    logs = {}
    for path in sorted((run / "logs").glob("uav-*-*.log")):
        _, uav, name = path.stem.split("-", 2)
        logs[int(uav), name] = path.read_text(encoding="utf-8", errors="replace")
    table = pq.read_table(run / "radio.parquet")
    frames = {name: table[name].to_numpy() for name in table.column_names}
    manifest = json.loads((run / "manifest.json").read_bytes())
    details = {each["name"]: each["details"] for each in manifest["processes"]}
    sent = details["radio"]["packets"]["transmissions"]
    received = details["network"]["bridge"]["lateness"]
    late = (sent["late"] + received["late"]) / max(sent["packets"] + received["packets"], 1)
    largest_ms = max(sent["largest_ms"], received["largest_ms"])
    lateness = Lateness(late_fraction=late, mean_ms=received["mean_ms"], largest_ms=largest_ms)
    return Flown(logs, frames, lateness, radio)


def data_frames(
    frames: Mapping[str, NDArray[Any]], ip_bytes: int, *, source: int | None = None, to: int
) -> NDArray[np.bool_]:
    """Return which frames carry IP packets of a length to a vehicle, from one or from all."""
    chosen = (frames["destination"] == to) & (frames["bytes"] == ip_bytes + SNAP_AND_MAC_BYTES)
    chosen &= frames["kind"] == "data"
    if source is not None:
        chosen &= frames["source"] == source
    return np.asarray(chosen)


def _toml(value: object) -> str:
    """Return a text, number or list of texts as TOML, whose basic strings are those of JSON."""
    return json.dumps(value, ensure_ascii=False)
