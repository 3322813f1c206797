"""A cache of compiled kernels that another user could write is not used, and one line says what to do."""

import grp
import os
import pwd
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from paths import ROOT

from foundation.kernels import cache_folder, cache_trust
from foundation.kernels.cache_trust import UntrustedCache, check_trusted

OTHER_ID = 65_534


@pytest.fixture
def cache(tmp_path: Path) -> Path:
    """A cache with a kernel, below a base in which only this user can write."""
    folder = tmp_path / "base" / "coflight" / "kernels" / "state"
    (folder / "module").mkdir(parents=True)
    for path in (folder / "module" / "kernel.nbi", folder / "vehicles.complete"):
        path.touch(0o644)
    for path in (folder, *folder.parents[:3], folder / "module"):
        path.chmod(0o755)
    return folder


def refused(folder: Path) -> str:
    with pytest.raises(UntrustedCache) as raised:
        check_trusted(folder, folder.parents[2], variable="XDG_CACHE_HOME")
    line = str(raised.value)
    assert line.startswith(f"compiled kernels in {folder} are not loaded: ")
    assert line.endswith(", or set XDG_CACHE_HOME to another folder")
    assert "\n" not in line
    return line


def test_a_cache_that_others_can_only_read_is_trusted(cache: Path) -> None:
    check_trusted(cache, cache.parents[2], variable="XDG_CACHE_HOME")


@pytest.mark.parametrize("mode", [0o777, 0o757])
@pytest.mark.parametrize("place", [".", "..", "../..", "../../..", "module", "module/kernel.nbi"])
def test_whatever_others_can_write_is_named_with_the_command(cache: Path, place: str, mode: int) -> None:
    path = Path(os.path.normpath(cache / place))
    path.chmod(mode)
    assert f"other users can write {path}: chmod -R go-w {path}" in refused(cache)


def test_files_that_others_cannot_reach_are_trusted(cache: Path) -> None:
    (cache / "module" / "kernel.nbi").chmod(0o666)
    cache.chmod(0o700)
    check_trusted(cache, cache.parents[2], variable="XDG_CACHE_HOME")


def test_above_the_base_nothing_is_checked(cache: Path, tmp_path: Path) -> None:
    tmp_path.chmod(0o777)
    check_trusted(cache, cache.parents[2], variable="XDG_CACHE_HOME")


def test_a_base_as_tmp_is_trusted_and_a_cache_as_tmp_is_not(cache: Path) -> None:
    cache.parents[2].chmod(0o1777)
    check_trusted(cache, cache.parents[2], variable="XDG_CACHE_HOME")
    cache.chmod(0o1777)
    assert f"can write {cache}" in refused(cache)


def test_a_cache_that_is_not_there_yet_is_no_error(tmp_path: Path) -> None:
    check_trusted(tmp_path / "none" / "state", tmp_path, variable="XDG_CACHE_HOME")
    (tmp_path / "file").touch()
    check_trusted(tmp_path / "file" / "state", tmp_path, variable="XDG_CACHE_HOME")


@pytest.mark.parametrize(
    ("members", "name"),
    [([], "me"), (["me"], "me"), (["me", "you"], "me"), ([], "staff")],
)
def test_the_group_of_this_user_alone_may_write(
    cache: Path, members: list[str], name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pwd, "getpwuid", lambda _: SimpleNamespace(pw_name="me", pw_gid=os.getegid()))
    monkeypatch.setattr(grp, "getgrgid", lambda _: SimpleNamespace(gr_name=name, gr_mem=members))
    cache.chmod(0o775)
    if name == "me" and "you" not in members:
        check_trusted(cache, cache.parents[2], variable="XDG_CACHE_HOME")
    else:
        refused(cache)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file to another user")
@pytest.mark.parametrize("place", [".", "..", "module/kernel.nbi"])
def test_what_belongs_to_another_user_is_not_loaded(cache: Path, place: str) -> None:
    path = Path(os.path.normpath(cache / place))
    os.chown(path, OTHER_ID, OTHER_ID)
    assert f"{path} belongs to the user" in refused(cache)


def test_a_cache_of_root_is_trusted_by_every_user(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: OTHER_ID)
    if cache.stat().st_uid == 0:
        check_trusted(cache, cache.parents[2], variable="XDG_CACHE_HOME")
    else:
        refused(cache)


def test_a_cache_that_cannot_be_read_is_named_with_the_command(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = cache / "module" / "kernel.nbi"
    monkeypatch.setattr(cache_trust.os, "access", lambda file, _mode: file != path)
    assert f"{path} cannot be read: its owner can permit it, chmod -R a+rX {path}" in refused(cache)
    monkeypatch.setattr(cache_trust.os, "access", lambda file, _mode: file != cache)
    assert f"{cache} cannot be read" in refused(cache)


def test_a_parent_that_another_process_makes_at_the_same_time_is_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "coflight" / "kernels" / "state"

    def make(folder: Path, *, exist_ok: bool) -> None:
        folder.mkdir(parents=True, exist_ok=exist_ok)
        folder.parent.chmod(0o777)

    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    monkeypatch.delenv(cache_folder.VARIABLE, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(cache_folder, "folder", lambda: path)
    monkeypatch.setattr(cache_folder, "make_private", make)
    with pytest.raises(UntrustedCache, match=f"other users can write {path.parent}"):
        cache_folder.environment()


@pytest.mark.parametrize(
    ("program", "status"),
    [
        (["-m", "coflight", "scenarios"], 1),
        (["-c", "from coflight import Swarm"], 1),
        (["-m", "pytest", "--collect-only", "none"], 4),
    ],
)
def test_every_way_in_ends_with_the_line(tmp_path: Path, program: list[str], status: int) -> None:
    base = tmp_path / "cache" / "coflight"
    base.mkdir(parents=True)
    base.chmod(0o777)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    done = subprocess.run(
        [sys.executable, *program],
        cwd=ROOT,
        env=environment | {"XDG_CACHE_HOME": str(base.parent)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == status, done.stderr
    last_line = done.stderr.rstrip().rpartition("\n")[2]
    assert f"other users can write {base}: chmod -R go-w {base}, or set XDG_CACHE_HOME" in last_line
    assert not (base / "kernels").exists()
