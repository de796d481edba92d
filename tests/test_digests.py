"""Every call of the native core gives the bits that are recorded, on any number of threads. See digests/."""

from __future__ import annotations

import pytest

import digests
from svrgs_addon.native import library


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    return digests.build(tmp_path_factory.mktemp("digests"))


@pytest.mark.slow
@pytest.mark.parametrize("level", digests.RECORDED_LEVELS)
def test_levels_that_are_the_same_everywhere_give_what_is_recorded(program, level):
    if level not in library.supported_levels():
        pytest.skip(f"this processor has no {level}")
    assert not digests.differences(digests.lines(program, level), digests.recorded(level))


@pytest.mark.slow
@pytest.mark.parametrize(
    "level", [level for level in library.supported_levels() if level not in digests.RECORDED_LEVELS]
)
def test_other_levels_give_the_same_on_one_thread_and_on_three(program, level):
    assert len(digests.lines(program, level)) == len(digests.recorded("scalar"))


def test_lines_that_differ_are_told():
    assert digests.differences(["a 1", "b 2"], ["a 1", "b 3"]) == ["- b 3", "+ b 2"]
