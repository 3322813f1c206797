"""`make setup` with interpreters of several versions: shell scripts that record their arguments."""

import os
import shutil
import subprocess

import pytest
from paths import ROOT

FILES = (
    "Makefile", "pyproject.toml", "requirements.lock", "requirements-dev.lock", "scripts/make_environment.sh"
)  # fmt: skip
INTERPRETER = """\
#!/bin/sh
case "$1 $2" in
    -c*) echo {version} ;;
    "-m venv") mkdir -p "$3/bin" && cp "$0" "$3/bin/python" ;;
    *) echo "$@" >>{calls} ;;
esac
"""
WITHOUT_VENV = """\
#!/bin/sh
[ "$1" = -c ] && echo {version} && exit
mkdir -p "$3/bin"; echo "no ensurepip"; echo "install it"; exit 1
"""


def interpreter(path, version, text=INTERPRETER):
    path.write_text(text.format(version=version, calls=path.parent / "calls"))
    path.chmod(0o755)
    return path


@pytest.fixture
def checkout(tmp_path):
    for name in FILES:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


def make_setup(checkout, python=None):
    """Run `make setup`; return the status and the lines of stderr, and of what pip was asked to install."""
    calls = checkout / "calls"
    calls.unlink(missing_ok=True)
    outer = {
        "MAKEFLAGS",
        "MFLAGS",
        "MAKELEVEL",
        "MAKEOVERRIDES",
        "PYTHON",
        "ARGS",
    }  # of a `make test` around this
    environment = {name: value for name, value in os.environ.items() if name not in outer}
    environment["PATH"] = f"{checkout / 'path'}{os.pathsep}{environment['PATH']}"
    command = ["make", "--no-print-directory", "setup", *([f"PYTHON={python}"] if python else [])]
    done = subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True, check=False)
    said = [line for line in done.stderr.splitlines() if not line.startswith("make: ***")]
    return done.returncode, said, calls.read_text().splitlines() if calls.exists() else []


@pytest.mark.parametrize("present", [False, True])
def test_another_version_is_refused_at_once(checkout, present):
    if present:
        make_setup(checkout, interpreter(checkout / "python", "3.11"))
    other = interpreter(checkout / "other", "3.12")
    status, (line,), installed = make_setup(checkout, other)
    assert (status, installed) == (2, [])
    needed = "coflight needs Python 3.11: type make setup PYTHON=/path/to/python3.11"
    assert line == f"make: {other} is Python 3.12, and {needed}"
    assert (checkout / ".venv").exists() == present


@pytest.mark.parametrize("missing", ["/no/such/python", "no-such-python"])
def test_a_missing_interpreter_is_refused_at_once(checkout, missing):
    status, (line,), installed = make_setup(checkout, missing)
    assert (status, installed) == (2, [])
    assert line.startswith(
        f"make: there is no interpreter {missing} that runs, and coflight needs Python 3.11: "
    )


def test_the_default_is_the_version_that_the_project_needs(checkout):
    (checkout / "path").mkdir()
    interpreter(checkout / "path" / "python3.11", "3.11")
    status, said, _ = make_setup(checkout)
    assert (status, said) == (0, [])
    assert (checkout / ".venv" / ".python").read_text() == "3.11\n"


def test_an_environment_is_set_up_once(checkout):
    python = interpreter(checkout / "python", "3.11")
    status, said, installed = make_setup(checkout, python)
    assert (status, said) == (0, [])
    assert len(installed) == 3, installed
    assert make_setup(checkout, python) == (0, [], [])
    python.unlink()  # an environment that is complete needs none
    assert make_setup(checkout) == (0, [], [])


@pytest.mark.parametrize("gone", [False, True])
def test_an_environment_of_another_python_is_made_again(checkout, gone):
    python = interpreter(checkout / "python", "3.11")
    _, _, installed = make_setup(checkout, python)
    (checkout / ".venv" / "left-over").touch()
    inner = checkout / ".venv" / "bin" / "python"
    inner.unlink()
    if gone:
        inner.symlink_to("/no/such/python")
    else:
        interpreter(inner, "3.10")
    status, said, again = make_setup(checkout, python)
    found = "no interpreter that runs and has pip" if gone else "Python 3.10, not 3.11"
    assert (status, said) == (0, [f"make: .venv has {found}: it is made again"])
    assert again == installed
    assert not (checkout / ".venv" / "left-over").exists()


def test_an_environment_that_cannot_be_made_is_removed(checkout):
    python = interpreter(checkout / "python", "3.11", WITHOUT_VENV)
    status, (line,), _ = make_setup(checkout, python)
    assert status == 2
    assert line.startswith(f"make: {python} makes no virtual environment (no ensurepip install it")
    assert not (checkout / ".venv").exists()
