"""Loads the user's code by name, and converts its settings; an error is one line that begins with the field.

A class or function is named ``package.module:Name``, as in entry points of distributions. Settings are a
table of the scenario; their type is the user's, a msgspec Struct or a dataclass.
"""

import difflib
import importlib
import re
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import is_dataclass
from importlib.machinery import PathFinder
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import TypeVar

import msgspec

T = TypeVar("T")

_PATH = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*(\.[^\W\d]\w*)*")
_REPLACEMENTS = {
    "Object missing required field": "missing key",
    "Expected": "expected",
    "Invalid": "invalid",
    " | null`": "`",
}
"""In msgspec's texts. TOML has no null: an optional field is omitted."""


CHECK_LIMIT_S = 30.0
"""Wall time in which code of the user must return while a scenario is read."""


class ExtensionError(ValueError):
    """Code of the user cannot be loaded, or its settings are wrong; the text is one line with the field."""


def is_path(text: str) -> bool:
    """Whether a text has the form ``package.module:Name``."""
    return _PATH.fullmatch(text) is not None


def load(path: str, *, field: str, search: Path | None = None) -> object:
    """Import a module and return its object of a name.

    Args:
        path: ``package.module:Name``; the name may have dots, for a class within a class.
        field: Path of the scenario's field, with which the text of an error begins.
        search: Folder where modules are looked up first, such as that of a scenario. It is in ``sys.path``
            during this call only, so a module there imports its neighbours at its top, not in functions.

    Raises ExtensionError: the path has another form, there is no such module, the module raises an exception,
    it has no such name, or another file of this name is already loaded.
    """
    if not is_path(path):
        raise ExtensionError(f"{field}: {path!r} is no path of code; expected package.module:Name")
    module_name, _, name = path.partition(":")
    with _first_in_path(search):
        if search is not None:
            _check_loaded(module_name, search, field)
        module = _import(module_name, field, search)
    found: object = module
    for part in name.split("."):
        try:
            found = getattr(found, part)
        except AttributeError:
            names = [each for each in vars(module) if not each.startswith("_")]
            meant = difflib.get_close_matches(name, names, 1)
            hint = f"; did you mean {module_name}:{meant[0]}?" if meant else ""
            raise ExtensionError(f"{field}: {module_name} ({_file_of(module)}) has no {name}{hint}") from None
    return found


@contextmanager
def _first_in_path(folder: Path | None) -> Iterator[None]:
    """Put a folder at the beginning of ``sys.path`` meanwhile."""
    if folder is None:
        yield
        return
    entry = str(folder.resolve())
    sys.path.insert(0, entry)
    importlib.invalidate_caches()  # the file may be newer than the last look at its folder
    try:
        yield
    finally:
        if entry in sys.path:
            sys.path.remove(entry)


def _check_loaded(module_name: str, search: Path, field: str) -> None:
    """Check that a module that is already loaded is the one in ``search``, if there is one."""
    first = module_name.partition(".")[0]
    loaded = sys.modules.get(first)
    there = PathFinder.find_spec(first, [str(search.resolve())]) if loaded is not None else None
    if loaded is None or there is None or there.origin is None:
        return
    if getattr(loaded, "__file__", None) != there.origin:
        raise ExtensionError(
            f"{field}: the module {first} of {there.origin} has the name of another one that is loaded, "
            f"{_file_of(loaded)}; expected a name of its own"
        )


def _import(module_name: str, field: str, search: Path | None) -> ModuleType:
    try:
        return importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        missing = str(error.name)
        if module_name == missing or module_name.startswith(f"{missing}."):
            there = "to be" if search is None else f"in {search.resolve()},"
            raise ExtensionError(
                f"{field}: no module {missing}; expected it {there} installed, or its folder in PYTHONPATH"
            ) from None
        raise _import_error(module_name, error, field) from error
    except (Exception, SystemExit) as error:
        raise _import_error(module_name, error, field) from error


def _import_error(module_name: str, error: BaseException, field: str) -> ExtensionError:
    """Return the line for an exception that a module raised while it was imported."""
    if isinstance(error, SyntaxError):
        where, reason = f"{error.filename}:{error.lineno}", error.msg
    else:
        last = traceback.extract_tb(error.__traceback__)[-1]
        where, reason = f"{last.filename}:{last.lineno}", str(error)
    text = " ".join(f"{type(error).__name__}: {reason}".split())
    return ExtensionError(f"{field}: import of {module_name} failed at {where}: {text}")


def _file_of(module: ModuleType) -> str:
    return getattr(module, "__file__", None) or "built in"


