"""The error of warm-ups, which run every kernel of a package once so that all are compiled and cached."""


class WarmUpError(RuntimeError):
    """A warm-up did not have the expected results; the text is one line."""
