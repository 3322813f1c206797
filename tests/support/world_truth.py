"""True states of vehicles for tests."""

import numpy as np

from harness.world.physics.truth import TRUTH, Truth


def truth_with(**fields):
    """Return the truth of n vehicles from all fields, each (n, 3) or (n, 4), rotor speeds (n, R)."""
    rows = np.empty(len(fields["pos_ned_m"]), TRUTH)
    for name in TRUTH.names:
        rows[name] = fields[name]
    return Truth(rows, np.asarray(fields["rotor_speed_rad_s"]))
