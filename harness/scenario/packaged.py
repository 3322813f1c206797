"""Scenario and campaign files that come with coflight, found by name: ``article``, ``campaigns/wind``."""

from pathlib import Path

FOLDER = Path(__file__).parents[2] / "scenarios"
"""Beside the packages, in a checkout as in an installation."""


def find(path: str | Path) -> Path:
    """Return the path of a scenario file, which may be named instead: ``article`` is scenarios/article.toml.

    A file of the user's at that path has precedence. Without either, the path itself is returned.
    """
    own = Path(path)
    if not own.name or own.suffix or own.is_absolute() or ".." in own.parts or own.is_file():
        return own
    packaged = FOLDER / own.with_name(f"{own.name}.toml")
    return packaged if packaged.is_file() else own


def names() -> list[str]:
    """Return the names that `find` accepts, in order: scenarios, then ``campaigns/`` and theirs."""
    paths = sorted(FOLDER.glob("*.toml")) + sorted(FOLDER.glob("*/*.toml"))
    return [path.relative_to(FOLDER).with_suffix("").as_posix() for path in paths]
