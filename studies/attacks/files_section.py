"""Another user at the files, folders, sockets and processes of a run and of a campaign."""

import subprocess
import sys
import tempfile
import time
from collections import Counter
from functools import partial
from pathlib import Path

import psutil
from msgspec import Struct

from foundation.kernels import cache_folder
from harness.launch.swarm import Swarm
from harness.scenario.packaged import find
from studies.attacks.comparison import AGENTS, ROW, SEED
from studies.attacks.launch import AttackProcess, can_be_another
from studies.attacks.plan import AttacksPlan
from studies.attacks.sockets import OpenSockets, listening_ports
from studies.attacks.tasks import OpenEverything, Report, RunOnCluster, Task
from studies.common.report import Check, ReportTable, Section, filled
from studies.common.runner import Job, Results

_GROUP = "files"
_OF_PROCESSES = ("mem", "environ", "maps", "fd", "fd/0", "fd/1", "cwd/", "root/")
MOST_LISTED = 20
FLOWN_S = 2.0
CAMPAIGN_LIMIT_S = 300.0
CAMPAIGN = """
scenario = "article"
seeds = 1
[set]
agents = 2
formation.columns = 2
formation.rows = 1
formation.height_m = 2
onboard.localisation = "gps"
antenna.snapshot_rate_hz = 4
run.duration_s = 20.0
"""


class CampaignFailed(Exception):
    """The campaign has failed without an attack; the text says how."""


class Tried(Struct, frozen=True, kw_only=True):
    """Attempts of another user in one place; None: the study may not start programs as another user."""

    place: str
    report: Report | None


def jobs(plan: AttacksPlan) -> dict[str, list[Job]]:  # noqa: ARG001  the same for all plans
    """Return the run and the campaign."""
    return {_GROUP: [partial(try_run), partial(try_campaign)]}


def try_run() -> Tried:
    """Attack a run in a folder that all may enter, while it flies and after it. Raises SwarmError."""
    if not can_be_another():
        return Tried(place="run", report=None)
    with tempfile.TemporaryDirectory(prefix="coflight-open-") as name:
        folder = Path(name)
        folder.chmod(0o755)
        with Swarm(
            find("article"),
            agents=AGENTS,
            seed=SEED,
            overrides=[*ROW, "radio.guests=[{name='ground', pos_ned_m=[0.0, -20.0, -1.5]}]"],
            out=folder / "run",
        ) as swarm:
            swarm.run(until_s=FLOWN_S)
            named = OpenSockets(swarm).named
            beside = {Path(path).parent for path in named}
            flying = _tried(
                [folder / "run", *beside, cache_folder.folder()], sockets=named, pids=[*swarm.pids.values()]
            )
        swarm.summary(draw=False)
        after = _tried([folder / "run"], sockets=[], pids=[])
    return Tried(place="run", report=_together([flying, after]))


def _tried(roots: list[Path], *, sockets: list[str], pids: list[int]) -> Report:
    """Return what another user can do with everything below the roots, and with processes."""
    paths = _below(roots)
    paths += [f"/proc/{pid}/{name}" for pid in pids for name in _OF_PROCESSES]
    paths += [
        each.path for pid in pids for each in psutil.Process(pid).open_files() if _is_private(each.path)
    ]
    return _report(OpenEverything(paths=paths, sockets=sockets, pids=pids))


def _is_private(path: str) -> bool:
    """Whether an open file is the run's, not one of the installation or a device."""
    return Path(path).is_relative_to(tempfile.gettempdir())


def try_campaign() -> Tried:
    """Attack a campaign that flies, and its store. Raises CampaignFailed."""
    if not can_be_another():
        return Tried(place="campaign", report=None)
    with tempfile.TemporaryDirectory(prefix="coflight-open-") as name:
        folder = Path(name)
        folder.chmod(0o755)
        (folder / "campaign.toml").write_text(CAMPAIGN, encoding="utf-8")
        command = [
            sys.executable,
            "-m",
            "coflight",
            "campaign",
            "campaign.toml",
            "--out",
            "out",
            "--workers=1",
        ]
        with subprocess.Popen(
            command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        ) as process:
            try:
                _await_flight(process, folder / "out")
                ports = listening_ports(process.pid)
                pids = [each.pid for each in psutil.Process(process.pid).children(recursive=True)]
                reports = [
                    _report(OpenEverything(paths=_below([folder / "out"]), sockets=[], pids=pids)),
                    _report(RunOnCluster(ports=ports)),
                ]
                messages = process.communicate(timeout=CAMPAIGN_LIMIT_S)[1]
            finally:
                process.terminate()
        if process.returncode != 0:
            raise CampaignFailed(messages.decode(errors="replace").strip()[-200:])
        reports.append(_report(OpenEverything(paths=_below([folder / "out"]), sockets=[], pids=[])))
    return Tried(place="campaign", report=_together(reports))


def _await_flight(process: "subprocess.Popen[bytes]", out: Path) -> None:
    """Wait until a run of the campaign flies. Raises CampaignFailed."""
    wall_end_s = time.monotonic() + CAMPAIGN_LIMIT_S
    while not list((out / "flying").rglob("truth.bin")):
        if process.poll() is not None or time.monotonic() > wall_end_s:
            raise CampaignFailed(f"the campaign does not fly within {CAMPAIGN_LIMIT_S:g} s")
        time.sleep(0.05)


def _report(task: Task) -> Report:
    """Return what another user has done."""
    with AttackProcess(task, is_other=True) as process:
        return process.report()


def _together(reports: list[Report]) -> Report:
    """Return the sums and all findings."""
    counts = Counter[str]()
    for each in reports:
        counts.update(each.counts)
    return Report(counts=dict(counts), found=[text for each in reports for text in each.found])


def _below(roots: list[Path]) -> list[str]:
    """Return the folders with all that is below them."""
    return [str(path) for root in roots for path in (root, *root.rglob("*"))]


def judge(plan: AttacksPlan, results: Results) -> Section:  # noqa: ARG001  the same for all plans
    """Require that nothing succeeds."""
    tried = [each for each in results[_GROUP] if each.report is not None]
    found = [text for each in tried for text in each.report.found]
    skipped = "" if tried else " Nothing was tried: only root can start programs as another user."
    return Section(
        title="Files, processes and campaigns",
        conditions=filled(
            "Another user tries to read and write every file and folder of a run in flight and after it, "
            "those beside the radio's socket, the cache of compiled kernels, and a campaign's store; to "
            "connect to the named sockets; to open the memory, settings and descriptors of the processes and "
            "to signal them; and to run functions on scheduler, worker and nanny of the campaign's cluster. "
            f"The folder that holds the run can be entered by all.{skipped}"
        )
        + "\n",
        checks=tuple(
            Check(f"{each.place}: attempts that succeed", len(each.report.found), at_most=0.0)
            for each in tried
        ),
        tables=(
            ReportTable(
                caption="Attempts.",
                columns=("place", "attempts", "succeed"),
                rows=tuple(
                    (
                        each.place,
                        ", ".join(f"{count} {name}" for name, count in each.report.counts.items()),
                        str(len(each.report.found)),
                    )
                    for each in tried
                ),
            ),
            *(
                ReportTable(
                    caption="What succeeds.",
                    columns=("what",),
                    rows=tuple((text,) for text in found[:MOST_LISTED]),
                )
                for _ in found[:1]
            ),
        ),
    )
