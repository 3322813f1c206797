"""The failure of the user's code in flight: an exception that it raises, or a wrong value that it returns.

The vehicle on which it fails is lost, and the others continue. The text is one line for the user; the cause,
with its traceback, is for the vehicle's log.
"""

import traceback
from pathlib import Path

MOST_CHARACTERS = 300
"""Of the user's own text in a line."""
_OWN = tuple(
    f"{Path(__file__).parents[1] / package}/" for package in ("autopilot", "coflight", "foundation", "netsim")
)
"""Folders of coflight's code that the user's code calls."""


class ExtensionFailure(Exception):
    """Code of the user has failed; the text is one line that begins with the scenario's field."""


def failure(title: str, error: BaseException) -> ExtensionFailure:
    """Return the failure for an exception that the user's code has raised.

    ``title`` names the code, such as ``autopilot.controller my_package.control:Lqr``. The line ends with the
    place where the exception was raised, or in the user's code where coflight refused an argument.
    """
    frames = traceback.extract_tb(error.__traceback__)
    last = next((frame for frame in reversed(frames) if not frame.filename.startswith(_OWN)), frames[-1])
    text = " ".join(f"{type(error).__name__}: {error}".split())[:MOST_CHARACTERS]
    return ExtensionFailure(f"{title}: {text} ({last.filename}:{last.lineno})")
