"""The page of parameters against the table that it is made from."""

import pytest
from paths import ROOT

from autopilot.parameters.parameter_docs import markdown, meaning
from autopilot.parameters.table import TABLE

PAGE = ROOT / "docs" / "reference" / "parameters.md"


def test_the_page_is_the_one_that_the_script_makes():
    assert PAGE.read_text() == markdown(), "run scripts/list_parameters.py > docs/reference/parameters.md"


@pytest.mark.parametrize("parameter", TABLE, ids=[parameter.name for parameter in TABLE])
def test_every_parameter_has_a_row_and_says_what_it_is(parameter):
    assert f"| {parameter.name} |" in markdown()
    said = meaning(parameter)
    assert len(said) > 2
    assert parameter.name not in said
