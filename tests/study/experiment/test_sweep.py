"""A sweep: its values, the trials of each, and that nothing begins where one is refused."""

import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from study.experiment.compare import Progress, Request
from study.experiment.sweep import points_of, read_swept, sweep
from study.experiment.walker import read_experiment
from tests.cases import refused
from tests.study import fake_walker

KEY = "body.disturbance"


@pytest.mark.parametrize(
    ("word", "values"),
    [
        ("1:0:-0.25", (1, 0.75, 0.5, 0.25, 0)),
        ("0:0.9:0.3", (0, 0.3, 0.6, 0.9)),
        ("0.1:0.3:0.1", (0.1, 0.2, 0.3)),  # as they are written, to the last bit
        ("2:2:1", (2,)),
        ("1,0.5,1", (1, 0.5)),
        ("-1:1:1", (-1, 0, 1)),
        ("1e16,3", (1e16, 3)),
    ],
)
def test_values(word, values):
    swept = read_swept(f"a.b={word}")
    assert swept.values == values and swept.label == "b"
    assert all(
        isinstance(value, type(expected))
        for value, expected in zip(swept.values, values, strict=True)
    )
    assert swept.over(3) == {"a": {"b": 3}}


def test_at_most_a_hundred_values():
    assert len(read_swept("a=1:100:1").values) == 100
    with refused("at most 100 values"):
        read_swept("a=0:100:1")
    with refused("at most 100 values"):
        read_swept("a=0:1e60:1")


def test_a_range_ends_at_its_stop():
    with refused("over: 'a=1:0:-0.3' .* a step that ends at 0"):
        read_swept("a=1:0:-0.3")


class Sweep:
    """Sweeps of the toy experiment over its disturbance, in a folder."""

    def __init__(self, folder):
        self.config = fake_walker.write_config(folder, "until_walker = true")
        self.out = folder / "swept"
        self.shown: list[Progress] = []

    def read(self, over):
        return read_experiment(self.config, over=over)

    def points(self, word):
        return points_of(read_swept(word), self.read, self.out)

    def run(self, word, runs=2, trials=4):
        request = Request(self.out, runs=runs, trials=trials)
        self.shown.clear()
        points = self.points(word)
        return [*sweep(points, "ranking", request, self.shown.append, lambda *_: "")]


@pytest.fixture
def toy_sweep(fake_simulator, tmp_path):
    return Sweep(tmp_path)


def test_each_value_has_all_its_trials_on_the_same_robots(toy_sweep):
    first, second = toy_sweep.run(f"{KEY}=0.1,0.2")
    for value, tuned in ((0.1, first), (0.2, second)):
        table = pq.read_table(toy_sweep.out / str(value) / "trials.parquet")
        assert table["experiment"].unique().to_pylist() == [f"toy-disturbance-{value}"]
        assert len(table) == 8  # also after a walker
        least = pc.min(table["cost"].filter(pc.equal(table["run"], 0))).as_py()
        assert tuned.best_cost[0] == least == tuned.best["cost"][0].as_py()
        # simulated once more, the best trial is the same
        assert tuned.rows["distance_m"].tolist() == tuned.best["distance_m"].to_pylist()
    bodies = [tuned.point.experiment.body(0).mass_kg for tuned in (first, second)]
    away = [(mass / bodies[0].sum() - 1.0) for mass in bodies]
    assert bodies[0].shape == bodies[1].shape and (away[0] != away[1]).any()
    last = toy_sweep.shown[-1]
    assert (last.trials, last.total, last.studies) == (16, 16, 4)
    told = [each.trials for each in toy_sweep.shown]
    assert told == sorted(told)


def test_a_later_call_computes_what_is_missing_and_tells_what_it_is_asked(toy_sweep):
    many = toy_sweep.run(f"{KEY}=0.1,0.2", runs=3, trials=6)
    calls = len(fake_walker.calls)
    _, few = toy_sweep.run(f"{KEY}=0.2", runs=2, trials=3)
    assert len(fake_walker.calls) == calls + 2  # of the best trials alone
    assert len(few.best) == 2 and max(few.best["trial"].to_pylist()) < 3
    assert (few.best_cost >= many[1].best_cost[:2]).all()
    # a value more: a report without those of the folder would lose them
    more = toy_sweep.run(f"{KEY}=0.15")
    assert [tuned.point.value for tuned in more] == [0.1, 0.15, 0.2]
    values = [point.value for point in toy_sweep.points(f"{KEY}=0.2:0.1:-0.05")]
    assert values == [0.2, 0.15, 0.1]  # as they are asked for


def test_a_key_of_a_range_takes_a_number(toy_sweep):
    points = toy_sweep.points("world.strength=0.8,0.9")
    strengths = [point.experiment.conditions.world_ranges.strength for point in points]
    assert strengths == [(0.8, 0.8), (0.9, 0.9)]
    with refused(r"world\.strength: 99 .*\[lowest, highest\]"):
        toy_sweep.points("world.strength=0.8,99")


@pytest.mark.parametrize("key", ["trials", "runs"])
def test_a_key_that_decides_nothing_is_refused(key, toy_sweep):
    with refused(f"over: '{key}' .*decides trials"):
        toy_sweep.points(f"{key}=1,2")


def test_nothing_begins_where_the_last_value_is_refused(toy_sweep):
    toy_sweep.run(f"{KEY}=0.2")
    document = toy_sweep.out / "0.2" / "experiment.json"
    document.write_text(document.read_text().replace('"seed": 5', '"seed": 6'))
    with refused(r"seed: 5 .*0\.2"):
        toy_sweep.run(f"{KEY}=0.1,0.2")
    # Nor in the folder of another sweep, whose report would be lost.
    with refused(r"out: .*/0\.2/experiment\.json is of toy-disturbance-0\.2"):
        toy_sweep.run("seed=3")
    assert [each.name for each in toy_sweep.out.iterdir()] == ["0.2"]
