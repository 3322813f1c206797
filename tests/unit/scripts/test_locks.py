"""The lock files against pyproject.toml, and against what pip needs to verify each package."""

import re
import tomllib

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from paths import ROOT

from refresh_locks import LOCKS, pins

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
ASKED = {
    "requirements.lock": [
        *PROJECT["project"]["dependencies"], *PROJECT["project"]["optional-dependencies"]["nec2"],
        *PROJECT["build-system"]["requires"],
    ],
    "requirements-view.lock": PROJECT["project"]["optional-dependencies"]["view"],
    **{f"requirements-{name}.lock": asked for name, asked in PROJECT["dependency-groups"].items()},
}  # fmt: skip
TEXTS = {lock.name: (ROOT / lock.name).read_text(encoding="utf-8") for lock in LOCKS}


def versions(text):
    return dict(re.findall(r"^([a-z0-9.-]+)==(\S+)", text, re.MULTILINE))


def test_every_lock_file_is_written_by_the_script():
    assert sorted(TEXTS) == sorted(path.name for path in ROOT.glob("requirements*.lock")) == sorted(ASKED)


@pytest.mark.parametrize("name", TEXTS)
def test_each_package_has_a_version_and_hashes_and_nothing_else(name):
    lines = [line for line in TEXTS[name].splitlines() if not line.startswith("#")]
    joined = "\n".join(lines).replace(" \\\n", "").splitlines()
    assert len(joined) == len(pins(TEXTS[name])) > 0
    for line in joined:
        assert re.fullmatch(r"[a-z0-9.-]+==[0-9][\w.]*( +--hash=sha256:[0-9a-f]{64})+", line), line


@pytest.mark.parametrize("name", TEXTS)
def test_the_locked_versions_are_those_that_the_project_allows(name):
    locked = versions(TEXTS["requirements.lock"]) | versions(TEXTS[name])
    for each in map(Requirement, ASKED[name]):
        version = locked[canonicalize_name(each.name)]
        assert each.specifier.contains(version), f"{each}: {version}; run make lock"


def test_the_build_backend_is_the_locked_one():
    locked = versions(TEXTS["requirements.lock"])
    backend = PROJECT["build-system"]["requires"]
    assert backend == [f"{each.name}=={locked[each.name]}" for each in map(Requirement, backend)]


def test_a_package_has_one_version():
    found = {}
    for name, text in TEXTS.items():
        for package, version in versions(text).items():
            assert found.setdefault(package, version) == version, f"{package} in {name}"
    first, *others = TEXTS.values()
    assert not any(set(pins(first)) & set(pins(text)) for text in others)


def test_packages_without_dependencies_are_named_at_their_locked_versions():
    locked = versions("\n".join(TEXTS.values()))
    for each in PROJECT["tool"]["uv"]["dependency-metadata"]:
        assert locked[each["name"]] == each["version"]