def convert(settings: Mapping[str, object], kind: type[T], *, field: str) -> T:
    """Return a table as settings of a type.

    Args:
        settings: Values of TOML or JSON by field.
        kind: A msgspec Struct or a dataclass. Its constraints (``Annotated[float, msgspec.Meta(gt=0)]``) and
            the ValueErrors of its ``__post_init__`` are checked. Unknown keys are refused in either.
        field: Path of the table, such as ``radio.path_loss.settings``, before the path within the table.

    Raises ExtensionError: a value is wrong, missing or unknown, or ``kind`` is no type of settings.
    """
    if not (issubclass(kind, msgspec.Struct) or is_dataclass(kind)):
        raise ExtensionError(
            f"{field}: {kind.__qualname__} is no type of settings; expected a msgspec Struct or a dataclass"
        )
    try:
        if unknown := next(_unknown(settings, msgspec.inspect.type_info(kind), field), None):
            raise ExtensionError(unknown)
        return msgspec.convert(settings, kind)
    except msgspec.ValidationError as error:
        raise ExtensionError(_line(str(error), field)) from None
    except (TypeError, NameError) as error:  # an annotation that msgspec does not support
        raise ExtensionError(f"{field}: {kind.__qualname__} is no type of settings: {error}") from None


def _line(text: str, field: str) -> str:
    """Return ``field.x: expected `float``` for ``Expected `float` - at `$.x```."""
    reason, at, where = text.rpartition(" - at `$")
    reason = reason if at else text
    for original, replacement in _REPLACEMENTS.items():
        reason = reason.replace(original, replacement)
    return f"{field}{where.rstrip('`') if at else ''}: {reason}"


def _unknown(value: object, kind: msgspec.inspect.Type, path: str) -> Iterator[str]:
    """Yield a line for each key of nested tables that is no field; msgspec accepts those of dataclasses."""
    match kind, value:
        case msgspec.inspect.Metadata(type=inner), _:
            yield from _unknown(value, inner, path)
        case msgspec.inspect.UnionType(types=(inner, msgspec.inspect.NoneType())), _:
            yield from _unknown(value, inner, path)
        case ((msgspec.inspect.StructType() | msgspec.inspect.DataclassType()), Mapping()):
            fields = {each.encode_name: each.type for each in kind.fields}
            tag = getattr(kind, "tag_field", None)
            for key, inner_value in value.items():
                if key in fields:
                    yield from _unknown(inner_value, fields[key], f"{path}.{key}")
                elif key != tag:
                    meant = difflib.get_close_matches(str(key), fields, 1)
                    names = ", ".join(fields) or "no keys"
                    hint = f"did you mean `{meant[0]}`?" if meant else f"expected {names}"
                    yield f"{path}: unknown key `{key}`; {hint}"
        case ((msgspec.inspect.ListType() | msgspec.inspect.VarTupleType()), list() | tuple()):
            for number, inner_value in enumerate(value):
                yield from _unknown(inner_value, kind.item_type, f"{path}[{number}]")
        case msgspec.inspect.DictType(value_type=inner), Mapping():
            for key, inner_value in value.items():
                yield from _unknown(inner_value, inner, f"{path}.{key}")
        case _:
            pass


def check_bounded(check: Callable[[], object], title: str, *, limit_s: float = CHECK_LIMIT_S) -> None:
    """Call a check of the user's code, and raise its exception.

    Raises ExtensionError, which begins with ``title``, if the check does not return within ``limit_s`` of
    wall time; its thread then continues until the process ends.
    """
    outcome: list[BaseException | None] = []

    def run() -> None:
        try:
            check()
            outcome.append(None)
        except BaseException as error:  # noqa: BLE001  raised in the caller's thread
            outcome.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(limit_s)
    if not outcome:
        raise ExtensionError(f"{title} does not return; it was given {limit_s:g} s of wall time")
    if outcome[0] is not None:
        raise outcome[0]


def registered(group: str) -> dict[str, str]:
    """Return the entry points of a group of the installed distributions: ``package.module:Name`` by name.

    Raises ExtensionError if two distributions give different code the same name.
    """
    found: dict[str, tuple[str, str]] = {}
    for point in sorted(entry_points(group=group), key=lambda each: (each.name, each.value)):
        path = f"{point.module}:{point.attr}"
        distribution = point.dist.name if point.dist is not None else "?"
        before, other = found.setdefault(point.name, (path, distribution))
        if before != path:
            raise ExtensionError(
                f"entry points {group}: {point.name} is {before} in the distribution {other} and {path} in "
                f"{distribution}; expected one of them to be uninstalled"
            )
    return {name: path for name, (path, _) in found.items()}
