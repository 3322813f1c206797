"""Airframe files: packaged ones by name, the user's by path."""

import tomllib
from pathlib import Path

from foundation.airframe.description import Airframe
from foundation.extensions import ExtensionError, convert
from foundation.text_file import TextFileError, read_text

FOLDER = Path(__file__).parents[2] / "airframes"
"""Beside the packages, in a checkout as in an installation."""
SUFFIX = ".toml"
DEFAULT = "iris"


class AirframeError(ValueError):
    """An airframe that does not exist, or is wrong; the text is one line that names file and field."""


def names() -> tuple[str, ...]:
    """Return the names of the packaged airframes, in order."""
    return tuple(sorted(path.stem for path in FOLDER.glob(f"*{SUFFIX}")))


def is_path(airframe: str) -> bool:
    """Return whether an airframe is given by its file instead of a packaged name."""
    return airframe.endswith(SUFFIX)


def load(airframe: str, folder: Path = Path()) -> Airframe:
    """Read a packaged airframe, ``x500``, or a file, ``my/hexa.toml``, relative to a folder.

    Raises AirframeError.
    """
    if is_path(airframe):
        return read(folder / airframe)
    if airframe not in names():
        raise AirframeError(
            f"there is no airframe {airframe!r}; expected one of {', '.join(names())}, or a file (.toml)"
        )
    return read(FOLDER / f"{airframe}{SUFFIX}")


def read(path: Path) -> Airframe:
    """Read an airframe file. Raises AirframeError."""
    try:
        table = tomllib.loads(read_text(path))
        return convert(table, Airframe, field="")
    except tomllib.TOMLDecodeError as error:
        raise AirframeError(f"{path}: not TOML: {error}") from None
    except TextFileError as error:
        raise AirframeError(str(error)) from None
    except ExtensionError as error:
        raise AirframeError(f"{path}: {str(error).lstrip('.: ')}") from None


IRIS = load(DEFAULT)
"""The airframe of vehicles for which none is named."""
