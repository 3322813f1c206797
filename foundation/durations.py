"""Durations as text for displays."""


def duration_text(seconds: float | None) -> str:
    """Return ``3 h 05 min``, ``4 min 10 s``, ``9 s``, or ``?`` if unknown."""
    if seconds is None:
        return "?"
    whole = round(seconds)
    if whole >= 3600:
        return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
    return f"{whole // 60} min {whole % 60:02d} s" if whole >= 60 else f"{whole} s"
