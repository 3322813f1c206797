"""Options of the pytest plugin: run folders that are kept, wall limit, one or many processes, bad values."""

import re
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from paths import SUPPORT

import harness.launch.one_process  # loaded before the inner sessions, which restore the loaded modules
import harness.launch.processes
import harness.report.report
from harness.cli import report
from harness.launch import kernel_cache

pytest_plugins = ["pytester"]
pytestmark = pytest.mark.multiprocess

Run = Callable[..., pytest.RunResult]

CUT = """
    flight = swarm("small.toml")
    flight.run_until_formed(timeout_s=10)
    flight.cut_channel()
    flight.run_for(0.1)
"""
SETTINGS = """
def test_settings(coflight_settings):
    print(f"{coflight_settings}")
    assert False
"""


@pytest.fixture
def run(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Return a function that runs tests in this process, with stand-ins for the processes of swarms."""

    def stand_in(module: str, *arguments: str) -> list[str]:
        return [sys.executable, str(SUPPORT / "supervisor_stand_ins.py"), module, *arguments]

    monkeypatch.setattr(harness.launch.processes, "bound_module", stand_in)
    pytester.makefile(".toml", small="agents = 2\n")

    def run(code: str, *arguments: str, ini: str = "") -> pytest.RunResult:
        pytester.makeini(f"[pytest]\nfilterwarnings = error\n{ini}")
        pytester.makepyfile(test_user=code)
        return pytester.runpytest_inprocess("-p", "no:cacheprovider", *arguments)

    return run


def kept(folder: Path) -> list[str]:
    """Names of run folders without their hashes."""
    return sorted(re.sub(r"-[0-9a-f]{8}", "", path.name) for path in folder.glob("*/") if path.is_dir())


def test_a_failed_test_keeps_its_run_names_it_and_shows_its_events(
    run: Run, pytester: pytest.Pytester
) -> None:
    done = run(f"def test_fine(swarm):{CUT}\ndef test_cut(swarm):{CUT}    assert False\n")
    done.assert_outcomes(passed=1, failed=1)
    assert kept(pytester.path / ".coflight") == ["test_user-test_cut"]
    (folder,) = pytester.path.glob(".coflight/test_user-*")
    done.stdout.fnmatch_lines(
        [
            f"run folder: .coflight/{folder.name}",
            "simulated time: 3.100 s",
            "events:",
            "  t = 3.00 s: formation reached",
            "*log of physics*",
            "*coflight run folders*",
            f"test_user.py::test_cut: *.coflight/{folder.name}",
        ]
    )
    assert "extra_attenuation_db" in (folder / "logs" / "physics.log").read_text()
    assert not (folder.parent / ".claims").exists()
    assert "*" in (pytester.path / ".coflight" / ".gitignore").read_text().splitlines()


def test_an_error_of_the_start_is_shown_at_the_line_of_the_test(run: Run, pytester: pytest.Pytester) -> None:
    limit = "swarm('small.toml', wall_limit_s=0.05)"
    done = run(
        f"def test_key(swarm):\n    swarm('small.toml', agents=0)\ndef test_limit(swarm):\n    {limit}\n"
    )
    done.assert_outcomes(failed=2)
    done.stdout.fnmatch_lines(
        ["E *ScenarioError: *small.toml: agents: expected `int` >= 1", "test_user.py:2: ScenarioError"]
    )
    done.stdout.fnmatch_lines(["E *SwarmTimeoutError: the wall time of 0.05 s is over", "events:", "  none"])
    assert "pytest_flights.py" not in done.stdout.str()
    (folder,) = pytester.path.glob(".coflight/test_user-test_limit*")
    assert report.main([str(folder)]) == report.BAD_INPUT


def test_nothing_is_left_when_all_pass_also_of_an_earlier_failure(
    run: Run, pytester: pytest.Pytester
) -> None:
    code = "def test_once(swarm):\n    swarm('small.toml')\n    assert {}\n"
    run(code.format("False")).assert_outcomes(failed=1)
    assert kept(pytester.path / ".coflight") == ["test_user-test_once"]
    done = run(code.format("True"))
    done.assert_outcomes(passed=1)
    assert not (pytester.path / ".coflight").exists()
    done.stdout.no_fnmatch_line("*coflight run folders*")


def test_each_swarm_of_each_parameter_has_a_folder(run: Run, pytester: pytest.Pytester) -> None:
    run(
        """
        import pytest

        @pytest.mark.parametrize("place", ["a/b", "a-b"])
        def test_two(swarm, place):
            assert swarm("small.toml").path != swarm("small.toml").path
            assert False
        """
    ).assert_outcomes(failed=2)
    names = kept(pytester.path / ".coflight")
    assert names == ["test_user-test_two-a-b"] * 2 + ["test_user-test_two-a-b-2"] * 2


def test_a_named_folder_is_shown_and_left_to_the_test(run: Run, pytester: pytest.Pytester) -> None:
    done = run("def test_named(swarm):\n    swarm('small.toml', out='mine')\n    assert False\n")
    done.stdout.fnmatch_lines(["run folder: mine", "test_user.py::test_named: *mine"])
    assert (pytester.path / "mine" / "config").exists()
    assert not (pytester.path / ".coflight").exists()


def test_expected_failures_keep_nothing(run: Run, pytester: pytest.Pytester) -> None:
    done = run(
        "import pytest\n\n@pytest.mark.xfail\ndef test_xfail(swarm):\n"
        "    swarm('small.toml')\n    assert False\n\ndef test_skip(swarm):\n"
        "    swarm('small.toml')\n    pytest.skip()\n"
    )
    done.assert_outcomes(xfailed=1, skipped=1)
    assert not (pytester.path / ".coflight").exists()


@pytest.mark.parametrize(
    ("arguments", "ini", "names"),
    [
        ((), "coflight_keep = all", ["test_user-test_fine"]),
        (("--coflight-keep", "all"), "coflight_keep = failed", ["test_user-test_fine"]),
        (("--coflight-keep=failed",), "coflight_keep = all", []),
    ],
)
def test_keep(
    run: Run, pytester: pytest.Pytester, arguments: tuple[str, ...], ini: str, names: list[str]
) -> None:
    run("def test_fine(swarm):\n    swarm('small.toml')\n", *arguments, ini=ini).assert_outcomes(passed=1)
    assert kept(pytester.path / ".coflight") == names


def test_out_of_ini_is_below_the_root_and_of_the_command_line_below_the_working_folder(
    run: Run, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = "def test_fails(swarm):\n    swarm('small.toml')\n    assert False\n"
    below = pytester.mkdir("below")
    monkeypatch.chdir(below)
    done = run(code, "--rootdir", "..", "..", ini="coflight_out = of-ini")
    assert kept(pytester.path / "of-ini") == ["test_user-test_fails"]
    done.stdout.fnmatch_lines([f"run folder: {pytester.path}/of-ini/test_user-*"])
    run(code, "--rootdir", "..", "--coflight-out", "named/deep", "..", ini="coflight_out = other")
    assert kept(below / "named" / "deep") == ["test_user-test_fails"]
    assert not (pytester.path / "other").exists()


def test_a_folder_that_cannot_be_made_is_an_error_of_one_line(run: Run, pytester: pytest.Pytester) -> None:
    (pytester.path / "file").touch()
    done = run("def test_any(swarm):\n    swarm('small.toml')\n", "--coflight-out", "file/runs")
    done.stdout.fnmatch_lines(
        ["E*SetupError: *file/runs: no folder for a run: Not a directory (--coflight-out*"]
    )


@pytest.mark.parametrize(
    ("arguments", "ini", "wall_limit_s"),
    [
        ((), "", 120.0),
        ((), "coflight_wall_limit = 400", 400.0),
        (("--coflight-wall-limit", "7.5"), "coflight_wall_limit = 400", 7.5),
    ],
)
def test_wall_limit(run: Run, arguments: tuple[str, ...], ini: str, wall_limit_s: float) -> None:
    done = run(SETTINGS, *arguments, ini=ini)
    done.stdout.fnmatch_lines([f"Settings(*wall_limit_s={wall_limit_s}*"])


def test_wall_limit_ends_a_swarm_unless_it_has_its_own(run: Run) -> None:
    done = run(
        """
        def test_own(swarm):
            swarm("small.toml", wall_limit_s=60).run_for(1.0)

        def test_long(swarm):
            swarm("small.toml").run_until(lambda _: False, timeout_s=1e9)
        """,
        ini="coflight_wall_limit = 0.001",
    )
    done.assert_outcomes(passed=1, failed=1)
    done.stdout.fnmatch_lines(["*the wall time of 0.001 s is over"])


def test_options_of_pyproject(pytester: pytest.Pytester) -> None:
    pytester.makepyprojecttoml(
        '[tool.pytest.ini_options]\ncoflight_keep = "all"\ncoflight_wall_limit = 300\ncoflight_out = "kept"\n'
    )
    pytester.makepyfile(test_user=SETTINGS)
    done = pytester.runpytest_inprocess("-p", "no:cacheprovider", "--coflight-processes", "one")
    out = pytester.path / "kept"
    done.stdout.fnmatch_lines([f"Settings(keep_all=True, out=*{out}*, wall_limit_s=300.0, one_process=True)"])


@pytest.mark.parametrize(
    ("arguments", "ini", "line"),
    [
        (("--coflight-keep", "some"), "", "--coflight-keep: 'some': expected failed or all"),
        ((), "coflight_keep = none", "tox.ini: coflight_keep: 'none': expected failed or all"),
        (("--coflight-processes=2",), "", "--coflight-processes: '2': expected many or one"),
        ((), "coflight_processes = few", "tox.ini: coflight_processes: 'few': expected many or one"),
        (
            ("--coflight-wall-limit=0",),
            "",
            "--coflight-wall-limit: '0': expected a number of seconds above 0",
        ),
        ((), "coflight_wall_limit = 2 min", "tox.ini: coflight_wall_limit: '2 min': expected a number of *"),
        (("--coflight-wall-limit=inf",), "", "--coflight-wall-limit: 'inf': expected a number of *"),
        (("--coflight-out=small.toml",), "", "--coflight-out: 'small.toml': expected a folder*"),
        (("--coflight-out=",), "", "--coflight-out: '': expected a folder*"),
    ],
)
def test_bad_values_are_usage_errors_of_one_line(
    run: Run, arguments: tuple[str, ...], ini: str, line: str
) -> None:
    done = run("def test_any(): pass\n", *arguments, ini=ini)
    assert done.ret == pytest.ExitCode.USAGE_ERROR
    assert len([text for text in done.errlines if text]) == 1
    done.stderr.fnmatch_lines([f"ERROR: {line}"])


@pytest.mark.parametrize(
    ("arguments", "ini", "one_process"),
    [
        ((), "", False),
        ((), "coflight_processes = one", True),
        (("--coflight-processes", "one"), "coflight_processes = many", True),
        (("--coflight-processes", "many"), "coflight_processes = one", False),
    ],
)
def test_processes(run: Run, arguments: tuple[str, ...], ini: str, *, one_process: bool) -> None:
    done = run(SETTINGS, *arguments, ini=ini)
    done.stdout.fnmatch_lines([f"Settings(*one_process={one_process})"])


def test_one_process_flies_and_connections_from_outside_are_refused(pytester: pytest.Pytester) -> None:
    pytester.makefile(".toml", small="agents = 2\n")
    pytester.makeini("[pytest]\nfilterwarnings = error\n")
    pytester.makepyfile(
        test_user="""
        import pytest
        from coflight import SetupError, SwarmError

        def test_one(swarm):
            flight = swarm("small.toml")
            assert list(flight.pids) == ["one process"]
            flight.run_for(0.1)
            with pytest.raises(SwarmError, match="no link to the outside .*--coflight-processes many"):
                flight.mavlink(0)
            with pytest.raises(SwarmError, match="--coflight-processes many"):
                flight.addresses

        def test_many(swarm):
            assert "physics" in swarm("small.toml", processes="many").pids

        @pytest.mark.parametrize("option", [("ports", "scenario"), ("port_offset", 9), ("profile_from_s", 0)])
        def test_outside(swarm, option):
            with pytest.raises(SetupError, match="of one process .*--coflight-processes many"):
                swarm("small.toml", **dict([option]))

        def test_report(swarm):
            swarm("small.toml", ports="free").run_for(0.2)
            assert False
        """
    )
    done = pytester.runpytest_subprocess("--coflight-processes", "one", timeout=200.0)
    done.assert_outcomes(passed=5, failed=1)
    (folder,) = pytester.path.glob(".coflight/test_user-*")
    done.stdout.fnmatch_lines([f"test_user.py::test_report: coflight report .coflight/{folder.name}"])
    assert report.main([str(folder)]) == 0


def test_kernels_are_compiled_once_before_the_tests_and_it_is_said(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def prepare(note: Callable[[str], None], on_progress: Callable[..., object]) -> None:
        sys.stdout.write("captured\n")
        note("compiling the kernels")
        on_progress({"radio": kernel_cache.CompileProgress(3, 40)})

    monkeypatch.setattr(kernel_cache, "prepare", prepare)
    uses = "def test_first(): pass\ndef test_second(coflight_settings): pass\ndef test_third(swarm): pass\n"
    done = run(uses, "-v", "-p", "no:terminalprogress")
    done.assert_outcomes(passed=3)
    said = ["coflight: compiling the kernels", "compiled kernels: radio 3 of 40"]
    done.stdout.fnmatch_lines([*said, "*test_first*", "*test_second*"])
    assert done.outlines.count(said[0]) == 1
    for arguments in (["--collect-only"], ["--setup-plan"], ["-k", "first"]):
        assert said[0] not in run(uses, *arguments).outlines


def test_kernels_that_do_not_compile_are_an_error_of_each_test_and_tried_once(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = []

    def prepare(*arguments: object) -> None:
        tried.append(arguments)
        raise kernel_cache.CompileError("the radio kernels do not compile: the disk is full")

    monkeypatch.setattr(kernel_cache, "prepare", prepare)
    done = run("def test_first(swarm): pass\ndef test_second(swarm): pass\n")
    done.assert_outcomes(errors=2)
    done.stdout.fnmatch_lines(["the radio kernels do not compile: the disk is full"])
    assert len(tried) == 1
