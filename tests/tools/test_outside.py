"""Problems from outside: their files, what a study meets, and how samplers are compared on them."""

import hashlib
import json
from itertools import product

import numpy as np
import optuna
import pytest
from optuna.distributions import (
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from tests.cases import asset, refused
from tests.tools.running import load_tool, run_tool
from tools import outside
from tools.outside import (
    ARMS,
    PROBLEMS,
    Feature,
    OutsideRun,
    outside_problem,
    rows_by_ranking,
)
from tools.runs import Arm, Batches, runnable, study_costs

DIGESTS = asset("outside-digests.toml")


@pytest.mark.parametrize("name", PROBLEMS)
def test_a_file_has_the_pool_that_figures_were_made_with(name):
    problem = outside_problem(name)
    assert problem.name == name
    purposes = ("tuning", "reported")
    (purpose,) = (each for each in purposes if name in outside.GROUPS[each])
    assert problem.purpose == purpose
    assert outside.file_of(name).stat().st_size < 150_000
    found = hashlib.sha256(
        repr((name, [*problem.columns], (*problem.feature_meanings,))).encode()
    )
    for column in problem.columns.values():
        found.update(repr(column.tolist()).encode())
    found.update(np.ascontiguousarray(problem.features).tobytes())
    found.update(problem.cost.tobytes())
    assert found.hexdigest()[:16] == DIGESTS[name]


SPACE = {
    "rate": FloatDistribution(1e-4, 1.0, log=True),
    "depth": IntDistribution(1, 9),
    "kind": CategoricalDistribution(("plain", "fancy")),
}
COLUMNS = {
    "rate": np.array([1e-4, 1e-2, 1.0, 1.0]),
    "depth": np.array([1, 5, 9, 9]),
    "kind": np.array(["plain", "fancy", "plain", "fancy"]),
}


def made(*names):
    """A problem of four rows, with some of the parameters."""
    features = np.array([[1.0, np.nan], [5.0, -5.0], [np.inf, -9.0], [np.inf, -9.0]])
    return outside.OutsideProblem(
        name="made",
        purpose="tuning",
        field="testing",
        cost_meaning="a sum",
        space={name: SPACE[name] for name in names},
        columns={name: COLUMNS[name] for name in names},
        feature_meanings={
            "depth": Feature("low", "itself"),
            "minus": Feature("high", "opposite"),
        },
        features=features,
        cost=np.array([1.0, 2.0, 4.0, 3.0]),
    )


WHOLE = made(*SPACE)


@pytest.mark.parametrize(
    ("settings", "row"),
    [
        # 3e-3 is nearer to 1e-2 than to 1e-4 by its logarithm alone; integers count by
        # their steps.
        *(
            ({"rate": rate}, row)
            for rate, row in ((5e-4, 0), (3e-3, 1), (0.05, 1), (0.2, 2))
        ),
        *(({"depth": depth}, row) for depth, row in ((2, 0), (3, 0), (4, 1), (8, 2))),
        # Another choice is sqrt 2 away, the ends of both numbers together as much.
        ({"rate": 1e-4, "depth": 5, "kind": "fancy"}, 1),
        ({"rate": 1.0, "depth": 9, "kind": "fancy"}, 3),
        ({"rate": 1.0, "depth": 9, "kind": "plain"}, 2),
        ({"rate": 1e-4, "depth": 2, "kind": "fancy"}, 1),
        *((WHOLE.settings(row), row) for row in range(4)),
    ],
)
def test_the_nearest_row_is_on_each_parameters_scale(settings, row):
    assert made(*settings).row_nearest_to(settings) == row


def test_a_trial_costs_as_much_as_the_nearest_row_and_rows_are_ranked():
    sampler = optuna.samplers.RandomSampler(seed=1)
    found = study_costs(WHOLE, sampler, Batches(5), first=[WHOLE.settings(3)])
    assert found[0] == WHOLE.cost[3] and len(found) == 5
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=1))
    free = [study.ask(WHOLE.space).params for _ in range(4)]
    expected = [WHOLE.cost[WHOLE.row_nearest_to(settings)] for settings in free]
    assert list(found[1:]) == expected == [WHOLE.cost_at(settings) for settings in free]
    # The ranking is the mean rank: equal values share that of their ranks; what failed
    # ranks last.
    np.testing.assert_array_equal(WHOLE.ranks, [[1, 4], [2, 1], [3.5, 2.5], [3.5, 2.5]])
    np.testing.assert_array_equal(WHOLE.ranking, [2.5, 1.5, 3, 3])


