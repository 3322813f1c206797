"""Scenarios by name: packaged files, and files of the user's before them."""

from pathlib import Path

import pytest

from harness.campaign import load as load_campaign
from harness.scenario import packaged
from harness.scenario.scenario_file import load


@pytest.mark.parametrize("name", [name for name in packaged.names() if "/" not in name])
def test_every_packaged_scenario_loads_by_its_name(name: str) -> None:
    assert load(name).name == name


@pytest.mark.parametrize("name", [name for name in packaged.names() if name.startswith("campaigns/")])
def test_every_packaged_campaign_loads_by_its_name(name: str) -> None:
    assert load_campaign(name).scenario.is_file()


def test_a_file_at_the_path_has_precedence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert packaged.find("article") == packaged.FOLDER / "article.toml"
    (tmp_path / "article").write_text("agents = 2\n")
    assert packaged.find("article") == Path("article")


def test_relative_paths_are_below_the_root(tmp_path: Path) -> None:
    assert packaged.find("own.toml", root=tmp_path) == tmp_path / "own.toml"
    assert packaged.find("article", root=tmp_path) == packaged.FOLDER / "article.toml"
    assert packaged.find("nowhere", root=tmp_path) == tmp_path / "nowhere"
    assert packaged.find(packaged.FOLDER / "ring.toml", root=tmp_path) == packaged.FOLDER / "ring.toml"


@pytest.mark.parametrize("path", ["article.toml", "nowhere/article", "../article", "/article", "", "."])
def test_what_is_no_name_stays_a_path(path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert packaged.find(path) == Path(path)
