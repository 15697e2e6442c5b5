"""Candidates in files that other people wrote: what the bench's file declares, wins."""

import gzip
from datetime import date
from decimal import Decimal

import optuna
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from optuna.distributions import (
    FloatDistribution,
    IntDistribution,
)

from study.bench.bench import Bench
from study.bench.plan import Plan, read_plan
from study.cli import main
from study.sampler.table import FeatureTable
from tests.cases import cases, refused
from tests.study.bench.robot import change

TOML = """
[candidates]
file = "{file}"
parameters = ["dose"]
features = ["known"]
{more}
[goal]
"""
WHOLE = list(range(10, 51))


def plan(folder, doses, more="", file="doses.csv"):
    rows = "".join(f"{dose},{place}\n" for place, dose in enumerate(doses))
    (folder / "doses.csv").write_text(f"dose,known\n{rows}")
    (folder / "bench.toml").write_text(TOML.format(file=file, more=more))
    return read_plan(folder / "bench.toml")


def of_dose(table):
    return table.rows.space.as_dict()["dose"]


@cases("declared-candidates.toml", "more", "expected")
def test_what_is_declared_wins_over_what_the_column_suggests(tmp_path, more, expected):
    assert str(of_dose(plan(tmp_path, WHOLE, more).read_candidates())) == expected


def test_nothing_outside_of_declared_bounds_is_proposed(tmp_path):
    bench = Bench.new(plan(tmp_path, WHOLE, "bounds.dose = [9.5, 50.5]").path)
    bench.add([({"dose": 26.5}, 1.0)])  # an operator's own
    for number in range(1, 13):
        (trial,) = bench.next()
        assert 9.5 <= trial.params["dose"] <= 50.5
        bench.record(number, trial.params["dose"])


def test_whole_numbers_on_a_logarithmic_scale_stay_whole(tmp_path):
    bench = Bench.new(plan(tmp_path, list(range(1, 17)), 'log = ["dose"]').path)
    for number in range(12):
        (trial,) = bench.next()
        assert isinstance(trial.params["dose"], int)
        bench.record(number, (trial.params["dose"] - 5.3) ** 2)


@cases("bad-candidates.toml", "doses", "more", "said")
def test_what_does_not_fit_is_refused_by_name(tmp_path, doses, more, said):
    with refused(said):
        plan(tmp_path, doses.split("|"), more).read_candidates()


@pytest.mark.parametrize(
    ("doses", "expected"),
    [
        ([2**60, 2**60 + 1], [2**60, 2**60 + 1]),
        (["1a", "7"], ["1a", "7"]),
        ([0.5, 2], [0.5, 2.0]),
        (["true", "false"], [True, False]),
    ],
)
def test_a_declared_choice_may_be_anything(tmp_path, doses, expected):
    path = plan(tmp_path, doses, 'type.dose = "choice"').path
    table = Bench.new(path).candidates
    assert [table.rows.as_parameters(row)["dose"] for row in range(2)] == expected
    assert Bench(path).candidates.digest == table.digest
    assert Bench(path).next()[0].params["dose"] in expected


def european(path):
    path.write_bytes("\ufeffdose;known\r\n1,5;0,25\r\n2;3\r\n".encode())


def packed(path):
    path.write_bytes(gzip.compress(b"dose,known\n1.5,0.25\n2,3\n"))


def decimals(path):
    """As DuckDB writes `1.5 + i * 0.5`."""
    dose = pa.array([Decimal("1.5"), Decimal("2.0")], pa.decimal128(18, 1))
    known = pa.array([Decimal("0.25"), Decimal("3")], pa.decimal128(18, 2))
    pq.write_table(pa.table({"dose": dose, "known": known}), path)


def hive(path):
    for dose, known in ((1.5, 0.25), (2, 3)):
        part = path / f"dose={dose}"
        part.mkdir(parents=True)
        pq.write_table(pa.table({"known": [float(known)]}), part / "0.parquet")


@pytest.mark.parametrize(
    ("file", "write"),
    [
        ("mine.csv", european),
        ("RUN1.CSV", european),
        ("mine.CSV.GZ", packed),
        ("mine.parquet", decimals),
        ("mine.PARQUET", decimals),
        ("hive", hive),
    ],
)
def test_files_as_other_programs_write_them(tmp_path, file, write):
    write(tmp_path / file)
    rows = plan(tmp_path, [1], file=file).read_candidates().rows
    assert rows.parameters.tolist() == [[1.5], [2.0]]
    assert rows.features.tolist() == [[0.25], [3.0]]
    assert rows.space.distributions == (FloatDistribution(1.5, 2.0),)
    trial = Bench.new(tmp_path / "bench.toml").next()[0]  # and the entries are kept
    assert Bench(tmp_path / "bench.toml").state.trials[0].params == trial.params


def test_a_bench_of_an_earlier_version_keeps_its_parameters_and_says_so(
    tmp_path, monkeypatch, capsys
):
    """Until 0.3.0 whole doses within [9.5, 50.5] were whole numbers from 9 on."""
    old = plan(tmp_path, WHOLE, "bounds.dose = [9.5, 50.5]")
    then = {"dose": IntDistribution(9, 50)}
    known = [*range(len(WHOLE))]
    begun = FeatureTable.from_arrays({"dose": WHOLE}, known, ["known"], space=then)
    with monkeypatch.context() as of_then:
        of_then.setattr(Plan, "read_candidates", lambda *_: begun)
        Bench.new(old.path).next()
    (trial,) = Bench(old.path).next()
    assert isinstance(trial.params["dose"], int)
    assert of_dose(Bench(old.path).candidates) == IntDistribution(9, 50)
    main(["bench", "status", "--bench", str(old.path)])
    said = "bounds.dose: the bench was begun with 9 to 50, beyond 9.5"
    assert said in capsys.readouterr().err


