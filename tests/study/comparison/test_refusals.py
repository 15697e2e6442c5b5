"""What a comparison refuses, in one line, before anything is computed."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from storage.tables import DIGEST_KEY, write_table
from study.comparison.folder import ExperimentFolder
from study.experiment import arms
from study.experiment.experiment import read_experiment
from taichi_nmm.errors import InputError
from tests.study import fake_walker
from tests.study.conftest import Comparisons


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        ({"arms": ("dog", "cat")}, "arm: 'cat' .* one of random, "),
        ({"runs": 0}, "runs: 0"),
        ({"trials": 0}, "trials: 0"),
        ({"trials": 151}, "trials: 151 .* at most 150"),
        ({"workers": 0}, "workers: 0"),
    ],
)
def test_requests(request_: dict[str, Any], message: str, comparisons: Comparisons) -> None:
    fake_walker.calls.clear()
    with pytest.raises(InputError, match=message):
        comparisons.run("out", **request_)
    assert not fake_walker.calls
    assert not (comparisons.folder / "out").exists()


def edited(comparisons: Comparisons, old: str, new: str) -> Path:
    path = comparisons.folder / "edited.toml"
    text = fake_walker.write_config(comparisons.folder).read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("seed = 5", "seed = 6", "seed: 6 .* 5, as"),
        ('cost = "smooth"', 'cost = "walking"', "objective.cost: 'walking'"),
        ('kind = "rough"', 'kind = "flat"', "terrain.name: 'flat'"),
        ("disturbance = 0.15", "disturbance = 0.1", "body.disturbance"),
        ("duration_s = 20.0", "duration_s = 30.0", "simulation.duration_s"),
        ('name = "toy"', 'name = "boy"', "name: 'boy'"),
    ],
)
def test_another_experiment_in_the_folder(
    old: str, new: str, message: str, comparisons: Comparisons
) -> None:
    comparisons.run("out", arms=("random",), trials=1)
    before = comparisons.content("out")
    with pytest.raises(InputError, match=message):
        comparisons.run("out", experiment=read_experiment(edited(comparisons, old, new)))
    assert comparisons.content("out") == before


def test_a_folder_of_version_0_1_0(comparisons: Comparisons) -> None:
    """Its document says the version, and not yet the ground."""
    comparisons.run("out", arms=("random",), trials=1)
    before = comparisons.content("out")
    file = comparisons.folder / "out" / "experiment.json"
    document = json.loads(file.read_text())
    del document["ground"]
    document["versions"]["taichi-nmm"] = "0.1.0"
    file.write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"versions\.taichi-nmm: .* '0\.1\.0'") as caught:
        comparisons.run("out", arms=("random",), trials=2)
    assert "\n" not in str(caught.value)
    assert comparisons.content("out") == before


def test_another_store_in_the_folder(comparisons: Comparisons) -> None:
    comparisons.run("out", arms=("dog",), trials=1)
    fake_walker.write_store(comparisons.folder / "other", seed=4)
    config = edited(
        comparisons, f'flat = "{comparisons.folder}/store"', f'flat = "{comparisons.folder}/other"'
    )
    with pytest.raises(InputError, match=r"stores.flat: .* as .*experiment\.json"):
        comparisons.run("out", experiment=read_experiment(config), arms=("dog",), trials=2)
    # An arm that does not read it may still be added.
    comparisons.run("out", experiment=read_experiment(config), arms=("random",), trials=2)


def test_another_definition_of_an_arm_in_the_folder(
    comparisons: Comparisons, monkeypatch: pytest.MonkeyPatch
) -> None:
    comparisons.run("out", arms=("dog",), trials=1)
    changed = replace(arms.ARMS["dog"], options={"kernel": "additive"})
    monkeypatch.setitem(arms.ARMS, "dog", changed)
    with pytest.raises(InputError, match=r"arms\.dog\.options.*another --out"):
        comparisons.run("out", arms=("dog",), trials=2)


def test_two_processes_on_one_folder(comparisons: Comparisons) -> None:
    comparisons.run("out", arms=("random",), trials=1)
    document = json.loads((comparisons.folder / "out" / "experiment.json").read_text())
    with (
        ExperimentFolder.claim(comparisons.folder / "out", document),
        pytest.raises(InputError, match="no other process"),
    ):
        comparisons.run("out")


def test_a_folder_of_something_else(comparisons: Comparisons) -> None:
    (comparisons.folder / "out").mkdir()
    (comparisons.folder / "out" / "thesis.tex").touch()
    with pytest.raises(InputError, match=r"thesis\.tex"):
        comparisons.run("out")


def test_a_damaged_arm(comparisons: Comparisons) -> None:
    comparisons.run("out", arms=("random",), trials=1)
    file = comparisons.folder / "out" / "arms" / "random.parquet"
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"random\.parquet"):
        comparisons.run("out", arms=("random",))


Edit = Callable[[pa.Table, dict[str, Any]], tuple[pa.Table, dict[str, Any]]]


def rewrite(file: Path, edit: Edit) -> None:
    """Write an arm's file again, with another table and footer than it had."""
    table = pq.read_table(file)
    footer = json.loads(table.schema.metadata[b"taichi_nmm"])
    write_table(file, *edit(table.replace_schema_metadata(None), footer))


