"""The page of parameters against the table from which it is generated."""

import pytest
from paths import ROOT

from autopilot.parameters.parameter_docs import markdown, meaning
from autopilot.parameters.table import TABLE

PAGE = ROOT / "docs" / "reference" / "parameters.md"


def test_the_page_is_up_to_date():
    assert PAGE.read_text() == markdown(), "run scripts/list_parameters.py > docs/reference/parameters.md"


@pytest.mark.parametrize("parameter", TABLE, ids=[parameter.name for parameter in TABLE])
def test_every_parameter_has_a_row_and_a_meaning(parameter):
    assert f"| {parameter.name} |" in markdown()
    text = meaning(parameter)
    assert len(text) > 2
    assert parameter.name not in text