# Tables of other doors have the same types.
def frame():
    """Two rows with columns of all kinds."""
    import pandas as pd

    return pd.DataFrame(
        {
            "when": pd.to_datetime(["2026-05-04", "2026-05-05"]),
            "day": [date(2026, 5, 4), date(2026, 5, 5)],
            "word": ["1,5", "2,5"],
            "id": [2**60, 2**60 + 1],
            "complex": [1j, 2j],
            "f": 1.5,
            "price": [Decimal("1.5"), Decimal("2.25")],
            "units": [Decimal("3"), Decimal("4")],
        }
    )


@pytest.mark.parametrize("name", ["when", "word", "id", "day"])
def test_what_is_no_parameter_of_a_frame(name):
    with refused(rf"^table.{name}\[0\]: "):
        FeatureTable.from_dataframe(frame(), parameters=[name], features=["f"])


@pytest.mark.parametrize(
    ("name", "shown"), [("when", "2026"), ("day", "2026"), ("complex", "1j")]
)
def test_what_is_no_feature_of_a_frame(name, shown):
    with refused(rf"table.features\[0\]: .*{shown}"):
        FeatureTable.from_dataframe(frame(), parameters=["price"], features=[name])


def test_decimals_of_a_frame_are_of_kinds_that_optuna_has():
    names = ["price", "units"]
    rows = FeatureTable.from_dataframe(
        frame(), parameters=names, features=["price"]
    ).rows
    assert rows.space.distributions == (
        FloatDistribution(1.5, 2.25),
        IntDistribution(3, 4),
    )
    assert rows.features[:, 0].tolist() == [1.5, 2.25]
    optuna.create_study().enqueue_trial(rows.as_parameters(0))


def test_bounds_of_arrays_and_files_are_kept_off_the_table(tmp_path):
    bounds = {"dose": (9.5, 50.5)}
    table = FeatureTable.from_arrays({"dose": WHOLE}, WHOLE, bounds=bounds)
    assert of_dose(table) == FloatDistribution(9.5, 50.5)
    pq.write_table(pa.table({"dose": WHOLE, "f": WHOLE}), tmp_path / "a.parquet")
    file = tmp_path / "a.parquet"
    table = FeatureTable.from_parquet(
        file, parameters=["dose"], features=["f"], bounds=bounds
    )
    assert of_dose(table) == FloatDistribution(9.5, 50.5)
    with refused(r"table.dose\[0\]: 10.0 .* 20 to 50"):
        FeatureTable.from_arrays({"dose": WHOLE}, WHOLE, bounds={"dose": (20, 50)})


def test_a_column_that_looks_like_a_pattern_is_itself(tmp_path):
    path = plan(tmp_path, []).path
    change(path, 'features = ["known"]', 'outcomes = ["k[n]"]')
    (tmp_path / "doses.csv").write_text("dose,kn,k[n]\n1,2,3\n2,4,6\n")
    rows = read_plan(path).read_candidates().rows
    assert rows.worlds.costs.ravel().tolist() == [3.0, 6.0]


def test_candidates_of_which_nothing_is_known_are_refused_by_keys_of_the_file(tmp_path):
    path = plan(tmp_path, WHOLE).path
    change(path, 'features = ["known"]', "")
    with refused(r"^candidates.outcomes: 'none' .* or features"):
        Bench.new(path)


def test_an_infinite_cost_in_a_world_is_worse_than_all_others(tmp_path, capsys):
    path = plan(tmp_path, WHOLE).path
    change(path, 'features = ["known"]', 'outcomes = ["known", "other"]')
    rows = "".join(f"{dose},{dose},{dose if dose > 30 else 'inf'}\n" for dose in WHOLE)
    (tmp_path / "doses.csv").write_text(f"dose,known,other\n{rows}")
    bench = Bench.new(path)
    costs = bench.candidates.rows.worlds.costs
    assert (costs[:21, 1] > costs[21:].max()).all()
    assert bench.next()[0].params["dose"] in WHOLE
    bench.record(0, 80.0)  # less than what stands for infinity
    assert "80 is far from all that was simulated, 10 to 50" in bench.doubts()[0]
    main(["bench", "compare-to-simulator", "--bench", str(path)])
    assert "Infinite costs count as numbers beyond" in capsys.readouterr().out
    (tmp_path / "doses.csv").write_text("dose,known,other\n1,inf,inf\n2,inf,inf\n")
    with refused("candidates.outcomes: 'infinite in all rows' .* a finite number"):
        read_plan(path).read_candidates()


def test_a_row_that_is_told_twice_in_two_ways_is_named(tmp_path, capsys):
    path = plan(tmp_path, [1, 2, 2, 3]).path
    main(["bench", "new", str(path)])
    said = capsys.readouterr().err
    assert "warning: candidates: row 2 has the parameters of row 1 and other" in said


def test_an_empty_cell_of_a_world_is_refused_by_its_row(tmp_path):
    """A row without its cost in each world would never be proposed, without a word."""
    path = plan(tmp_path, []).path
    change(path, 'features = ["known"]', 'outcomes = ["known", "other"]')
    (tmp_path / "doses.csv").write_text("dose,known,other\n1,2,3\n2,4,\n3,5,1\n")
    with refused(r"^candidates.other\[1\]: 'nothing' .* or no such row"):
        read_plan(path).read_candidates()
    begun = {"dose": IntDistribution(1, 3)}  # by an earlier version
    assert len(read_plan(path).read_candidates(begun)) == 3
