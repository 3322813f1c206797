"""Write the lock files, with the hashes of all files of each release: ``make lock [ARGS=--upgrade]``.

The versions of the present files are kept where pyproject.toml allows them; ``--upgrade`` takes the newest.
uv resolves in an environment that is removed at the end, and asks the package index of pip's configuration.
Exit status: 0 written, otherwise that of the failing step.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
import tomllib
import venv
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
UV = "uv>=0.8"
_PIN = re.compile(r"^([a-z0-9.-]+)==\S+", re.MULTILINE)


class Lock(NamedTuple):
    """A lock file, and what it is made of."""

    name: str
    heading: str
    options: tuple[str, ...]
    """What of pyproject.toml it covers, as arguments of ``uv pip compile``"""
    needs_backend: bool = False
    """Whether it has the build backend too, which installs the checkout"""


LOCKS = (
    Lock(
        "requirements.lock",
        "What flying needs and what installs a checkout: dependencies and the extras `nec2` and `env`.",
        ("pyproject.toml", "--extra", "nec2", "--extra", "env"),
        needs_backend=True,
    ),
    Lock(
        "requirements-view.lock", "The extra `view`: the viewer Rerun.", ("pyproject.toml", "--extra", "view")
    ),
    Lock(
        "requirements-dev.lock",
        "The dependency group `dev`: linters, type checker and tests.",
        ("--group", "dev"),
    ),
    Lock(
        "requirements-docs.lock", "The dependency group `docs`: MkDocs with its theme.", ("--group", "docs")
    ),
    Lock(
        "requirements-clients.lock",
        "The dependency group `clients`: ground stations and middleware.",
        ("--group", "clients"),
    ),
)
"""In the order in which they are resolved: each keeps to the versions of those before it."""


def pins(text: str) -> list[str]:
    """Return the names of the packages that a lock file pins."""
    return _PIN.findall(text)


def resolved(uv: Path, lock: Lock, before: list[Lock], work: Path, *, upgrade: bool) -> str:
    """Return the content of a lock file; ends the program if uv finds no solution.

    The packages of the first file are left out of the others, which are installed after it.
    """
    present = work / lock.name
    present.write_bytes((ROOT / lock.name).read_bytes())
    major, minor, *_ = sys.version_info
    command = [
        str(uv), "pip", "compile", "--quiet", "--python-version", f"{major}.{minor}",
        "--python-platform", "linux",
        "--generate-hashes", "--no-header", "--no-annotate", "--output-file", str(present), *lock.options,
    ]  # fmt: skip
    for each in before:
        command += ["--constraint", each.name]
    if before:
        for name in pins((ROOT / before[0].name).read_text(encoding="utf-8")):
            command += ["--no-emit-package", name]
    if lock.needs_backend:
        backend = work / "backend.txt"
        project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
        backend.write_text("\n".join(project["build-system"]["requires"]) + "\n", encoding="utf-8")
        command.append(str(backend))
    if upgrade:
        command.append("--upgrade")
    status = subprocess.run(command, cwd=ROOT, env=os.environ | index_of_pip(), check=False).returncode
    if status:
        sys.exit(status)
    lines = [line for line in present.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    heading = [
        f"# {lock.heading}",
        "# `make lock` writes this file, with the hashes of all files of each release.",
    ]
    if before:
        heading.append(f"# Install {before[0].name} first, then this one without dependencies.")
    return "\n".join([*heading, *lines]) + "\n"


def index_of_pip() -> dict[str, str]:
    """Return the environment variable that has uv ask the package index which pip is configured to ask."""
    command = [sys.executable, "-m", "pip", "config", "list"]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    found = re.findall(r"^\S*\.index-url='(.*)'$", text, re.MULTILINE)
    return {"UV_DEFAULT_INDEX": found[-1]} if found else {}


def main() -> int:
    """Write all lock files; returns the exit status."""
    parser = argparse.ArgumentParser(
        description="Write the lock files with the hashes of all their packages."
    )
    parser.add_argument("--upgrade", action="store_true", help="Take the newest versions that fit.")
    upgrade = parser.parse_args().upgrade
    with tempfile.TemporaryDirectory(prefix="coflight-locks-") as name:
        work = Path(name)
        venv.create(work / "env", with_pip=True)
        python = work / "env" / "bin" / "python"
        install = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", UV]
        status = subprocess.run(install, check=False).returncode
        if status:
            return status
        for number, lock in enumerate(LOCKS):
            content = resolved(python.with_name("uv"), lock, list(LOCKS[:number]), work, upgrade=upgrade)
            (ROOT / lock.name).write_text(content, encoding="utf-8")
            print(f"{lock.name}: {len(pins(content))} packages")
    return 0


if __name__ == "__main__":
    sys.exit(main())
