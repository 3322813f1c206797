"""The files of a run's radio are removed as far as possible, so that the stop goes on."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from harness.launch.radio_link import RadioLink


def test_the_socket_folder_is_removed_if_the_guests_file_cannot_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    guest_access = tmp_path / "guests.json"
    guest_access.mkdir()  # which cannot be unlinked
    scenario: Any = SimpleNamespace(
        ports=SimpleNamespace(radio_link="unix"), radio=SimpleNamespace(guests=()), has_network=False,
        agents=1, ground_stations=(),
    )  # fmt: skip
    folder: Any = SimpleNamespace(guest_access=guest_access, radio_config=lambda *_, **__: None)
    link = RadioLink(scenario, folder, run_id="r")
    (sockets,) = tmp_path.glob("coflight-radio-*")
    assert {*link.leftovers()} == {guest_access, sockets}
    for _ in range(2):
        link.remove()
        assert link.leftovers() == [guest_access]
