"""Bad inputs of the command line: what a user may type wrongly, and what the report must contain.

    python tests/support/bad_inputs.py [WORD...]

runs all of them, or those with a word in their names, each in a new interpreter, and prints a line for each;
the exit status is 1 if one is not reported as it should be. `tests/multiprocess/test_bad_inputs.py` runs the
same list in forks of one process, in a sixth of the time.
"""

import concurrent.futures
import contextlib
import os
import re
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

_START = re.compile(r"pybullet build time|\S+: \d+ UAVs?, seed \d+, into ")
"""Lines that are no report: the library's, and the first line of a run, whose limits are checked after it."""
LIMIT_S = 120.0
"""Wall time of one command; it is reached only by a command that flies."""
Run = Callable[..., "subprocess.CompletedProcess[str]"]
"""Runs a command, as `run_anew` does."""


class BadInput(NamedTuple):
    """A command with a bad input, run in a folder of its own that `prepare` fills."""

    name: str
    arguments: tuple[str, ...]
    expected: tuple[str, ...]
    """Texts of the report: what is wrong, where, and what to do."""
    status: int = 2
    limits: tuple[tuple[int, int], ...] = ()
    """Limits of the process: resource and value"""


def prepare(folder: Path) -> None:
    """Write the files and folders that the arguments name."""
    folder.joinpath("file.txt").write_text("a file\n")
    folder.joinpath("empty.toml").write_text("")
    folder.joinpath("comment.toml").write_text("# nothing else\n")
    folder.joinpath("broken.toml").write_text("agents = = 3\n")
    folder.joinpath("binary.toml").write_bytes(bytes(range(256)))
    folder.joinpath("list.toml").write_text("agents = [1, 2]\n")
    folder.joinpath("wrong.toml").write_text("agents = 0\n[wind]\nmean_n = -1\n[radio]\nmcs = 3\n")
    folder.joinpath("vehicles.toml").write_text('agents = 2\n[autopilot]\nparams_file = "no.params"\n')
    folder.joinpath("plan.toml").write_text('agents = 1\n[autopilot]\nplan_file = "file.txt"\n')
    folder.joinpath("places.toml").write_text('agents = 1\n[formation]\nshape = "file"\nfile = "no.csv"\n')
    folder.joinpath("deck.toml").write_text(
        'agents = 1\n[antenna]\nelement_kind = "deck"\nelement_file = "file.txt"\n'
    )
    folder.joinpath("campaign.toml").write_text('scenario = "nowhere"\n[sweep]\nagents = [1]\n')
    folder.joinpath("sweep.toml").write_text('scenario = "article"\n[sweep]\n"wind.men_n" = [1, 2]\n')
    folder.joinpath("seed.toml").write_text('scenario = "article"\nseed = 3\n')
    folder.joinpath("latin.toml").write_bytes('name = "Z\xfcrich"\n'.encode("latin-1"))
    folder.joinpath("a-folder.toml").mkdir()
    run = folder / "run"
    run.mkdir()
    run.joinpath("manifest.json").write_text("{}")
    others = folder / "others"
    others.mkdir()
    others.joinpath("thesis.tex").write_text("years of work\n")
    folder.joinpath("loop.toml").symlink_to("loop.toml")
    folder.joinpath("settings.json").write_text('{"mcs": 3}')


def fly(name: str, *arguments: str, expected: tuple[str, ...], status: int = 2) -> BadInput:
    """Return a bad input of ``coflight fly article``."""
    return BadInput(f"fly: {name}", ("fly", "article", *arguments), expected, status)


def scenario(file: str, *expected: str) -> BadInput:
    """Return a scenario file that ``coflight fly`` refuses."""
    return BadInput(f"scenario: {file}", ("fly", file), (Path(file).name, *expected))


def setting(assignment: str, *expected: str) -> BadInput:
    """Return a setting that ``coflight fly article`` refuses."""
    return BadInput(f"set: {assignment}", ("fly", "article", "--set", assignment), expected)


