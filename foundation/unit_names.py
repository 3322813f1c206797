"""Units and frames that names state: ``vel_ned_m_s`` is in m/s, in the frame NED."""

UNITS = {
    "m_sqrt_s": "m/√s", "gauss": "gauss", "rad_s": "rad/s", "m_s2": "m/s²", "m_s": "m/s", "s_m": "S/m",
    "bytes_s": "byte/s", "bytes": "byte", "lambda": "wavelength", "fraction": "1", "dbm": "dBm", "dbi": "dBi",
    "db": "dB", "deg": "°", "rad": "rad", "mhz": "MHz", "khz": "kHz", "hz": "Hz", "ppm": "ppm", "ps": "ps",
    "ns": "ns", "us": "µs", "ms": "ms", "mbps": "Mbit/s", "s": "s", "m": "m", "n": "N", "k": "K",
    "n_s_m": "N s/m", "n_s2_m": "N s²/m", "n_s2": "N s²", "kg_m2": "kg m²", "kg": "kg", "ohm": "Ω",
    "mah": "mAh",
}  # fmt: skip
"""By the end of a name, the longest ends first."""
FRAMES = {"ned": "NED", "frd": "FRD"}


def unit_of(name: str) -> str:
    """Return the unit that a name's end states; empty without one. A name that is only a unit has none."""
    words = name.split("_")
    for count in range(min(3, len(words) - 1), 0, -1):
        if (unit := UNITS.get("_".join(words[-count:]))) is not None:
            return unit
    return ""


def frame_of(name: str) -> str:
    """Return the frame that a name states, of a quaternion both; empty without one."""
    frames = [FRAMES[word] for word in name.split("_") if word in FRAMES]
    return " to ".join(reversed(frames))
