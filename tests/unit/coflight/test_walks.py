"""The walks of docs/concepts/walks.md: their files and functions exist, and no walk is long or returns."""

import ast
import re

import pytest
from paths import ROOT

PAGE = (ROOT / "docs" / "concepts" / "walks.md").read_text(encoding="utf-8")
MOST_HOPS = 12
PLACE = re.compile(r"`([\w/]+\.py)`[ \n]`([\w.]+)`")
WALKS = dict(re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL))


def hops(walk: str) -> list[tuple[int, str, str]]:
    """Return number, file and function of each row of a walk's table."""
    rows = re.findall(r"^\| (\d+) \| `(.+?)` \| `(.+?)` \| .+ \|$", walk, re.MULTILINE)
    return [(int(number), file, function) for number, file, function in rows]


def defined(file: str) -> set[str]:
    """Return the classes, functions and methods of a file."""
    names = set()
    for node in ast.parse((ROOT / file).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef):
            methods = (each.name for each in node.body if isinstance(each, ast.FunctionDef))
            names |= {node.name, *(f"{node.name}.{method}" for method in methods)}
        elif isinstance(node, ast.FunctionDef):
            names.add(node.name)
    return names


def test_there_are_four_walks():
    assert [title for title, walk in WALKS.items() if hops(walk)] == [
        "A sensor sample", "A beacon", "A scenario field", "A parameter change"
    ]  # fmt: skip


@pytest.mark.parametrize("title", WALKS)
def test_a_walk_is_short_and_enters_no_file_twice(title):
    walk = hops(WALKS[title])
    files = [file for _, file, _ in walk]
    assert [number for number, _, _ in walk] == list(range(1, len(walk) + 1))
    assert 2 <= len(walk) <= MOST_HOPS
    assert len(set(files)) == len(files)


@pytest.mark.parametrize("title", WALKS)
def test_every_file_and_function_exists(title):
    walk = WALKS[title]
    places = [(file, function) for _, file, function in hops(walk)] + PLACE.findall(walk)
    assert places
    missing = [(file, function) for file, function in places if function not in defined(file)]
    assert missing == []


@pytest.mark.parametrize("title", WALKS)
def test_the_diagram_has_every_hop(title):
    walk = WALKS[title]
    drawn = sorted(int(number) for number in re.findall(r"\[\"(\d+) ", walk))
    assert drawn == [number for number, _, _ in hops(walk)]