def cheaper(table: pa.Table, footer: dict[str, Any]) -> tuple[pa.Table, dict[str, Any]]:
    column = table.schema.get_field_index("cost")
    costs = pa.array(table["cost"].to_numpy() * 0.5)
    return table.set_column(column, table.schema.field("cost"), costs), footer


def undigested(table: pa.Table, footer: dict[str, Any]) -> tuple[pa.Table, dict[str, Any]]:
    """As 0.2.0 wrote it before there were digests."""
    return table, {key: value for key, value in footer.items() if key != DIGEST_KEY}


def of_seed_6(table: pa.Table, footer: dict[str, Any]) -> tuple[pa.Table, dict[str, Any]]:
    return undigested(table, footer | {"seed": 6})


def of_two_arms(table: pa.Table, footer: dict[str, Any]) -> tuple[pa.Table, dict[str, Any]]:
    column, names = table.schema.get_field_index("arm"), ["dog"] + ["random"] * (len(table) - 1)
    return undigested(table.set_column(column, table.schema.field("arm"), [names]), footer)


def with_a_gap(table: pa.Table, footer: dict[str, Any]) -> tuple[pa.Table, dict[str, Any]]:
    return undigested(table.take([0, 2, *range(3, len(table))]), footer)


def from_trial_1(table: pa.Table, footer: dict[str, Any]) -> tuple[pa.Table, dict[str, Any]]:
    return undigested(table.slice(1), footer)


def less_a_column(table: pa.Table, footer: dict[str, Any]) -> tuple[pa.Table, dict[str, Any]]:
    return undigested(table.drop_columns("notes"), footer)


def of_nothing(table: pa.Table, footer: dict[str, Any]) -> tuple[pa.Table, dict[str, Any]]:
    return table, {}


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (cheaper, r"random\.parquet' .*does not fit the digest"),
        (of_seed_6, r"random\.parquet' .*whose seed is 5; in the file's footer: 6"),
        (of_two_arms, r"random\.parquet' .*of random, and of no other arm"),
        (with_a_gap, r"random\.parquet' .*without a gap"),
        (from_trial_1, r"random\.parquet' .*without a gap"),
        (less_a_column, r"random\.parquet' .*of random, in this version's form"),
        (of_nothing, r"random\.parquet' .*whose format is 1; in the file's footer: None"),
    ],
)
def test_an_arm_that_was_edited(edit: Edit, message: str, comparisons: Comparisons) -> None:
    comparisons.run("out", arms=("random",), trials=3)
    before = comparisons.content("out")
    rewrite(comparisons.folder / "out" / "arms" / "random.parquet", edit)
    fake_walker.calls.clear()
    with pytest.raises(InputError, match=message) as caught:
        comparisons.run("out", arms=("random",), trials=5)
    assert "\n" not in str(caught.value)
    assert comparisons.content("out") == before and not fake_walker.calls


def test_an_arm_of_another_seed(comparisons: Comparisons) -> None:
    comparisons.run("out", arms=("dog",), trials=1)
    other = read_experiment(edited(comparisons, "seed = 5", "seed = 6"))
    comparisons.run("other", experiment=other, arms=("random",), trials=3)
    theirs = comparisons.folder / "other" / "arms" / "random.parquet"
    (comparisons.folder / "out" / "arms" / "random.parquet").write_bytes(theirs.read_bytes())
    for arms_ in (("random",), ("dog",)):  # asked for, or only beside what is asked for
        with pytest.raises(InputError, match=r"random\.parquet' .*whose seed is 5; .*: 6"):
            comparisons.run("out", arms=arms_, trials=3)


def test_a_folder_of_before_digests_goes_on(comparisons: Comparisons) -> None:
    comparisons.run("whole", arms=("random", "cmaes-cold"))
    comparisons.run("out", arms=("random", "cmaes-cold"), trials=3)
    for name in ("random", "cmaes-cold"):
        rewrite(comparisons.folder / "out" / "arms" / f"{name}.parquet", undigested)
    comparisons.run("out", arms=("random", "cmaes-cold"))
    assert comparisons.content("out") == comparisons.content("whole")
    footer = json.loads(
        pq.read_schema(comparisons.folder / "out/arms/random.parquet").metadata[b"taichi_nmm"]
    )
    assert DIGEST_KEY in footer  # from now on


def test_trials_that_the_sampler_did_not_propose(comparisons: Comparisons) -> None:
    comparisons.run("out", arms=("random",), trials=4)
    document = json.loads((comparisons.folder / "out" / "experiment.json").read_text())
    with ExperimentFolder.claim(comparisons.folder / "out", document) as folder:
        table = folder.read_arm("random")
        column = table.schema.get_field_index("arm")
        renamed = table.set_column(column, table.schema.field("arm"), [["cmaes-cold"] * len(table)])
        folder.write_arm("cmaes-cold", renamed)
    with pytest.raises(InputError, match=r"cmaes-cold, run 0, trial 0.*another --out"):
        comparisons.run("out", arms=("cmaes-cold",), trials=5)
