"""A wrong command line is one line on stderr and status 2."""

from pathlib import Path

import pytest

from foundation.exit_status import BAD_INPUT, FINE
from harness.cli.fly import main


@pytest.fixture
def scenario_file(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text("agents = 2\n[wind]\nmean_n = 1.0\n")
    return path


def error_line(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> str:
    """Run an invalid command line; returns its only line on stderr."""
    assert main(arguments) == BAD_INPUT
    streams = capsys.readouterr()
    assert streams.out == ""
    lines = streams.err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("coflight: ")
    return lines[0].removeprefix("coflight: ")


def test_missing_file_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    line = error_line(capsys, ["no/such.toml"])
    assert line.startswith("no/such.toml: there is no such file; scenarios by name: article, ")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--set", "wind.men_n=2"], ["wind", "men_n"]),
        (["--set", "wind.mean_n=strong"], ["wind.mean_n"]),
        (["--set", "wind"], ["--set wind", "PATH=VALUE"]),
        (["--agents", "0"], ["agents"]),
        (["--agents", "many"], ["--agents"]),
        (["--duration", "-1"], ["run.duration_s"]),
        (["--seed", "-1"], ["run.seed"]),
        (["--speed", "fast"], ["'fast'", "'max'"]),
        (["--speed", "0"], ["'0'", "'max'"]),
        (["--speed", "inf"], ["'inf'", "'max'"]),
        (["--port-offset", "61000"], ["offset of 61000", "65535"]),
        (["--port-offset", "-1"], ["offset of -1", "expected 0 to "]),
        (["--port-offset", "many"], ["'many'", "'auto'"]),
        (["--out", ""], ["--out", "empty"]),
        (["--hold", "--one-process"], ["--hold", "one process"]),
        (["--profile", "--one-process"], ["--profile", "--one-process"]),
        (["--port-offset", "0", "--one-process"], ["--port-offset", "--one-process"]),
        (["--no-such-option"], ["--no-such-option"]),
    ],
)
def test_bad_input_is_one_line_that_names_it(
    capsys: pytest.CaptureFixture[str], scenario_file: Path, arguments: list[str], words: list[str]
) -> None:
    line = error_line(capsys, [str(scenario_file), *arguments])
    for word in words:
        assert word in line


def test_debug_shows_the_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["no/such.toml", "--debug"]) == BAD_INPUT
    assert "Traceback" in capsys.readouterr().err


def test_help_is_no_failure(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == FINE
    assert "--port-offset" in capsys.readouterr().out
