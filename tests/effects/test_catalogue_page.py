"""Every effect says where it does not occur and what imitates it; the page is what the classes say."""

import importlib.util
from pathlib import Path

import pytest

from isetval.effects import catalogue

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", list(catalogue()))
def test_effect_says_where_it_is_absent_and_what_imitates_it(name):
    cls = catalogue()[name]
    assert cls.absent
    assert cls.imitated_by
    assert set(cls.imitated_by) <= set(catalogue()) - {name}


def test_the_page_is_current():
    spec = importlib.util.spec_from_file_location("catalogue_page", ROOT / "analyses" / "catalogue_page.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    assert script.PAGE.read_text() == script.page(), "python analyses/catalogue_page.py"
