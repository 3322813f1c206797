"""The user's code is loaded by name; each error is one line with the field and what is expected instead."""

import sys
from dataclasses import dataclass, field
from typing import Annotated

import msgspec
import pytest

from foundation.extensions import ExtensionError, convert, is_path, load, registered


@dataclass(frozen=True)
class Point:
    x_m: float
    label: str = ""

    def __post_init__(self):
        if self.x_m < 0:
            raise ValueError("x_m is negative")


@dataclass(frozen=True)
class Settings:
    exponent: Annotated[float, msgspec.Meta(gt=0.0)]
    points: list[Point] = field(default_factory=list)
    first: Point | None = None


class StructSettings(msgspec.Struct, frozen=True):
    exponent: float
    points: tuple[Point, ...] = ()


class Unsupported(msgspec.Struct):
    x: "no_such_type"  # noqa: F821


VALID = {"exponent": 1}
WITH_Y = {"x_m": 1, "y": 2}


@pytest.fixture
def folder(tmp_path):
    """Return a folder of modules; what they load is removed from ``sys.modules`` afterwards."""
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        del sys.modules[name]


def write(folder, name, text):
    (folder / name).write_text(text)


def refusal(path, **options):
    with pytest.raises(ExtensionError) as caught:
        load(path, field="radio.path_loss", **options)
    text = str(caught.value)
    assert text.startswith("radio.path_loss: ")
    assert "\n" not in text
    return text


def test_a_name_of_a_module_is_loaded_and_also_one_within_a_class():
    assert load("foundation.extensions:ExtensionError", field="x") is ExtensionError
    assert load("collections:OrderedDict.fromkeys", field="x")("a") == {"a": None}


@pytest.mark.parametrize(
    "path", ["", "friis", "a.b", "a:b:c", "a.b:", ":b", "a b:c", "a/b.py:C", "1a:b", ".a:b"]
)
def test_other_forms_are_no_paths(path):
    assert not is_path(path)
    assert refusal(path).endswith(f"{path!r} is no path of code; expected package.module:Name")


def test_modules_of_a_folder_are_found_only_if_it_is_searched_and_it_comes_first(folder):
    write(folder, "ext_first.py", "VALUE = 'of the folder'")
    before = list(sys.path)
    assert "no module ext_first; expected it to be installed" in refusal("ext_first:VALUE")
    assert load("ext_first:VALUE", field="x", search=folder) == "of the folder"
    assert sys.path == before


def test_another_loaded_module_of_the_same_name_is_refused_instead_of_used(folder):
    (folder / "a").mkdir()
    (folder / "b").mkdir()
    write(folder / "a", "ext_twice.py", "VALUE = 'a'")
    write(folder / "b", "ext_twice.py", "VALUE = 'b'")
    assert load("ext_twice:VALUE", field="x", search=folder / "a") == "a"
    assert load("ext_twice:VALUE", field="x", search=folder / "a") == "a"
    text = refusal("ext_twice:VALUE", search=folder / "b")
    assert str(folder / "a" / "ext_twice.py") in text
    assert str(folder / "b" / "ext_twice.py") in text


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("import ext_absent", "ext_bad.py:1: ModuleNotFoundError: No module named 'ext_absent'"),
        ("\nraise KeyError('key')", "ext_bad.py:2: KeyError: 'key'"),
        ("raise ValueError('one\\ntwo')", "ValueError: one two"),
        ("x = (", "ext_bad.py:1: SyntaxError: '(' was never closed"),
        ("raise SystemExit(3)", "ext_bad.py:1: SystemExit: 3"),
    ],
)
def test_an_exception_of_the_import_is_named_with_its_line(folder, source, expected):
    write(folder, "ext_bad.py", source)
    text = refusal("ext_bad:Name", search=folder)
    assert "import of ext_bad failed at " in text
    assert expected in text


def test_a_missing_name_is_reported_with_the_similar_one(folder):
    write(folder, "ext_names.py", "class MyModel: pass")
    text = refusal("ext_names:MyModle", search=folder)
    assert text.endswith("ext_names.py) has no MyModle; did you mean ext_names:MyModel?")


def test_a_missing_submodule_is_not_mistaken_for_an_error_of_the_package():
    assert "no module foundation.no_such" in refusal("foundation.no_such:Name")


@pytest.mark.parametrize("kind", [Settings, StructSettings])
def test_settings_become_an_object_of_the_type(kind):
    converted = convert({"exponent": 3, "points": [{"x_m": 1.5, "label": "a"}]}, kind, field="s")
    assert isinstance(converted, kind)
    assert converted.exponent == 3.0
    assert list(converted.points) == [Point(1.5, "a")]


@pytest.mark.parametrize(
    ("kind", "settings", "expected"),
    [
        (Settings, {"exponent": "2"}, "s.exponent: expected `float`, got `str`"),
        (Settings, {"exponent": 0}, "s.exponent: expected `float` > 0.0"),
        (Settings, {}, "s: missing key `exponent`"),
        (Settings, {"exponent": 1, "exponnent": 2}, "s: unknown key `exponnent`; did you mean `exponent`?"),
        (StructSettings, {"exponent": 1, "k": 2}, "s: unknown key `k`; expected exponent, points"),
        (Settings, {**VALID, "points": [{"x_m": 1}, {}]}, "s.points[1]: missing key `x_m`"),
        (Settings, {**VALID, "points": [WITH_Y]}, "s.points[0]: unknown key `y`; expected x_m, label"),
        (Settings, {**VALID, "first": WITH_Y}, "s.first: unknown key `y`; expected x_m, label"),
        (Settings, {**VALID, "points": [{"x_m": -1}]}, "s.points[0]: x_m is negative"),
        (dict, {}, "s: dict is no type of settings; expected a msgspec Struct or a dataclass"),
        (Unsupported, {"x": 1}, "s: Unsupported is no type of settings: name 'no_such_type' is not defined"),
    ],
)  # fmt: skip
def test_wrong_settings_are_one_line_with_the_path(kind, settings, expected):
    with pytest.raises(ExtensionError) as caught:
        convert(settings, kind, field="s")
    assert str(caught.value) == expected


def install(folder, name, points):
    """Write the metadata of a distribution with entry points."""
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[coflight.test]\n{points}\n")


def test_entry_points_of_installed_distributions_are_listed(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    assert registered("coflight.test") == {}
    install(tmp_path, "one", "a.model = one.models:Model\nb = one.models:Outer.Inner")
    install(tmp_path, "two", "a.model = one.models:Model")
    assert registered("coflight.test") == {"a.model": "one.models:Model", "b": "one.models:Outer.Inner"}


def test_two_distributions_may_not_give_different_code_the_same_name(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    install(tmp_path, "one", "model = one.models:Model")
    install(tmp_path, "two", "model = two.models:Model")
    with pytest.raises(ExtensionError) as caught:
        registered("coflight.test")
    assert str(caught.value) == (
        "entry points coflight.test: model is one.models:Model in the distribution one and two.models:Model "
        "in two; expected one of them to be uninstalled"
    )
