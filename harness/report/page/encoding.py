"""Data of a page: JSON that no text in it can leave, arrays in Plotly's packed form, texts in its figures."""

import base64
import math
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

_NAMES = {
    np.dtype("f4"): "f4", np.dtype("f8"): "f8", np.dtype("i1"): "i1", np.dtype("u1"): "u1",
    np.dtype("i2"): "i2", np.dtype("u2"): "u2", np.dtype("i4"): "i4", np.dtype("u4"): "u4",
}  # fmt: skip
"""Types of the packed arrays that Plotly decodes, without 64-bit integers"""


def packed(values: NDArray[Any]) -> dict[str, str]:
    """Return an array as Plotly's typed array: the name of its type, its bytes in base64, and its shape.

    Raises KeyError for a type that Plotly does not have.
    """
    values = np.ascontiguousarray(values)
    content = {"dtype": _NAMES[values.dtype], "bdata": base64.b64encode(values.data).decode("ascii")}
    if values.ndim > 1:
        content["shape"] = ", ".join(map(str, values.shape))
    return content


def singles(values: NDArray[Any]) -> dict[str, str]:
    """Return numbers as packed single precision, enough for a figure."""
    return packed(values.astype(np.float32))


def plot_text(text: object) -> str:
    """Return a text so that Plotly, which reads some HTML tags in texts, shows it as it is.

    A sequence for a number format (``%{...}``) is broken too.
    """
    escaped = str(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return escaped.replace("%{", "% {")


def script_json(content: Mapping[str, Any]) -> str:
    """Return JSON for an HTML element ``script``: without ``<``, ``>``, ``&`` and line separators.

    Numbers that are not finite become null.
    """
    text = msgspec.json.encode(_finite(content)).decode()
    for letter in "<>&\u2028\u2029":
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return text


def _finite(value: Any) -> Any:  # noqa: ANN401  any content of JSON
    match value:
        case float():
            return value if math.isfinite(value) else None
        case dict():
            return {key: _finite(each) for key, each in value.items()}
        case list() | tuple():
            return [_finite(each) for each in value]
        case np.generic():
            return _finite(value.item())
        case _:
            return value