BAD_INPUTS = (
    BadInput("an unknown command", ("flight",), ("there is no command 'flight'", "fly, hold")),
    BadInput("an unknown study", ("study", "weather"), ("there is no command 'weather'", "codesign")),
    BadInput("fly: no scenario", ("fly",), ("SCENARIO",)),
    BadInput("fly: an unknown option", ("fly", "article", "--sped", "2"), ("--sped", "--speed")),
    fly("two scenarios", "swarm64", expected=("swarm64",)),
    fly("no seed", "--seed", "one", expected=("--seed", "integer")),
    fly("a negative seed", "--seed", "-1", expected=("run.seed", ">= 0")),
    fly("no vehicles", "--agents", "0", expected=("agents", ">= 1")),
    fly("many vehicles", "--agents", "100000", expected=("agents", "<=")),
    fly("a negative duration", "--duration", "-1", expected=("run.duration_s", ">= 0")),
    fly("a duration without end", "--duration", "inf", expected=("run.duration_s", "<=")),
    fly("a duration that is no number", "--duration", "nan", expected=("run.duration_s",)),
    fly("a speed of 0", "--speed", "0", expected=("'0'", "above 0", "'max'")),
    fly("a speed in words", "--speed", "fast", expected=("'fast'", "above 0", "'max'")),
    fly("a speed of inf", "--speed", "inf", expected=("'inf'", "'max'")),
    fly("a port offset of words", "--port-offset", "high", expected=("--port-offset", "auto")),
    fly("a port offset beyond all ports", "--port-offset", "60000", expected=("port", "65535")),
    fly("a negative port offset", "--port-offset", "-60000", expected=("port",)),
    fly("a hold in one process", "--hold", "--one-process", expected=("--hold", "one process")),
    fly("a profile of one process", "--profile", "--one-process", expected=("--profile",)),
    fly("a folder without a name", "--out", "", expected=("--out",)),
    fly("a folder of something else", "--out", "others", expected=("others", "thesis.tex", "--out")),
    fly("the working folder", "--out", ".", expected=("--out",)),
    fly("a file as folder", "--out", "file.txt", expected=("file.txt", "--out")),
    fly("a folder below a file", "--out", "file.txt/run", expected=("file.txt", "--out")),
    fly("a folder of a long name", "--out", "n" * 300, expected=("name", "--out")),
    fly("a folder in /proc", "--out", "/proc/coflight", expected=("/proc/coflight", "--out")),
    fly("a setting without a value", "--set", "wind", expected=("PATH=VALUE",)),
    scenario("nowhere", "there is no such file", "article"),
    scenario("nowhere/article.toml", "there is no such file"),
    scenario("empty.toml", "it has no settings"),
    scenario("comment.toml", "it has no settings"),
    scenario("broken.toml", "not TOML", "line 1"),
    scenario("binary.toml", "it is not text"),
    scenario("latin.toml", "it is not text (UTF-8)"),
    scenario("a-folder.toml", "it is a folder"),
    scenario("loop.toml", "symbolic link"),
    scenario("list.toml", "agents: expected `int`, got `array`"),
    scenario("wrong.toml", "3 fields are wrong", "agents", "wind.mean_n", "broadcast_mode"),
    scenario("vehicles.toml", "autopilot.params_file", "no.params", "there is no such file"),
    scenario("plan.toml", "autopilot.plan_file", "file.txt"),
    scenario("places.toml", "formation.file", "no.csv", "there is no such file"),
    scenario("deck.toml", "antenna.element_file", "file.txt"),
    scenario("/dev/zero", "larger than"),
    scenario("file.txt", "not TOML"),
    BadInput("fly: a campaign", ("fly", "campaigns/wind"), ("it is a campaign", "coflight campaign")),
    setting("wind.mean_n=-1", "wind.mean_n", ">= 0"),
    setting("wind.mean_n=strong", "wind.mean_n", "expected `float`", "got `str`"),
    setting("wind.mean=3", "unknown key `mean`", "`wind.mean_n`"),
    setting("wnd.mean_n=3", "unknown key `wnd`", "`wind`"),
    setting("radio.mcs=7", "unknown key `mcs`", "`radio.broadcast_mode`"),
    setting("radio.broadcast_mode=fast", "radio.broadcast_mode", "ofdm6", "vht_mcs9"),
    setting("radio.bandwidth_mhz=30", "radio.bandwidth_mhz", "20, 40, 80"),
    setting("onboard.ranging=often", "onboard.ranging", "scheduled"),
    setting("run.epoch_utc=yesterday", "run.epoch_utc"),
    setting("run.step_us=3999", "run.step_us"),
    setting("ports.host=example.org", "ports: host", "127.0.0.1"),
    setting("agents.x=3", "agents is a value, not a table"),
    setting("faults.0.uav=1", "faults has no entry 0"),
    setting('faults=[{kind="gps_los", uav=0}]', "faults[0].kind", "gps_loss"),
    setting("sensors.gps.rate_hz=0", "sensors.gps.rate_hz", ">= 0.1"),
    setting("formation.spacing=3", "formation", "did you mean"),
    setting("antenna.wavelength_m=9000", "formation", "do not fit", "antenna.wavelength_m"),
    setting('formation.points_m=[[1,2,"x"],[1,2,"y"]]', "formation.points_m[0][2]: expected `float`"),
    setting('radio.interferers=[{pos_ned_m=[1,2,"x"]},{pos_ned_m=[1,2,"y"]}]', "[0].pos_ned_m[2]", "[1].pos"),
    setting("autopilot.params.MPC_XY_P=fast", "autopilot.params.MPC_XY_P", "expected `float`"),
    setting("autopilot.params.NO_SUCH=1", "NO_SUCH"),
    setting("autopilot.params.MPC_XY_P=99", "MPC_XY_P"),
    BadInput("report: no folder", ("report", "nowhere"), ("nowhere", "there is no such folder")),
    BadInput("report: a file", ("report", "file.txt"), ("file.txt", "no run")),
    BadInput("report: a folder of something else", ("report", "others"), ("others", "no run")),
    BadInput("report: a broken run", ("report", "run"), ("run",)),
    BadInput("export: no run", ("export", "nowhere", "--time", "4"), ("nowhere", "no run")),
    BadInput("export: no time", ("export", "run"), ("--time",)),
    BadInput(
        "campaign: no file",
        ("campaign", "nowhere.toml"),
        ("nowhere.toml", "there is no such file", "campaigns/"),
    ),
    BadInput("campaign: a folder", ("campaign", "a-folder.toml"), ("a-folder.toml", "it is a folder")),
    BadInput("campaign: not TOML", ("campaign", "broken.toml"), ("broken.toml", "not TOML")),
    BadInput("campaign: binary", ("campaign", "binary.toml"), ("binary.toml", "it is not text")),
    BadInput("campaign: a scenario", ("campaign", "list.toml"), ("names no scenario", "coflight fly")),
    BadInput("campaign: an unknown key", ("campaign", "seed.toml"), ("unknown key `seed`", "`seeds`")),
    BadInput("campaign: no scenario", ("campaign", "campaign.toml"), ("nowhere", "there is no such file")),
    BadInput("campaign: an unknown field", ("campaign", "sweep.toml"), ("wind", "men_n", "wind.mean_n")),
    BadInput(
        "campaign: a scheduler without a port",
        ("campaign", "sweep.toml", "--scheduler", "localhost"),
        ("--scheduler", "tls://"),
    ),
    BadInput(
        "campaign: a scheduler without encryption",
        ("campaign", "sweep.toml", "--scheduler", "tcp://localhost:8786"),
        ("--scheduler tcp://localhost:8786", "run code", "tls://", "--unencrypted"),
    ),
    BadInput(
        "campaign: a local cluster without encryption",
        ("campaign", "sweep.toml", "--unencrypted"),
        ("--unencrypted", "--scheduler tcp://"),
    ),
    BadInput(
        "radio: an unknown mode", ("radio", "per", "--mode", "fast", "--snr-db", "3"), ("fast", "ofdm6")
    ),
    BadInput("radio: a wrong width", ("radio", "ftm", "--width", "30"), ("30", "20, 40")),
    BadInput("radio: no stations", ("radio", "saturation", "--stations", "0"), ("--stations",)),
    BadInput("radio: a wrong rate", ("radio", "saturation", "--rate-mbps", "7"), ("7", "54")),
    BadInput(
        "radio: an unknown setting",
        ("radio", "serve", "--settings", "settings.json"),
        ("settings.json", "mcs"),
    ),
    BadInput(
        "radio: a figure below a file",
        ("radio", "ftm-mesh", "--stations", "2", "--seconds", "0.2", "--figure", "file.txt/a.png"),
        ("file.txt",),
    ),
    BadInput("antenna: a wrong formation", ("antenna", "pattern", "--formation", "4"), ("4", "4x2")),
    BadInput("antenna: no wavelength", ("antenna", "pattern", "--wavelength", "0"), ("wavelength",)),
    BadInput("antenna: no deck", ("antenna", "pattern", "--deck", "no.nec"), ("no.nec",)),
    BadInput(
        "antenna: a figure below a file",
        ("antenna", "pattern", "--grid", "30", "--figure", "file.txt/a.png"),
        ("file.txt",),
    ),
    BadInput("bench: no numbers", ("bench", "--agents", "few"), ("--agents", "few", "1,8,16")),
    BadInput("bench: no scenario", ("bench", "--scenario", "nowhere.toml"), ("nowhere.toml",)),
    BadInput(
        "study: a part that is none", ("study", "radio", "--only", "weather"), ("weather", "saturation")
    ),
    BadInput(
        "fly: few descriptors",
        ("fly", "swarm64"),
        ("file descriptors", "ulimit"),
        limits=((resource.RLIMIT_NOFILE, 100),),
    ),
)


