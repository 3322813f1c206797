"""Scenario and campaign files that come with coflight, found by name: ``article``, ``campaigns/wind``."""

from pathlib import Path

FOLDER = Path(__file__).parents[2] / "scenarios"
"""Beside the packages, in a checkout as in an installation."""


def find(path: str | Path, *, root: Path = Path()) -> Path:
    """Return the path of a scenario file, which may be named instead: ``article`` is scenarios/article.toml.

    Relative paths are below ``root``. A file at the path has precedence over a packaged one; without either,
    the path below ``root`` is returned.
    """
    named, own = Path(path), root / path
    if not named.name or named.suffix or named.is_absolute() or ".." in named.parts or own.is_file():
        return own
    packaged = FOLDER / named.with_name(f"{named.name}.toml")
    return packaged if packaged.is_file() else own


def names() -> list[str]:
    """Return the names that `find` accepts, in order: scenarios, then ``campaigns/`` and theirs."""
    paths = sorted(FOLDER.glob("*.toml")) + sorted(FOLDER.glob("*/*.toml"))
    return [path.relative_to(FOLDER).with_suffix("").as_posix() for path in paths]
