"""The ``coflight`` command: dispatch, help, start-up; and the public names of the package."""

import subprocess
import sys
from importlib import import_module

import pytest

import coflight
from coflight.command import COMMANDS, STUDIES, Command, main
from foundation.exit_status import BAD_INPUT
from harness.scenario import packaged

HEAVY = ("numba", "numpy", "typer", "rich", "msgspec", "matplotlib", "pybullet", "zenoh")


@pytest.mark.parametrize("command", [*COMMANDS.values(), *STUDIES.values()], ids=lambda each: each.summary)
def test_every_command_leads_to_something_callable(command: Command) -> None:
    assert callable(getattr(import_module(command.module), command.function))


@pytest.mark.parametrize("arguments", [[], ["--help"], ["-h"], ["help"]])
def test_help_lists_every_command(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 0
    listed = {line.split()[0] for line in capsys.readouterr().out.splitlines() if line.startswith("  ")}
    assert listed == set(COMMANDS)


def test_help_of_studies_lists_every_study(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study"]) == 0
    listed = {line.split()[0] for line in capsys.readouterr().out.splitlines() if line.startswith("  ")}
    assert listed == set(STUDIES)


@pytest.mark.parametrize(
    ("arguments", "program"),
    [
        (["flee"], "coflight"),
        (["study", "x"], "coflight study"),
    ],
)
def test_an_unknown_command_is_one_line_that_lists_the_others(
    arguments: list[str], program: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"{program}: there is no command {arguments[-1]!r}; expected one of ")


def test_help_loads_no_heavy_library() -> None:
    program = (
        "import sys; from coflight.command import main; main(['--help']);"
        f"print(sorted({set(HEAVY)!r} & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_fly_refuses_an_unknown_scenario_and_names_those_there_are(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["fly", "artikel"]) == BAD_INPUT
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith("coflight: artikel: there is no such file; scenarios by name: article, ")


def test_scenarios_lists_the_files_of_the_folder(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenarios"]) == 0
    names = capsys.readouterr().out.split()
    assert len(names) == len(list(packaged.FOLDER.rglob("*.toml")))
    assert {"article", "campaigns/wind"} <= set(names)


def test_every_public_name_is_loaded_on_first_use() -> None:
    for name in coflight.__all__:
        assert getattr(coflight, name).__name__ in {name, "load"}
    assert dir(coflight) == sorted(coflight.__all__)
    assert not hasattr(coflight, "Swarn")