@contextlib.contextmanager
def prepared_folder() -> Iterator[Path]:
    """Yield a folder with the files of `prepare`, which is deleted afterwards."""
    with tempfile.TemporaryDirectory(prefix="coflight-bad-") as folder:
        prepare(Path(folder))
        yield Path(folder)


def contents(folder: Path) -> dict[str, bytes | None]:
    """Return all files by path with their contents; None for folders and links."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() and not path.is_symlink() else None
        for path in folder.rglob("*")
    }


def run_anew(
    arguments: Sequence[str], folder: Path, *, environment: Mapping[str, str],
    limits: Sequence[tuple[int, int]], limit_s: float,
) -> "subprocess.CompletedProcess[str]":  # fmt: skip
    """Do the same as `forked_command.run` in a new interpreter."""

    def limit() -> None:
        for kind, value in limits:
            resource.setrlimit(kind, (value, value))

    return subprocess.run(
        [sys.executable, "-m", "coflight", *arguments], cwd=folder, env=os.environ | environment,
        stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=limit_s, check=False,
        preexec_fn=limit if limits else None,
    )  # fmt: skip


def faults_of(bad: BadInput, run: Run = run_anew) -> list[str]:
    """Run a bad input; returns what is wrong with its report, a line each."""
    with prepared_folder() as folder:
        before = contents(folder)
        try:
            done = run(
                bad.arguments, folder, environment={"COLUMNS": "200", "TERM": "dumb"}, limits=bad.limits,
                limit_s=LIMIT_S,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return [f"not refused within {LIMIT_S:g} s"]
        after = contents(folder)
    report = done.stderr
    lines = [line for line in report.splitlines() if line and not _START.match(line)]
    found: list[str] = []
    if done.returncode != bad.status:
        found.append(f"exit status {done.returncode}, expected {bad.status}")
    if "Traceback" in report or "Errno" in report:
        found.append("a traceback or the number of an error")
    if done.stdout:
        found.append(f"output on stdout: {done.stdout[:80]!r}")
    found += [f"the report has no {text!r}" for text in bad.expected if text.lower() not in report.lower()]
    if not lines:
        found.append("no report")
    elif [line for line in lines[1:] if not line.startswith("  ")]:
        found.append(f"{len(lines)} lines that are not of one report")
    found += [f"written: {name}" for name in sorted(after.keys() - before.keys())]
    found += [f"changed: {name}" for name in before if before[name] != after.get(name)]
    return [*found, *(f"report: {line}" for line in lines)] if found else []


def main(words: list[str]) -> int:
    """Run the list; returns the exit status."""
    chosen = [bad for bad in BAD_INPUTS if not words or any(word in bad.name for word in words)]
    failed = 0
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        for bad, found in zip(chosen, pool.map(faults_of, chosen), strict=True):
            failed += bool(found)
            sys.stdout.write(f"{'FAULT' if found else 'fine '}  {bad.name}\n")
            sys.stdout.writelines(f"         {line}\n" for line in found)
    sys.stdout.write(f"{len(chosen)} bad inputs, {failed} not reported as they should be\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
