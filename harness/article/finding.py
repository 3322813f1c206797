"""What measuring a statement gives."""

from msgspec import Struct


class Finding(Struct, frozen=True, kw_only=True):
    """Numbers as text, and whether they meet the criterion."""

    found: str
    agrees: bool
    why: str = ""
    """Why not, backed by numbers; read where it does not agree."""
