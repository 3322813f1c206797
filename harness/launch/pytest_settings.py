"""Options of the `swarm` fixture: from pytest's command line, else from its ini file."""

import math
from pathlib import Path
from typing import NamedTuple

import pytest

WALL_LIMIT_S = 120.0
"""Default wall time of a swarm of the fixture, without the compilation of kernels."""
FOLDER = ".coflight"
"""Default folder of kept runs below pytest's root directory."""
KEEP, PROCESSES = ("failed", "all"), ("many", "one")
"""Choices; the first one is the default."""

_OPTIONS = {
    "keep": ("failed|all", "keep the run folders of failed tests (default) or of all tests"),
    "out": ("DIR", f"keep run folders in this folder (default: {FOLDER} in the root directory)"),
    "wall_limit": ("SECONDS", f"wall time after which a swarm fails its test (default: {WALL_LIMIT_S:g})"),
    "processes": (
        "one|many",
        "fly a swarm in many processes (default), or in pytest's own without connections from outside",
    ),
}
"""Metavariable and help of each option."""


class Settings(NamedTuple):
    """Options of all swarms of a session."""

    keep_all: bool
    out: Path
    """Folder in which swarms fly; folders that are not kept are removed from it."""
    wall_limit_s: float
    one_process: bool


def add_options(parser: pytest.Parser) -> None:
    """Declare the options: ``--coflight-keep`` on the command line, ``coflight_keep`` in ini files ..."""
    group = parser.getgroup("coflight", "swarms of UAVs (coflight)")
    for name, (metavar, text) in _OPTIONS.items():
        group.addoption(_flag(name), metavar=metavar, help=text)
        parser.addini(f"coflight_{name}", f"{text}, {metavar}", default="")


def read(config: pytest.Config) -> Settings:
    """Return the options; the command line has precedence. Raises UsageError for an invalid value."""
    return Settings(
        keep_all=_choice(config, "keep", KEEP) == "all",
        out=_out(config),
        wall_limit_s=_wall_limit_s(config),
        one_process=_choice(config, "processes", PROCESSES) == "one",
    )


def _flag(name: str) -> str:
    return f"--coflight-{name.replace('_', '-')}"


def _given(config: pytest.Config, name: str) -> tuple[str | None, str]:
    """Return the value of an option, None without any, and its source."""
    text: str | None = config.getoption(f"coflight_{name}")
    if text is not None:
        return text, _flag(name)
    source = "" if config.inipath is None else f"{config.inipath.name}: "
    return str(config.getini(f"coflight_{name}")) or None, f"{source}coflight_{name}"


def _choice(config: pytest.Config, name: str, choices: tuple[str, ...]) -> str:
    text, source = _given(config, name)
    if text is None:
        return choices[0]
    if text not in choices:
        raise pytest.UsageError(f"{source}: {text!r}: expected {' or '.join(choices)}")
    return text


def _wall_limit_s(config: pytest.Config) -> float:
    text, source = _given(config, "wall_limit")
    if text is None:
        return WALL_LIMIT_S
    try:
        wall_limit_s = float(text)
    except ValueError:
        wall_limit_s = math.nan
    if not 0.0 < wall_limit_s < math.inf:
        raise pytest.UsageError(f"{source}: {text!r}: expected a number of seconds above 0")
    return wall_limit_s


def _out(config: pytest.Config) -> Path:
    """Return the folder: of the command line below the working folder, of an ini file below the root."""
    text, source = _given(config, "out")
    on_command_line = config.getoption("coflight_out") is not None
    base = config.invocation_params.dir if on_command_line else config.rootpath
    out = base / (FOLDER if text is None else text)
    if text == "" or (out.exists() and not out.is_dir()):
        raise pytest.UsageError(f"{source}: {text!r}: expected a folder, which need not exist")
    return out


def worker(config: pytest.Config) -> str | None:
    """Return the name of this worker of pytest-xdist; None: this is not a worker."""
    name: str | None = getattr(config, "workerinput", {}).get("workerid")
    return name
