"""Docstrings of fields: the string literals that follow them in the source of a class."""

import ast
import inspect
import sys

_READ: dict[str, dict[str, dict[str, str]]] = {}
"""What has been read already, by module and class: sources do not change while a program runs."""


def field_docstrings(kind: type) -> dict[str, str]:
    """Return the docstrings of the fields of a class and of its bases, by name; empty without the source."""
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        texts |= _of_module(base.__module__).get(base.__name__, {})
    return texts


def _of_module(name: str) -> dict[str, dict[str, str]]:
    if name not in _READ:
        try:
            source = inspect.getsource(sys.modules[name])
        except (OSError, TypeError):  # not delivered, or built in
            source = ""
        classes = (node for node in ast.parse(source).body if isinstance(node, ast.ClassDef))
        _READ[name] = {node.name: _of_class(node) for node in classes}
    return _READ[name]


def _of_class(definition: ast.ClassDef) -> dict[str, str]:
    texts = {}
    for before, after in zip(definition.body, definition.body[1:], strict=False):
        if isinstance(before, ast.AnnAssign) and isinstance(before.target, ast.Name):
            match after:
                case ast.Expr(value=ast.Constant(value=str(text))):
                    texts[before.target.id] = text
    return texts
