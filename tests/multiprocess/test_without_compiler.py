"""A flight without the compiler is identical to one with it: kernels are plain Python to the last bit."""

import os
import subprocess
import sys

import pytest
from paths import SCENARIOS

pytestmark = pytest.mark.multiprocess
ARTICLE = SCENARIOS / "article.toml"
FLY = """
import sys
from harness.launch.one_process import OneProcessSwarm
low = ["formation.rows=1", "formation.columns=2", "formation.height_m=2"]
with OneProcessSwarm(sys.argv[1], agents=2, seed=5, overrides=low, out=sys.argv[2]) as swarm:
    swarm.run(until_s=12.0)  # localised by beacons and distances, in offboard in the wind
assert {vehicle.phase for vehicle in swarm.truth.vehicles} == {"joining", "on station"}
print(swarm.summary(draw=False)["log_sha256"])
"""


@pytest.mark.timeout(900)
def test_flight_without_the_compiler_has_the_same_bytes_in_every_log(tmp_path):
    """Each flight has its own process, since Numba reads the variable on import."""
    hashes = []
    for disabled in ("0", "1"):
        command = [sys.executable, "-c", FLY, str(ARTICLE), str(tmp_path / disabled)]
        environment = os.environ | {"NUMBA_DISABLE_JIT": disabled}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        hashes.append(done.stdout.split()[-1])
    assert len(hashes[0]) == 64
    assert hashes[0] == hashes[1]
