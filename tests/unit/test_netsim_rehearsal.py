"""The emulator's rehearsal calls every kernel of the air, and leaves none to be compiled. 20 s."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from netsim_swarm import Swarm
from numba.core.dispatcher import Dispatcher

import netsim
from netsim.config import InterfererConfig
from netsim.rehearsal import rehearse

FOLDER = Path(netsim.__file__).parent


def kernels():
    """(file, name) of all but the link simulation's, which no run uses."""
    return {
        (str(path), node.name)
        for path in FOLDER.rglob("*.py")
        if path.parent.name != "lab"
        for node in ast.walk(ast.parse(path.read_bytes()))
        if isinstance(node, ast.FunctionDef) and any("njit" in ast.dump(each) for each in node.decorator_list)
    }


def test_it_calls_every_kernel():
    """Uncompiled, so that Python sees kernels which others call."""
    program = (
        "import json, sys\n"
        "from netsim.rehearsal import rehearse\n"
        "called = set()\n"
        "sys.setprofile(lambda frame, *_: called.add((frame.f_code.co_filename, frame.f_code.co_name)))\n"
        "rehearse()\n"
        "sys.setprofile(None)\n"
        "print(json.dumps(sorted(called)))\n"
    )
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    said = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, check=True)
    assert len(kernels()) >= 10
    assert kernels() - {tuple(each) for each in json.loads(said.stdout)} == set()


def signatures():
    return {
        (name, attribute): len(value.signatures)
        for name, module in list(sys.modules.items())
        if name.startswith("netsim.") and not name.startswith("netsim.lab")
        for attribute, value in vars(module).items()
        if isinstance(value, Dispatcher)
    }


def test_after_it_nothing_is_left_to_be_compiled():
    """Other channels, and as many stations as compute links one by one, ask for no other types."""
    rehearse()
    compiled = signatures()
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
    assert signatures() == compiled