def test_a_batch_is_told_after_all_of_it_was_proposed():
    assert list(Batches(7, 3)) == [3, 3, 1] and list(Batches(4)) == [1] * 4
    half, seen = outside_problem(PROBLEM).drawn(1), []

    class Watched(optuna.samplers.RandomSampler):
        def before_trial(self, study, trial):
            seen.append(
                len(study.get_trials(states=(optuna.trial.TrialState.COMPLETE,)))
            )

    assert len(study_costs(half, Watched(seed=1), Batches(7, 3))) == 7
    assert seen == [0, 0, 0, 3, 3, 3, 6]


def test_a_bad_file_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(outside, "DATA", tmp_path)
    (tmp_path / "broken.parquet").write_text("PAR1")
    for name in ("broken", "missing"):
        with refused(r"a file of tools/data"):
            outside_problem(name)


PROBLEM = "transport-solver"
TRIALS, SEEDS = 7, 2
TOOL = load_tool("compare_outside")
RUN_ARMS = [arm for arm in ARMS if not ARMS[arm].needs]


@pytest.mark.slow
def test_the_page_keeps_what_people_wrote(tmp_path, monkeypatch):
    cache, page = tmp_path / "cache", tmp_path / "docs" / "sampler-outside.md"

    def compare():
        """The files of runs, and when they were written."""
        sizes = ("--seeds", SEEDS, "--trials", TRIALS, "--processes", 1)
        which = ("--arms", ",".join(RUN_ARMS), "--problems", PROBLEM)
        where = ("--cache", cache, "--out", page.parent)
        assert run_tool(monkeypatch, "compare_outside", *sizes, *which, *where) == 0
        return {file: file.stat().st_mtime_ns for file in cache.rglob("*.json")}

    written = compare()
    assert len(written) == SEEDS * len(RUN_ARMS)
    costs = {
        (arm, seed): OutsideRun(PROBLEM, arm, seed, Batches(TRIALS)).kept(cache) or []
        for arm, seed in product(RUN_ARMS, range(SEEDS))
    }
    for (_, seed), found in costs.items():
        assert len(found) == TRIALS
        assert set(found) <= set(outside_problem(PROBLEM).drawn(seed).cost.tolist())
    problem = outside_problem(PROBLEM).drawn(1)
    first = problem.cost[rows_by_ranking(problem, 1)].tolist()
    assert (
        costs["ranking", 1] == first[:TRIALS]
        and costs["tpe-ranking", 1][:3] == first[:3]
    )
    text = page.read_text()
    best = np.median(
        [np.minimum.accumulate(costs["ours", seed]) for seed in range(SEEDS)], 0
    )
    wanted = [
        "# Samplers on problems from outside\n",
        f"## {PROBLEM} (tuning)",
        "| ours: never behind a sampler without features (p < 0.05) | yes |",
        "| ours against | after 5: won | lost | p | after 7: won | lost | p |",
        f"| ours | {ARMS['ours'].sees} | {SEEDS} | ",
        f" | {best[4]:.4g} | {best[6]:.4g} |",
        *(f"| {ARMS[arm].label} | {ARMS[arm].sees} |" for arm in RUN_ARMS),
        *(f"| {name} |" for name in problem.feature_meanings),
    ]
    assert [line for line in wanted if line not in text] == []
    changed = text.replace("# Samplers on", "# People on").replace(
        "Written by", "Written by X"
    )
    page.write_text(changed.replace("| yes |", "| yse |"))
    assert compare() == written
    assert page.read_text() == text.replace("# Samplers on", "# People on")
    # A run of other code, or one whose file is broken, is none.
    run = OutsideRun(PROBLEM, "random", 0, Batches(TRIALS))
    known = json.loads(run.file(cache).read_text())
    for content in (json.dumps({**known, "code": "other"}), "{"):
        run.file(cache).write_text(content)
        assert run.kept(cache) is None
    assert run.kept(tmp_path) is None


