"""Only the owner can read a run, a campaign and the kept runs of tests, whatever the umask is."""

import os
import stat
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from other_user import OTHER_UID, root_only

from harness.campaign.store import CampaignError, Flown, Store
from harness.launch.pytest_folders import claim
from harness.records.run_folder import FolderRefused, RunFolder

GROUP_OR_OTHER = 0o077


class Settings(msgspec.Struct):
    token: str = "secret"  # noqa: S105


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.fixture(params=[0o000, 0o022], ids=oct)
def umask(request: pytest.FixtureRequest) -> Iterator[int]:
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


@pytest.mark.usefixtures("umask")
def test_the_folder_of_a_run_is_private_and_so_are_its_settings(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "runs" / "one").create()
    settings = folder.write_config("radio", Settings())
    assert mode(folder.path) == mode(folder.config) == mode(folder.raw) == 0o700
    assert mode(settings) == 0o600
    assert mode(tmp_path / "runs") & 0o022 == 0
    folder.release()


@pytest.mark.usefixtures("umask")
def test_a_folder_of_the_user_keeps_its_rights_and_settings_are_private_in_it(tmp_path: Path) -> None:
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o755)
    folder = RunFolder(shared).create()
    settings = folder.write_config("radio", Settings())
    assert (mode(shared), mode(folder.config), mode(folder.raw), mode(settings)) == (
        0o755,
        0o700,
        0o700,
        0o600,
    )
    assert mode(folder.figures) & 0o022 == mode(folder.logs) & 0o022 == 0
    folder.release()


@pytest.mark.usefixtures("umask")
def test_a_campaign_is_private(tmp_path: Path) -> None:
    store = Store(tmp_path / "campaign")
    with store.alone():
        store.put(Flown(digest="0" * 16, status="completed"), {"gains": b"series"})
    assert mode(store.folder) == mode(store.folder / "runs") == 0o700
    assert mode(store.folder / "lock") & GROUP_OR_OTHER == 0
    assert mode(store.folder / "runs" / f"{'0' * 16}.json") & GROUP_OR_OTHER == 0


@pytest.mark.usefixtures("umask")
def test_a_campaign_in_a_folder_of_the_user_keeps_its_rights(tmp_path: Path) -> None:
    tmp_path.chmod(0o755)
    store = Store(tmp_path)
    assert mode(tmp_path) == 0o755
    assert mode(store.folder / "runs") == 0o700


@pytest.mark.parametrize("mode_bits", [0o777, 0o757, 0o1777])
def test_a_folder_that_others_can_write_is_refused_in_one_line(tmp_path: Path, mode_bits: int) -> None:
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(mode_bits)
    line = (
        f"other users can write {shared}: chmod -R go-w {shared}, or name a new or an empty one with --out "
        "(in Python, out=)"
    )
    with pytest.raises(FolderRefused) as refused:
        RunFolder(shared).create()
    assert str(refused.value) == line
    with pytest.raises(CampaignError) as campaign_refused:
        Store(shared)
    assert str(campaign_refused.value) == line
    assert list(shared.iterdir()) == []


@root_only
def test_a_folder_of_another_user_is_refused(tmp_path: Path) -> None:
    os.chown(tmp_path, OTHER_UID, OTHER_UID)
    line = f"{tmp_path} belongs to the user .*: delete it, or name a new or an empty one"
    with pytest.raises(FolderRefused, match=line):
        RunFolder(tmp_path).create()
    with pytest.raises(CampaignError, match=line):
        Store(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("umask")
def test_the_kept_runs_of_tests_are_private(tmp_path: Path) -> None:
    place = claim(tmp_path / ".coflight", "tests/test_one.py::test")
    assert mode(place.path.parent) == mode(place.path.parent / ".claims") == 0o700
    place.remove()
