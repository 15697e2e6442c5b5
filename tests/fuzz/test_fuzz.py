"""Damaged inputs end in success or one line, and what does not is noticed; `make fuzz` has more."""

import os
import shutil
import time
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from storage.pool import cores
from study import options
from tests.fuzz import campaign
from tests.fuzz.campaign import (
    ACCEPTED,
    REFUSED,
    Plan,
    Verdict,
    content,
    run_cases,
    wrong,
)
from tests.fuzz.cases import HERE, NAMES, make_case
from tests.fuzz.damage import HUGE, VALUES, as_json, damaged_document, nudged
from tests.fuzz.world import COMMANDS, make_world

pytestmark = pytest.mark.slow

CASES = 2000  # of the campaign: enough for every format to come up
SHORT_S = 5.0


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    scratch = tmp_path_factory.mktemp("fuzz")
    make_world(scratch / "world")
    return Plan(14, scratch / "world", scratch)


def elsewhere(plan, name):
    """The same with a scratch of its own."""
    (plan.scratch / name).mkdir()
    return replace(plan, scratch=plan.scratch / name)


@pytest.mark.parametrize("cases", [60, pytest.param(CASES, marks=pytest.mark.campaign)])
def test_damaged_input_ends_in_one_line(cases, plan):
    """And sound input is accepted, else this would try nothing; every command has some."""
    assert {words[0] for words in COMMANDS.values()} == options.COMMANDS.keys()
    tried = replace(elsewhere(plan, str(cases)), judge=judge_sound_ones_first)
    numbers, workers = range(len(COMMANDS) + cases), cores() if cases == CASES else 1
    outcomes = run_cases(tried, numbers, workers)
    failed = [each for each in outcomes if each.verdict.wrong]
    assert not failed, "\n".join([campaign.table(outcomes), *map(str, failed)])
    outcomes.sort(key=lambda each: each.case.number)
    assert [each.case.number for each in outcomes] == list(numbers)
    codes = [each.verdict.code for each in outcomes]
    sound, damaged = codes[: len(COMMANDS)], codes[len(COMMANDS) :]
    assert sound == [ACCEPTED] * len(COMMANDS)
    assert damaged.count(REFUSED) > cases / 2
    assert {each.case.name for each in outcomes} == set(NAMES) or cases < CASES


def judge_sound_ones_first(case):
    """The first cases are all commands, without damage."""
    if case.number < len(COMMANDS):
        shutil.rmtree(case.folder)
        shutil.copytree(case.folder.parents[3] / "world", case.folder)
        case = replace(case, words=list(COMMANDS.values())[case.number])
    return campaign.judge(case)


@pytest.mark.campaign
def test_what_ends_a_process_is_noticed(plan, tmp_path):
    """An abort, and a case that takes too long, are failures of their own; the others go on."""
    cruel = replace(elsewhere(plan, "cruel"), judge=that_ends, limit_s=SHORT_S)
    outcomes = run_cases(cruel, range(8), 1)
    found = {each.case.number: each.verdict.wrong for each in outcomes}
    assert found == dict.fromkeys(range(8), "") | {
        2: "abort",
        5: f"longer than {SHORT_S:g} s",
    }
    (aborted,) = (each for each in outcomes if each.case.number == 2)
    campaign.keep(cruel, aborted, tmp_path / "kept")
    made = make_case(plan.seed, 2, plan.world, tmp_path / "again")
    assert content(tmp_path / "kept" / HERE) == content(made.folder)
    assert '"wrong": "abort"' in (tmp_path / "kept" / "case.json").read_text()


def that_ends(case):
    if case.number == 2:
        os.abort()
    if case.number == 5:
        time.sleep(100.0)
    return Verdict(ACCEPTED, "", "")


def test_damage_to_a_document_leaves_the_values_that_it_takes_as_they_are():
    """Else a case would depend on those before it, and a list might come to hold itself."""
    before, document = (
        deepcopy(VALUES),
        {"a": [1, {"b": [2, 3]}], "c": {"d": "e", "f": []}},
    )
    for number in range(3000):
        as_json(damaged_document(np.random.default_rng(number), document))
    assert repr(before) == repr(VALUES)
    rng = np.random.default_rng(1)  # and a huge whole number is nudged too
    assert {int, float, str} <= {type(nudged(rng, 1000 * HUGE)) for _ in range(100)}


def test_a_case_is_the_same_whenever_it_is_made(plan, tmp_path):
    make_world(tmp_path / "world")
    assert content(tmp_path / "world") == content(plan.world)
    for number in range(40):
        one = make_case(plan.seed, number, plan.world, tmp_path / "one")
        other = make_case(plan.seed, number, plan.world, tmp_path / "other")
        assert (one.name, one.words) == (other.name, other.words)
        assert content(one.folder) == content(other.folder)


LINE = "error: field: 3 cannot be used; allowed: 4\n"


@pytest.mark.parametrize(
    ("code", "said", "what"),
    [
        (0, "", ""),
        (2, LINE, ""),
        (0, "Traceback (most recent call last)", "a traceback"),
        (2, "", "names nothing"),
        (2, "error\n", "names nothing"),
        (2, "error: no\n", "names"),
        (2, LINE * 2, ""),
        (2, LINE * 21, "21 lines"),
        (2, f"warning\n{LINE}", "names nothing"),
        (2, LINE.replace("3", "\x1b[31m"), "not printable"),
        (2, LINE.replace("3", "x" * 9999), "of 10040 characters"),
        (1, "", "exit code 1"),
        (130, "interrupted", "exit code 130"),
        (None, "", "exit code None"),
    ],
)
def test_what_is_wrong(code, said, what, tmp_path):
    found = wrong(code, said, content(tmp_path), tmp_path)
    assert what in found and bool(found) == bool(what)


def test_what_a_refusal_leaves_behind_is_named(tmp_path):
    (tmp_path / "kept").write_text("a")
    (tmp_path / "lost").write_text("a")
    before = content(tmp_path)
    (tmp_path / "kept").write_text("b")
    (tmp_path / "lost").unlink()
    (tmp_path / "new").mkdir()
    assert wrong(REFUSED, LINE, before, tmp_path) == "changed: kept, lost, new"
    assert wrong(ACCEPTED, "", before, tmp_path) == ""
