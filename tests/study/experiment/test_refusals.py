"""What a comparison refuses, in one line, before anything is computed."""

import json
from dataclasses import replace

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from storage.tables import DIGEST_KEY, write_table
from study.experiment import arms
from study.experiment.folder import ExperimentFolder
from study.experiment.walker import read_experiment
from tests.cases import refused
from tests.study import fake_walker


def edited(comparisons, old, new):
    """The toy experiment with a line changed."""
    path = comparisons.folder / "edited.toml"
    text = fake_walker.write_config(comparisons.folder).read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return read_experiment(path)


def document(comparisons):
    """That of the folder out."""
    return dict(
        json.loads((comparisons.folder / "out" / "experiment.json").read_text())
    )


def arm_file(comparisons, arm="random", out="out"):
    return comparisons.folder / out / "arms" / f"{arm}.parquet"


def test_another_experiment_or_version_in_the_folder(comparisons):
    comparisons.run("out", arms=("random",), trials=1)
    before = comparisons.content("out")
    for old, new, message in (
        ("seed = 5", "seed = 6", "seed: 6 .* 5, as"),
        ('cost = "smooth"', 'cost = "walking"', "objective.cost: 'walking'"),
        ('kind = "rough"', 'kind = "flat"', "terrain.name: 'flat'"),
        ("disturbance = 0.15", "disturbance = 0.1", "body.disturbance"),
        ("duration_s = 20.0", "duration_s = 30.0", "simulation.duration_s"),
        ('name = "toy"', 'name = "boy"', "name: 'boy'"),
    ):
        with refused(message):
            comparisons.run("out", experiment=edited(comparisons, old, new))
    ours = document(comparisons)
    ours["versions"]["taichi-nmm"] = "0.1.0"
    (comparisons.folder / "out" / "experiment.json").write_text(json.dumps(ours))
    with refused(r"versions\.taichi-nmm: .* '0\.1\.0'"):
        comparisons.run("out", arms=("random",), trials=2)
    assert comparisons.content("out") == before


def test_another_store_or_arm(comparisons, monkeypatch):
    comparisons.run("out", arms=("dog",), trials=1)
    folder = comparisons.folder
    fake_walker.write_store(folder / "other", seed=4)
    other = edited(comparisons, f'flat = "{folder}/store"', f'flat = "{folder}/other"')
    with refused(r"stores.flat: .* as .*experiment\.json"):
        comparisons.run("out", experiment=other, arms=("dog",), trials=2)
    # An arm that does not read it may still be added.
    comparisons.run("out", experiment=other, arms=("random",), trials=2)
    changed = replace(arms.ARMS["dog"], options={"kernel": "additive"})
    monkeypatch.setitem(arms.ARMS, "dog", changed)
    with refused(r"arms\.dog\.options.*another --out"):
        comparisons.run("out", arms=("dog",), trials=2)


def test_a_folder_in_use_of_something_else_or_damaged(comparisons):
    comparisons.run("out", arms=("random",), trials=1)
    with (
        ExperimentFolder.claim(comparisons.folder / "out", document(comparisons)),
        refused("no other process"),
    ):
        comparisons.run("out")
    (comparisons.folder / "thesis").mkdir()
    (comparisons.folder / "thesis" / "thesis.tex").touch()
    with refused(r"thesis\.tex"):
        comparisons.run("thesis")
    file = arm_file(comparisons)
    file.write_bytes(file.read_bytes()[:-100])
    with refused(r"random\.parquet"):
        comparisons.run("out", arms=("random",))


def rewrite(file, edit):
    """Write an arm's file again, with another table and footer than it had."""
    table = pq.read_table(file)
    footer = json.loads(table.schema.metadata[b"taichi_nmm"])
    write_table(file, *edit(table.replace_schema_metadata(None), footer))


def with_column(table, name, values):
    column = table.schema.get_field_index(name)
    return table.set_column(column, table.schema.field(name), pa.array(values))


def undigested(table, footer):
    """As 0.2.0 wrote it before there were digests."""
    return table, {key: value for key, value in footer.items() if key != DIGEST_KEY}


EDITS = {
    "cheaper": (
        lambda table, footer: (
            with_column(table, "cost", table["cost"].to_numpy() / 2),
            footer,
        ),
        "does not fit the digest",
    ),
    "of two arms": (
        lambda table, footer: undigested(
            with_column(table, "arm", ["dog"] + ["random"] * (len(table) - 1)), footer
        ),
        "of random, and of no other arm",
    ),
    "with a gap": (
        lambda table, footer: undigested(
            table.take([0, 2, *range(3, len(table))]), footer
        ),
        "without a gap",
    ),
    "from trial 1": (
        lambda table, footer: undigested(table.slice(1), footer),
        "without a gap",
    ),
    "less a column": (
        lambda table, footer: undigested(table.drop_columns("notes"), footer),
        "of random, in this version's form",
    ),
    "of nothing": (
        lambda table, footer: (table, {}),
        "whose format is 1; in the file's footer: None",
    ),
}


@pytest.mark.parametrize(("edit", "message"), EDITS.values(), ids=EDITS)
def test_an_arm_that_was_edited(edit, message, comparisons):
    comparisons.run("out", arms=("random",), trials=3)
    before = comparisons.content("out")
    rewrite(arm_file(comparisons), edit)
    fake_walker.calls.clear()
    with refused(rf"random\.parquet' .*{message}"):
        comparisons.run("out", arms=("random",), trials=5)
    assert comparisons.content("out") == before and not fake_walker.calls


def test_an_arm_of_another_seed(comparisons):
    comparisons.run("out", arms=("dog",), trials=1)
    other = edited(comparisons, "seed = 5", "seed = 6")
    comparisons.run("other", experiment=other, arms=("random",), trials=3)
    arm_file(comparisons).write_bytes(arm_file(comparisons, out="other").read_bytes())
    for arms_ in (("random",), ("dog",)):  # asked for, or only beside what is asked for
        with refused(r"random\.parquet' .*whose seed is 5; in the file's footer: 6"):
            comparisons.run("out", arms=arms_, trials=3)


def test_a_folder_of_before_digests_goes_on(comparisons):
    both = ("random", "cmaes-cold")
    comparisons.run("whole", arms=both)
    comparisons.run("out", arms=both, trials=3)
    for name in both:
        rewrite(arm_file(comparisons, name), undigested)
    comparisons.run("out", arms=both)
    assert comparisons.content("out") == comparisons.content("whole")
    footer = pq.read_schema(arm_file(comparisons)).metadata[b"taichi_nmm"]
    assert DIGEST_KEY in json.loads(footer)  # from now on


def test_trials_that_the_sampler_did_not_propose(comparisons):
    comparisons.run("out", arms=("random",), trials=4)
    with ExperimentFolder.claim(
        comparisons.folder / "out", document(comparisons)
    ) as folder:
        table = folder.read_arm("random")
        renamed = with_column(table, "arm", ["cmaes-cold"] * len(table))
        folder.write_arm("cmaes-cold", renamed)
    with refused("cmaes-cold, run 0, trial 0.*another --out"):
        comparisons.run("out", arms=("cmaes-cold",), trials=5)
