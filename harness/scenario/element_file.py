"""``antenna.element_file``: the NEC deck of a scenario's antenna element, read once and checked."""

from pathlib import Path
from typing import Any

from antenna.model.deck import DeckError, read_element
from foundation.text_file import TextFileError, read_text


class ElementFileError(ValueError):
    """An invalid deck; the text is one line that names file and line."""


def with_deck(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Store the contents of ``element_file``, a path relative to the folder, in ``element_deck``.

    The table is not validated yet: other types than a path, and files for other kinds of elements, are left
    to the later validation. Raises ElementFileError.
    """
    file = table.get("element_file")
    if table.get("element_kind") != "deck" or not isinstance(file, str) or not file:
        return table
    path = folder / file
    try:
        text = read_text(path)
    except TextFileError as error:
        raise ElementFileError(str(error)) from None
    try:
        read_element(text)
    except DeckError as error:
        raise ElementFileError(f"{path}: {error}") from None
    return {**table, "element_deck": text}
