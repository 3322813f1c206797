"""What the physics server writes down: the truth, vehicle by vehicle, and the air's occupancy."""

import numpy as np

TRUTH_RECORD = np.dtype(
    [
        ("time_us", "i8"),
        ("uav", "i2"),
        ("alive", "?"),
        ("armed", "?"),
        ("pos_ned_m", "f8", 3),
        ("vel_ned_m_s", "f8", 3),
        ("q_ned_frd", "f8", 4),
        ("omega_frd_rad_s", "f8", 3),
        ("wind_force_ned_n", "f8", 3),
        ("wind_vel_ned_m_s", "f8", 3),
        ("rotor_speed_rad_s", "f8", 4),
    ]
)
"""One row per vehicle and recorded instant.

The state at ``time_us``, the wind and rotors of the step that led to it. Of the wind one is zero: it is a
force or a velocity.
"""

AIR_RECORD = np.dtype([("time_us", "i8"), ("busy_ns", "i8")])
"""One row per recorded instant: time since the start for which the channel carried something."""
EVENT_KINDS = ("formed", "formationmoves", "vehiclelost", "collision", "faultchanged")
"""Events that belong to the run itself, not to the wall clock; they are written to events.jsonl."""