def test_left_out_arms(monkeypatch, capsys):
    absent = Arm("A Peer", ARMS["random"].costs, needs="absent")
    monkeypatch.setitem(ARMS, "gp", absent)
    left_out = "A Peer is left out: it needs absent (pip install absent)\n"
    for arms, said in ((["random", "gp"], left_out), (["random"], "")):
        assert (runnable(arms, ARMS), capsys.readouterr().err) == (["random"], said)
    with refused(r"^arms: 'gp'"):
        runnable(["gp"], ARMS)


def test_a_seed_draws_half_of_the_pool_and_breaks_the_rankings_ties():
    whole = outside_problem(PROBLEM)
    one, again, other = whole.drawn(1), whole.drawn(1), whole.drawn(2)
    sizes = {
        len(one),
        len(one.features),
        *(len(column) for column in one.columns.values()),
    }
    assert sizes == {len(whole) // 2}
    np.testing.assert_array_equal(one.cost, again.cost)
    assert set(one.cost) <= set(whole.cost) and set(one.cost) != set(other.cost)
    first, second = rows_by_ranking(whole, 1), rows_by_ranking(whole, 2)
    for rows in (first, second):
        assert sorted(rows) == list(range(len(whole)))
        assert (np.diff(whole.ranking[rows]) >= 0).all()
    assert not np.array_equal(first, second)
    np.testing.assert_array_equal(first, rows_by_ranking(whole, 1))


@pytest.mark.parametrize("ranking", [False, True])
def test_our_arms_get_the_pool_as_it_is(ranking):
    problem = outside_problem(PROBLEM)
    table = outside.table(problem, ranking=ranking)
    assert len(table) == len(problem)
    assert table.rows.feature_names == (*problem.feature_meanings,)
    assert (table.rows.worlds is not None) is ranking


def compared(ours, tpe, ranking):
    """Twelve seeds: least cost after 5 and after 10 trials, a little more for each seed."""
    seeds = 1.0 + 0.001 * np.arange(12)[:, None]
    after = {"ours": ours, "tpe": tpe, "ranking": ranking}
    costs = {(PROBLEM, arm): np.repeat(c, 5)[None] * seeds for arm, c in after.items()}
    return TOOL.Comparison(costs, dict.fromkeys(costs, 0.5))


def test_bars_hold_where_ours_leads_and_name_where_it_does_not():
    good = compared(ours=[2.0, 1.0], tpe=[3.0, 2.0], ranking=[1.5, 1.4])
    bad = compared(ours=[2.0, 1.9], tpe=[1.0, 1.0], ranking=[1.5, 1.4])
    assert [len(failed) for failed in good.bars().values()] == [0, 0, 0]
    assert [len(failed) for failed in bad.bars().values()] == [2, 1, 1]
    what = "| ours: never behind a sampler without features (p < 0.05) |"
    assert f"{what} **no** | {PROBLEM} | TPESampler | 0 | 12 |" in bad.figures()
    test = bad.versus(PROBLEM, "ours", "tpe", 10)
    assert (test.wins, test.losses) == (0, 12) and test.is_behind and not test.is_ahead
    same = compared(ours=[2.0, 1.0], tpe=[2.0, 1.0], ranking=[2.0, 1.0])
    test = same.versus(PROBLEM, "ours", "tpe", 10)
    assert (test.wins, test.losses, test.p) == (0, 0, 1.0)
    assert not test.is_ahead and not test.is_behind
    # Runs that repeat each other are counted once; the median is of the best so far.
    costs = np.array([[3.0, 2.0, 5.0], [3.0, 2.0, 4.0], [3.0, 2.0, 5.0]])
    found = {(PROBLEM, "ours"): costs, (PROBLEM, "tpe"): costs[:1].repeat(3, 0)}
    made = TOOL.Comparison(found, dict.fromkeys(found, 0.25))
    assert "| ours | features | 2 | 0.25 | 2 |" in made.figures()
    assert "| TPESampler | nothing | 1 | 0.25 | 2 |" in made.figures()
