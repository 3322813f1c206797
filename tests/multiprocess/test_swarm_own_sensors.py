"""A failing sensor or fault of the user ends the run with one line that names it, in both kinds of swarm."""

import pytest
from paths import SUPPORT

from coflight import OneProcessSwarm, Swarm, SwarmError

pytestmark = pytest.mark.multiprocess
FAILING = (
    f"{{kind='user', model='user_world_models:Failing', uav=1, settings={{what='late'}}, folder='{SUPPORT}'}}"
)


@pytest.mark.parametrize("kind", [Swarm, OneProcessSwarm])
def test_a_fault_that_fails_in_flight_is_named_with_its_place(kind, tmp_path):
    overrides = ["formation.columns=2", f"faults=[{FAILING}]"]
    line = r"faults\[0\]\.model user_world_models:Failing\.update: RuntimeError: broken \(.*models\.py:\d+\)"
    with kind("article", agents=2, overrides=overrides, out=tmp_path / "run") as flight:
        with pytest.raises(SwarmError, match=line):
            flight.run(until_s=5.0)
        summary = flight.summary(draw=False)
    assert summary["status"] == "failed"
    assert (tmp_path / "run" / "flight.parquet").exists()  # what was recorded until then is kept
    logs = "".join(path.read_text(encoding="utf-8") for path in (tmp_path / "run" / "logs").iterdir())
    assert "Traceback" in logs
    assert 'raise RuntimeError("broken")' in logs
