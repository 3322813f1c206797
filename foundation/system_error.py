"""Errors as text for users: of the operating system without their numbers."""

import os


def in_words(error: OSError) -> str:
    """Return the file of an error, if it has one, and its cause, as one line."""
    words = error.strerror or str(error) or type(error).__name__
    # a library may put its own text, with the number, in the place of the cause
    if type(error).__module__ == "builtins" and (error.errno or 0) > 0:
        words = os.strerror(error.errno or 0)
    return f"{error.filename}: {words}" if error.filename else words


def described(error: BaseException) -> str:
    """Return one line of any error: `in_words`, or its type and the first line of its text."""
    if isinstance(error, OSError):
        return in_words(error)
    return f"{type(error).__name__}: {error}".splitlines()[0].rstrip(": ")
