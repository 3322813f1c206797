"""The option ``--out`` of commands that write a folder."""

from pathlib import Path

import typer


def out_folder(text: str) -> Path:
    """Return the folder. An empty text, as of a variable that is not set, is not the working folder.

    Raises typer.BadParameter.
    """
    if not text:
        raise typer.BadParameter("it is empty and names no folder; leave it out for the default one")
    return Path(text)
