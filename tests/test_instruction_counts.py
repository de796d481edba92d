"""No call of the native core needs more instructions than recorded. See instruction_counts/."""

from __future__ import annotations

import warnings

import pytest

import instruction_counts as ic


@pytest.mark.slow
def test_no_call_needs_more_instructions(tmp_path):
    if reason := ic.missing():
        pytest.skip(reason)
    before = ic.recorded()
    if ic.builder() != before["builder"]:
        pytest.skip(f"the library was made by {ic.builder()}, the recorded counts are of {before['builder']}")
    grown, shrunk = ic.changes(ic.measure(tmp_path), before["counts"])
    if shrunk:
        warnings.warn(
            "fewer instructions; record them: " + ic.HOW_TO_RECORD + "\n" + "\n".join(shrunk), stacklevel=1
        )
    assert not grown, "\n".join(
        ["more instructions than recorded. If they are worth it: " + ic.HOW_TO_RECORD, *grown]
    )


def test_changes_beyond_the_tolerance_are_told():
    before = {"a": 1000, "b": 1000, "c": 1000, "d": 1000}
    grown, shrunk = ic.changes({"a": 1031, "b": 1029, "c": 969, "e": 5}, before)
    assert grown == [
        "e: 5 instructions, not recorded before",
        "a: 1,031 instructions, +3.1% against the 1,000 recorded",
    ]
    assert shrunk == ["c: 969 instructions, -3.1% against the 1,000 recorded"]
