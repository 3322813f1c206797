"""The container's file and the example of a workflow, as far as they can be checked without running them."""

import re
import shlex
import tomllib

import pytest
import yaml
from paths import ROOT

from refresh_locks import LOCKS

INSTRUCTIONS = [
    line.split(maxsplit=1)
    for line in (ROOT / "Containerfile").read_text(encoding="utf-8").splitlines()
    if line and not line.startswith("#")
]
WORKFLOW = yaml.safe_load((ROOT / "examples" / "ci" / "github-actions.yml").read_text(encoding="utf-8"))
STEPS = WORKFLOW["jobs"]["swarm"]["steps"]
TARGET = re.compile(r"^([a-z-]+):", re.MULTILINE)


def of(keyword):
    return [rest for word, rest in INSTRUCTIONS if word == keyword]


def test_the_container_has_known_instructions_and_stages():
    assert {word for word, _ in INSTRUCTIONS} <= {
        "FROM", "COPY", "RUN", "WORKDIR", "USER", "ENV", "ENTRYPOINT", "CMD",
    }  # fmt: skip
    stages = {"python:3.11-slim"}
    for base, _, name in (line.partition(" AS ") for line in of("FROM")):
        assert base in stages
        stages.add(name)


def test_the_container_has_all_packages_and_no_file_that_is_missing():
    copied = {name for line in of("COPY") if not line.startswith("--from") for name in line.split()[:-1]}
    assert all((ROOT / name).exists() for name in copied)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    packages = {name.rstrip("*") for name in project["tool"]["setuptools"]["packages"]["find"]["include"]}
    assert packages <= copied
    assert {project["project"]["readme"], *project["project"]["license-files"]} <= copied


def test_the_container_installs_nothing_that_is_not_locked():
    installs = [command for line in of("RUN") for command in line.split(" && ") if " pip " in command]
    assert len(installs) == 3
    for command in map(shlex.split, installs):
        assert "--require-hashes" in command or "--no-deps" in command
        assert {"--require-hashes", "--no-build-isolation", "--no-index"} & set(command)


def test_the_container_runs_the_command_as_an_unprivileged_user():
    for stage in re.split(
        r"^FROM ", (ROOT / "Containerfile").read_text(encoding="utf-8"), flags=re.MULTILINE
    ):
        users = re.findall(r"^USER (\w+)$", stage, re.MULTILINE)
        assert not users or users[-1] == "coflight"
    assert of("ENTRYPOINT") == ['["coflight"]']
    (caches,) = of("ENV")
    assert {word.partition("=")[0] for word in caches.split()} == {"XDG_CACHE_HOME", "NUMBA_CACHE_DIR"}


def test_the_workflow_caches_by_the_files_that_it_depends_on():
    patterns = re.findall(
        r"'(coflight/[^']+)'", str([step["with"]["key"] for step in STEPS if "key" in step.get("with", {})])
    )
    assert len(patterns) == 3
    for pattern in patterns:
        assert list(ROOT.glob(pattern.removeprefix("coflight/"))), pattern
    assert all((ROOT / lock.name).match(patterns[0].removeprefix("coflight/")) for lock in LOCKS)


@pytest.mark.parametrize("step", [step for step in STEPS if "make " in step.get("run", "")])
def test_the_workflow_makes_targets_that_exist(step):
    command = shlex.split(step["run"])
    assert command[:3] == ["make", "-C", "coflight"]
    assert command[3] in TARGET.findall((ROOT / "Makefile").read_text(encoding="utf-8"))


def test_the_workflow_uploads_the_folder_that_the_tests_write():
    (fly,) = (step["run"] for step in STEPS if "pytest" in step.get("run", ""))
    (upload,) = (step for step in STEPS if "upload" in step.get("uses", ""))
    written = re.findall(r"--(?:coflight-out|junit-xml)=(\S+)", fly)
    assert sorted(upload["with"]["path"].split()) == sorted(written)
    assert upload["if"] == "failure()"
