"""Leaving out stations that have nothing to send saves time and changes nothing. The file runs in 3 s."""

import numpy as np
import pytest
from netsim_air import UNHEARD_DBM, Air

from netsim.frames import GROUP
from netsim.mac.access import DCF, EDCA
from netsim.mac.channel import ChannelAccess
from netsim.phy.sensing import HEEDS_END

STATIONS = 5
FRAMES = 120
"""In 40 ms: frames of 160 us and more, with which the medium is busy for half of the time."""


def traffic(seed, access):
    """What went out and how it ended, of random frames among stations not all of which hear each other."""
    rng = np.random.default_rng(seed)
    pairs = [(i, j) for i in range(STATIONS) for j in range(STATIONS) if i < j and rng.random() < 0.25]
    powers_dbm = {link: UNHEARD_DBM for i, j in pairs for link in ((i, j), (j, i))}
    air = Air(STATIONS, powers_dbm=powers_dbm, access=access, seed=seed)
    jobs = []
    for at_us in np.sort(rng.integers(1_000, 41_000, FRAMES)).tolist():
        source, to = rng.choice(STATIONS, 2, replace=False).tolist()
        jobs.append(
            air.send(
                at_us,
                source,
                to if rng.random() < 0.6 else GROUP,
                frame_bytes=int(rng.choice([40, 100, 400])),
                mode=rng.choice(["ofdm6", "ofdm24"]),
                rts=bool(rng.random() < 0.5),
                category=rng.choice(list(access)),
                lifetime_us=int(rng.choice([1_000, 10_000, 500_000])),
            )
        )
    return air.run(), air.outcomes, air.arrivals, [(job.attempts, job.failures) for job in jobs]


@pytest.mark.parametrize("access", [{"dcf": DCF}, EDCA], ids=["dcf", "edca"])
def test_stations_that_always_listen_do_the_same(access, monkeypatch):
    seeds = range(25)
    spared = [traffic(seed, access) for seed in seeds]
    freeze = ChannelAccess._freeze
    left_out = 0

    def stay_attentive(self, sensed_ns):
        nonlocal left_out
        freeze(self, sensed_ns)
        left_out += not self._sensed[HEEDS_END]
        self._sensed[HEEDS_END] = True

    monkeypatch.setattr(ChannelAccess, "_freeze", stay_attentive)
    for seed in seeds:
        frames, outcomes, arrivals, jobs = traffic(seed, access)
        assert (frames, outcomes, arrivals, jobs) == spared[seed]
        assert len(outcomes) == FRAMES
    assert left_out > 100
