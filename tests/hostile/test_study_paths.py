"""Hostile files, each handed to every option of every study that takes a path."""

import pytest

from .paths import OPTIONS, demand_no_harm

STUDIES = [option for option in OPTIONS if option[0].startswith("evaluate")]


@pytest.mark.parametrize(("name", "option", "variant"), STUDIES, ids=str)
def test_no_study_is_hurt_by_a_hostile_file(hostile, fork, name, option, variant):
    demand_no_harm(hostile, fork, name, option, variant)
