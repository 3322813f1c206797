"""Log records of the physics server: truth, readings of the scenario's own sensors, channel occupancy."""

from typing import Any

import numpy as np

from harness.world.sensors.config import MOST_NAME


def truth_record(rotors: int) -> np.dtype[Any]:
    """Return the layout of one row per vehicle and recorded instant.

    The state at ``time_us``, with the wind and the rotors of the step before it. Either the force or the
    velocity of the wind is zero, depending on the wind's kind. ``rotors`` is the greatest number of rotors of
    a vehicle in the run; speeds beyond a vehicle's own rotors are 0.
    """
    return np.dtype(
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
            ("rotor_speed_rad_s", "f8", rotors),
        ]
    )


AIR_RECORD = np.dtype([("time_us", "i8"), ("busy_ns", "i8")])
"""One row per recorded instant: total time since the start for which the channel was occupied."""
SENSOR_RECORD = np.dtype(
    [
        ("time_us", "i8"),
        ("measured_us", "i8"),
        ("uav", "i2"),
        ("sensor", f"S{MOST_NAME}"),
        ("column", f"S{MOST_NAME}"),
        ("value", "f8"),
    ]
)
"""One row per value of a reading of the scenario's own sensors, when it arrives."""
EVENT_KINDS = (
    "formed", "formationmoves", "applicationtext", "vehiclelost", "applicationlost", "collision",
    "faultchanged",
)  # fmt: skip
"""Events in simulated time, which are written to events.jsonl."""
