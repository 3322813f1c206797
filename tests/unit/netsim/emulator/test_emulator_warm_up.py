"""The emulator's warm-up calls every kernel of the radio, and leaves none to compile. 20 s."""

from pathlib import Path

import numpy as np
from kernel_coverage import called_by_rehearsal, kernels, signatures
from netsim_swarm import Swarm

import netsim
from netsim.emulator.warm_up import warm_up
from netsim.model.config import InterfererConfig

LAB = "lab"
"""The link simulation's, which no run uses."""


def test_warm_up_calls_every_kernel():
    needed = kernels(Path(netsim.__file__).parent, without=LAB)
    assert len(needed) >= 10
    assert needed - called_by_rehearsal("netsim.emulator.warm_up") == set()


def test_warm_up_leaves_no_kernel_uncompiled():
    """Other channels and larger numbers of stations need no other compiled signatures."""
    warm_up()
    compiled = signatures("netsim", without=LAB)
    assert any(compiled.values())
    everything = {
        "antenna": "dipole", "path_loss": "two_ray", "shadowing_std_db": 4.0, "nlos_fraction": 0.2,
        "interferers": (InterfererConfig(pos_ned_m=(9.0, 0.0, 0.0), duty_cycle=0.2),),
    }  # fmt: skip
    for count, settings in ((3, {}), (3, {"rician_k_db": None}), (20, everything), (3, everything)):
        places = [(30.0 * i, 0.0, -10.0) for i in range(count)]
        for motion in (
            None,
            lambda time_s, places=places: (np.array(places) + time_s, np.ones((len(places), 3))),
        ):
            swarm = Swarm(places, motion=motion, **settings)
            for k in range(count):
                swarm.broadcast(k, 1_000)
                swarm.unicast(k, (k + 1) % count, 1_500)
                swarm.request(k, (k + 1) % count, 2_000)
            swarm.run(20_000)
    assert signatures("netsim", without=LAB) == compiled
