"""The list of kept run folders at the end of a test session."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from harness.launch.pytest_plugin import PROPERTY, pytest_terminal_summary


@pytest.mark.parametrize(
    ("names", "offered"),
    [([], False), (["manifest.json"], False), (["manifest.json", "events.jsonl"], True)],
)
def test_a_report_is_offered_of_a_flight_that_has_begun(
    tmp_path: Path, names: list[str], *, offered: bool
) -> None:
    for name in names:
        (tmp_path / name).write_text("")
    lines: list[str] = []
    report = SimpleNamespace(nodeid="test_x", user_properties=[(PROPERTY, str(tmp_path))])
    reporter: Any = SimpleNamespace(stats={"failed": [report]}, section=lambda _: None, line=lines.append)
    config: Any = SimpleNamespace(
        stash=pytest.Stash(), invocation_params=SimpleNamespace(dir=tmp_path.parent)
    )
    pytest_terminal_summary(reporter, config)
    command = "coflight report " if offered else "without tables: "
    assert lines == [f"test_x: {command}{tmp_path.name}"]
