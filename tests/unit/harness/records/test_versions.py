"""State of the checkout: commit and changes, and its absence."""

import os
import subprocess

import pytest

from harness.records.versions import Checkout, checkout


def git(root, *arguments):
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    author = ["-c", "user.name=a", "-c", "user.email=a@b"]
    command = ["git", "-C", str(root), *author, *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.strip()


@pytest.fixture
def repository(tmp_path):
    git(tmp_path, "init", "--quiet")
    (tmp_path / "a.py").write_text("A = 1\n")
    git(tmp_path, "add", "a.py")
    git(tmp_path, "commit", "--quiet", "--message=a")
    git(tmp_path, "tag", "--annotate", "--message=v", "v1.0-rc")  # not part of the commit's name
    return tmp_path


@pytest.fixture(autouse=True)
def forget():
    checkout.cache_clear()
    yield
    checkout.cache_clear()


def test_the_commit_is_the_checkouts_and_dirty_with_changes(repository, monkeypatch):
    monkeypatch.setenv("GIT_DIR", str(repository / "elsewhere"))  # as in a hook of another repository
    commit = git(repository, "rev-parse", "HEAD")
    assert checkout(repository) == Checkout(commit=commit, dirty=False)
    (repository / "runs").mkdir()
    (repository / "runs" / "new").write_text("")
    (repository / "a.py").write_text("A = 2\n")
    assert checkout(repository) == Checkout(commit=commit, dirty=False)  # that of the loaded sources
    checkout.cache_clear()
    assert checkout(repository) == Checkout(commit=commit, dirty=True)
    (repository / "a.py").write_text("A = 1\n")
    checkout.cache_clear()
    assert checkout(repository) == Checkout(commit=commit, dirty=False)


def test_a_wheel_in_the_checkout_of_another_project_has_none(repository):
    packages = repository / "lib" / "site-packages"
    packages.mkdir(parents=True)
    assert checkout(packages) is None


def test_without_git_or_a_commit_there_is_none(tmp_path, repository, monkeypatch):
    empty = tmp_path / "empty"
    empty.mkdir()
    git(empty, "init", "--quiet")
    assert checkout(empty) is None
    monkeypatch.setenv("PATH", str(empty))
    assert checkout(repository) is None
