"""Vehicle model: parameters of a rigid body with four rotors.

The values are those of the 3DR Iris in PX4's Gazebo-classic models (`iris.sdf`, `gazebo_motor_model`), body
axes FLU as there. The body is symmetric, so its inertia is diagonal and the same in FRD.
"""

from dataclasses import dataclass

Vector = tuple[float, float, float]
Four = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleModel:
    """Mass, shape, rotors and motors of one vehicle; the defaults are the Iris."""

    mass_kg: float = 1.55
    inertia_diagonal_kg_m2: Vector = (0.029125, 0.029125, 0.055225)
    box_m: Vector = (0.47, 0.47, 0.11)
    """Collision shape, centred on the centre of mass."""
    friction: float = 0.8
    """Coefficient against the ground, whose own is 1.0: rubber feet on asphalt."""

    rotor_hubs_flu_m: tuple[Vector, Vector, Vector, Vector] = (
        (0.13, -0.22, 0.023),
        (-0.13, 0.20, 0.023),
        (0.13, 0.22, 0.023),
        (-0.13, -0.20, 0.023),
    )
    """From the centre of mass, in PX4's order: front right, back left, front left, back right."""
    rotor_turning: Four = (1.0, 1.0, -1.0, -1.0)
    """+1 turns counter-clockwise seen from above."""
    thrust_n_s2: float = 5.84e-6
    """Static thrust of a rotor over the square of its speed, N/(rad/s)^2."""
    moment_m: float = 0.06
    """Torque about the rotor's axis over its static thrust."""
    rotor_drag_n_s2_m: float = 1.75e-4
    """In-plane force over rotor speed and in-plane air speed, N/(rad/s)/(m/s)."""
    drag_n_s_m: float = 0.0
    """Drag of the body over its air speed. Gazebo's Iris has drag of the rotors only."""
    rotor_radius_m: float = 0.128
    """Used by the ground effect only."""
    rolling_moment_n_s2: float = 1e-6
    """Rolling moment over rotor speed and in-plane air speed, N m/(rad/s)/(m/s)."""
    axial_speed_limit_m_s: float = 25.0
    """Axial climb speed through the air at which a rotor's linearly falling thrust reaches zero."""

    motor_rise_s: float = 0.0125
    """Time constant of the rotor's speed while it rises."""
    motor_fall_s: float = 0.025
    armed_speed_rad_s: float = 100.0
    """Rotor speed at control 0 while armed."""
    control_speed_rad_s: float = 1000.0
    """Rotor speed that a control of 1 adds."""

    @property
    def standing_height_m(self) -> float:
        """Height of the centre of mass above the ground of a landed vehicle."""
        return self.box_m[2] / 2.0


IRIS = VehicleModel()
