"""The code blocks of docs/how-to/ground-control.md run unchanged, except for the ports."""

import re
import subprocess
import sys

import pytest
from swarms import ROOT

pytestmark = [pytest.mark.clients, pytest.mark.timeout(200)]


def test_the_blocks_of_the_ground_stations_page(hold, tmp_path) -> None:
    blocks = re.findall(
        r"```python\n(.*?)```", (ROOT / "docs" / "how-to" / "ground-control.md").read_text(), re.DOTALL
    )
    assert len(blocks) == 2
    swarm = hold()
    # in reverse: the last block flies a waiting vehicle, and the first releases the formation
    for number, block in enumerate(reversed(blocks)):
        script = tmp_path / f"block{number}.py"
        script.write_text(
            block.replace("14550", str(swarm.ground_station_port)).replace("14540", str(swarm.companion_port))
        )
        done = subprocess.run(
            [sys.executable, str(script)], capture_output=True, text=True, timeout=90.0, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
    swarm.end()
    assert any("released" in line for line in swarm.log_lines)
