"""How arms are called, drawn and ranked."""

import numpy as np

from study.experiment.arms import ARMS
from study.report.axes import best_peer, by_rank, kind_of, label_of, looks
from study.report.runs import Results
from tests.study.report.synthetic import arm


def test_the_best_peer_has_most_walkers_then_the_earliest() -> None:
    few, late, early = arm("tpe", [1, np.inf]), arm("random", [9, 9]), arm("cmaes-warm", [4, 4])
    ours = arm("best", [1, 1])
    assert best_peer([few, late, early, ours]) == "cmaes-warm"
    assert by_rank({each.arm: each for each in (few, late, early, ours)}) == [
        "best", "cmaes-warm", "random", "tpe",
    ]  # fmt: skip
    assert best_peer([ours]) is None


def test_an_arm_that_nobody_knows_any_more_has_its_name_and_is_ours() -> None:
    assert (kind_of("tpe"), label_of("tpe")) == ("peer", "TPE")
    assert (kind_of("score-first-old"), label_of("score-first-old")) == ("ours", "score-first-old")
    assert best_peer([arm("score-first-old", [1])]) is None


def test_looks_tell_all_known_arms_apart(results: Results) -> None:
    found = looks({name: arm(name, [1, 2]) for name in ARMS})
    assert len({(look.colour, look.marker) for look in found.values()}) == len(ARMS)
    assert len({look.label for look in found.values()}) == len(ARMS)
    assert all(look.label == ARMS[name].label for name, look in found.items())


def test_looks_tell_arms_apart_and_three_stand_in_front(results: Results) -> None:
    found = looks(results.arms)
    assert {name for name, look in found.items() if look.front} == {"dog", "best", "cmaes-warm"}
    assert len({(look.colour, look.marker) for look in found.values()}) == len(found)
    assert len({look.label for look in found.values()}) == len(found)
