"""Errors of the operating system as text for users: file and cause, without the number."""

import os


def in_words(error: OSError) -> str:
    """Return the file of an error, if it has one, and its cause, as one line."""
    is_number_of_system = type(error).__module__ == "builtins" and error.errno is not None and error.errno > 0
    # a library may put its own text, with the number, in the place of the cause
    words = (
        os.strerror(error.errno or 0)
        if is_number_of_system
        else error.strerror or str(error) or type(error).__name__
    )
    return f"{error.filename}: {words}" if error.filename else words
