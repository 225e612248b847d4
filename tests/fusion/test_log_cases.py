"""Logs as people have them: each is right as it is, or is refused in one line whose remedy leads there."""

from __future__ import annotations

from pathlib import Path

import pytest

from fusion.flight import Flight
from fusion.inspection.advice import Matter
from fusion.inspection.log import Inspection
from fusion.inspection.sources import inspect_path
from fusion.logs import load_flight
from tests.fusion.log_cases import Part, judge, lead
from tests.fusion.log_cases_bags import CASES as BAGS
from vision import InputError

pytest.importorskip("rosbags")

CASES = BAGS


@pytest.fixture(scope="module")
def parts(office: Flight) -> dict[bool, Part]:
    """The part of the flight, with few frames and with all of them."""
    return {False: Part.of(office, 2), True: Part.of(office, 1)}


def fusable(found: Inspection) -> bool:
    return not [sentence for sentence in found.advice if sentence.matter is Matter.MISSING]


@pytest.mark.parametrize("name", CASES)
def test_a_log_is_right_or_its_remedy_leads_there(name: str, parts: dict[bool, Part], tmp_path: Path) -> None:
    case = CASES[name]
    part = parts[case.dense]
    log = case.build(part, tmp_path)
    found = inspect_path(log)
    assert fusable(found) == (case.refused is None)
    if not case.followed:
        with pytest.raises(InputError, match=case.refused):
            load_flight(log)
        return
    outcome = lead(log, tmp_path, case)
    for words in (case.refused, case.caused):
        assert words is None or any(words in told for told in outcome.told), outcome.told
    assert bool(outcome.told) == bool(case.refused or case.caused), outcome.told
    judge(part, outcome, case)
