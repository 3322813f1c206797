"""Colours of the scene: one for each vehicle, and one for each outcome of a frame."""

from harness.export.messages import Content

_PALETTE = (
    (0.12, 0.47, 0.71), (1.00, 0.50, 0.05), (0.17, 0.63, 0.17), (0.58, 0.40, 0.74), (0.55, 0.34, 0.29),
    (0.89, 0.47, 0.76), (0.74, 0.74, 0.13), (0.09, 0.75, 0.81),
)  # fmt: skip
"""Without red and grey, which are those of a failsafe and of a lost vehicle."""
FAILSAFE: Content = {"r": 0.84, "g": 0.15, "b": 0.16, "a": 1.0}
LOST: Content = {"r": 0.45, "g": 0.45, "b": 0.45, "a": 1.0}
DELIVERED: Content = {"r": 0.20, "g": 0.80, "b": 0.30, "a": 0.6}
RANGING: Content = {"r": 0.10, "g": 0.65, "b": 0.95, "a": 0.8}
PARTLY: Content = {"r": 0.95, "g": 0.85, "b": 0.10, "a": 0.8}
NOISE: Content = {"r": 1.00, "g": 0.55, "b": 0.00, "a": 0.9}
COLLIDED: Content = {"r": 0.90, "g": 0.10, "b": 0.10, "a": 0.9}
WIND: Content = {"r": 0.55, "g": 0.75, "b": 1.00, "a": 0.9}
PLACE: Content = {"r": 0.60, "g": 0.60, "b": 0.60, "a": 0.35}


def of_vehicle(uav: int, *, alpha: float = 1.0) -> Content:
    """Return the colour of a vehicle."""
    r, g, b = _PALETTE[uav % len(_PALETTE)]
    return {"r": r, "g": g, "b": b, "a": alpha}
