"""Middleware on two vehicles: the blocks of docs/how-to/middleware.md, flown until each receives."""

import json
import re
import time

from paths import ROOT

from harness.launch.swarm import Swarm
from studies.programs.flight import NO_APPLICATION, program

DEADLINE_S = 40.0


def block(words):
    """Return the Python block of the page that contains some words."""
    page = (ROOT / "docs" / "how-to" / "middleware.md").read_text()
    (found,) = [each for each in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if words in each]
    return found


def receives_from_the_other(tmp_path, command, texts):
    """Run a command on two vehicles until the output of each has the other's text.

    Returns the numbers of group frames, and of acknowledged ones.
    """
    path = tmp_path / "middleware.toml"
    path.write_text(
        f"agents = 2\n[formation]\nshape = 'line'\n[radio]\nbroadcast_rts = false\n{NO_APPLICATION}"
        + program("peer", "all", command)
    )
    with Swarm(path, speed=1, out=tmp_path / "run") as swarm:
        logs = [swarm.path / "logs" / f"uav-{uav}-peer.log" for uav in range(2)]
        wall_end_s = time.monotonic() + DEADLINE_S
        while not all(text in log.read_text() for text, log in zip(texts[::-1], logs, strict=True)):
            assert time.monotonic() < wall_end_s, [log.read_text() for log in logs]
            swarm.run_for(0.5)
    assert swarm.leftovers() == []
    manifest = json.loads((swarm.path / "manifest.json").read_bytes())
    (radio,) = [each for each in manifest["processes"] if each["name"] == "radio"]
    outcomes = radio["details"]["counters"]["packets"]["outcomes"]
    return {"group": outcomes.get("sent", 0), "acknowledged": outcomes.get("acknowledged", 0)}
