"""Stores over families of settings, and stores whose points have low-level gains, too."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from storage import merge, open_store
from storage.inputs.config import Table
from storage.points import sobol_points
from storage.precompute import precompute, progress_parts, score_rows
from storage.specification import read_specification
from storage.store import columns_of, family_names
from storage.tables import difference, document_hash
from taichi_nmm import walker_simulator
from taichi_nmm.parameters import GAIN_NAMES, GAINS, LOW_LEVEL_GAINS, LOW_LEVEL_NAMES
from taichi_nmm.result import END_REASONS, ENERGY, SCORE_FIELDS
from taichi_nmm.settings import Settings
from taichi_nmm.walker_simulator import Walker
from tests.cases import refused
from tests.storage import fake

RAMPS = {
    "up": fake.family(settings=2, kind="ramp", segment_m=1.0),
    "down": fake.family(
        settings=2, seed=9, kind="ramp", segment_m=1.0, direction="down"
    ),
}
THETA_REF = LOW_LEVEL_GAINS[7]
# of the sequence 7, row 16, before groups
POINT_3 = [5.53585406, 1.44055244, 1.84605681]
WORLD = {"friction": [0.3, 0.9], "contact_stiffness": [0.5, 4.0]}
WALKER = Walker(Settings())
FIRST = range(8)  # rows of a shard
LATER = {"after": "down", "min_survived_fraction": 0.6}


def families(**changes):
    return fake.specification(families=RAMPS, **changes)


def test_a_shard_has_its_points_and_every_field_of_the_result():
    specification = fake.specification()
    table, computed_by = score_rows(specification, range(16, 24), lambda _: None)
    assert columns_of(table.schema) == specification.document["columns"]
    assert table.column_names == ["row", *GAIN_NAMES, *(WALKER.columns.names or ())]
    assert table["row"].to_pylist() == list(range(16, 24))
    points = sobol_points(specification.seed, 16, 8, GAINS)
    assert np.array_equal(table["l_clr"].to_numpy(), points[:, 15])
    assert set(table["end_reason"].to_pylist()) <= set(END_REASONS)
    assert computed_by == fake.ENGINE
    specification = fake.specification(
        robust=True, samples=8, simulation={"duration_s": 60.0}
    )
    object.__setattr__(specification.families[0], "min_survival_s", 60.0)
    table, _ = score_rows(specification, FIRST, lambda _: None)
    assert not table["robust_evaluated"].to_numpy().any()


def test_every_family_has_columns_of_its_own():
    document = families(robust=True).document
    names = [column.partition(":")[0] for column in document["columns"]]
    assert len(set(names)) == len(names) == 1 + 16 + len(WALKER.columns) + 3 * 35
    starts = [names.index(f"{family}_evaluated") for family in ("robust", "down", "up")]
    assert starts == [
        names.index("robust_evaluated") + 35 * number for number in range(3)
    ]
    assert names[-6:-4] == list(family_names("up", "phi_corrected"))
    assert document["columns"][-4] == "up_survived_fraction_worlds: float[2]"
    assert document["columns"][-1] == f"up_{ENERGY}_worlds: float[2]"
    assert "up_m5_sum_mean_mps" in names and "down_survived_fraction_sd" in names
    names = ("robust_m5_sum_mean_mps", "robust_m5_sum_sd_mps")
    assert family_names("robust", "m5_sum_mps") == names
    robust = fake.specification(robust=True).document
    assert document["robust"] == robust["robust"] and "families" not in robust
    assert list(document["families"]) == ["down", "up"]
    assert document["families"]["up"]["terrain"]["name"] == "ramp up 4 % per 1 m"
    assert families().document["robust"] is None
    found = difference(families().document, fake.specification().document)
    assert found[0] == "families"
    turned = dict(reversed(RAMPS.items()))
    assert fake.specification(families=turned).hash == families().hash


def test_documents_of_stores_without_families_are_what_they_were():
    """But for the version and its one further column: the energy of the motors was not kept."""
    stored = open_store(Path(__file__).parents[1] / "assets" / "store-v1").specification
    old = {"samples": 20, "shard_rows": 12, "seed": 1}
    now = read_specification(Table(old)).document
    columns = [column for column in now["columns"] if not column.startswith(ENERGY)]
    before = now | {"code_version": "0.1.0", "columns": columns}
    assert len(columns) == len(now["columns"]) - 1
    assert document_hash(before) == document_hash(stored)


def test_family_columns_are_mean_and_spread_over_its_settings():
    """And zero for points that were not run in it."""
    specification = families(robust=True)
    table, _ = score_rows(specification, FIRST, lambda _: None)
    points = sobol_points(specification.seed, 0, 8, GAINS)
    alive = table["duration_s"].to_numpy() >= 3.0
    assert 0 < alive.sum() < 8
    for family in specification.families:
        assert np.array_equal(table[f"{family.name}_evaluated"].to_numpy(), alive)
        worlds = family.worlds
        runs = [
            fake.simulate(
                points,
                bodies=worlds.bodies.take([setting] * 8),
                terrains=worlds.terrains[setting],
                worlds=worlds.surroundings.take([setting] * 8),
                duration_s=family.horizon_s,
                progress=lambda now_s, active: None,
            ).rows
            for setting in range(family.settings)
        ]
        for component, _ in SCORE_FIELDS:
            values = np.array([run[component] for run in runs], dtype=float)
            mean, spread = family_names(family.name, component)
            for name, expected in (
                (mean, values.mean(axis=0)),
                (spread, values.std(axis=0)),
            ):
                np.testing.assert_allclose(
                    table[name].to_numpy(), alive * expected, rtol=1e-12
                )
        for component in WALKER.outcomes:
            each = np.array(table[f"{family.name}_{component}_worlds"].to_pylist())
            expected = np.array([run[component] for run in runs], dtype=np.float32).T
            assert np.array_equal(each, np.where(alive[:, None], expected, 0.0))
    ups, downs = (
        table[f"{name}_phi_printed_mean"].to_numpy()[alive] for name in ("up", "down")
    )
    assert not np.any(ups == downs)  # their bodies differ


def test_a_family_draws_a_world_for_each_setting():
    ramps = {"up": RAMPS["up"] | {"world": WORLD}}
    (up,) = fake.specification(families=ramps).families
    friction = up.worlds.surroundings.friction
    assert len(friction) == 2 and friction[0] != friction[1]
    assert np.all((friction >= 0.3) & (friction <= 0.9))
    assert np.all(up.worlds.surroundings.strength == 1.0)
    document = fake.specification(families=ramps).document["families"]["up"]["world"]
    assert document.keys() == {"friction", "contact_stiffness", "sha256"}
    assert document["friction"] == [0.3, 0.9]
    nominal = fake.specification(families={"up": RAMPS["up"]})
    assert "world" not in nominal.document["families"]["up"]
    base = fake.specification(world={"friction": [0.5, 0.5]})
    assert base.document["world"]["friction"] == [0.5, 0.5]
    assert base.worlds.surroundings.friction[0] == 0.5
    ours, theirs = (
        score_rows(one, FIRST, lambda _: None)[0][
            "up_survived_fraction_mean"
        ].to_numpy()
        for one in (nominal, fake.specification(families=ramps))
    )
    assert np.all(theirs <= ours) and np.any(theirs < ours)


def test_a_later_family_is_run_on_the_survivors_of_another():
    """`a_late` comes first by name, and after `down` by what it asks for."""
    late = RAMPS | {"a_late": fake.family(settings=3, seed=4) | LATER}
    specification = fake.specification(families=late)
    assert [family.name for family in specification.families] == [
        "down",
        "up",
        "a_late",
    ]
    table, _ = score_rows(specification, FIRST, lambda _: None)
    down, evaluated = (
        table["down_survived_fraction_mean"].to_numpy(),
        table["a_late_evaluated"],
    )
    assert np.array_equal(
        evaluated.to_numpy(), table["down_evaluated"].to_numpy() & (down >= 0.6)
    )
    assert 0 < evaluated.to_numpy().sum() < table["down_evaluated"].to_numpy().sum()
    document = specification.document["families"]
    assert document["a_late"] | LATER == document["a_late"]
    assert "after" not in document["down"]


def test_each_family_draws_from_its_own_seed():
    same, other = fake.family(seed=8, kind="rough"), fake.family(seed=9, kind="rough")
    store = fake.specification(families={"a": same, "b": other, "c": same})
    a, b, c = store.families
    assert np.array_equal(a.worlds.terrains[3].height_m, c.worlds.terrains[3].height_m)
    assert np.array_equal(a.worlds.bodies.mass_kg, c.worlds.bodies.mass_kg)
    assert not np.array_equal(
        a.worlds.terrains[3].height_m, b.worlds.terrains[3].height_m
    )
    assert not np.any(a.worlds.bodies.mass_kg == b.worlds.bodies.mass_kg)
    strict = RAMPS["up"] | {"min_survival_s": 4.5}
    store = fake.specification(families={"up": strict, "down": RAMPS["down"]})
    table, _ = score_rows(store, FIRST, lambda _: None)
    up, down = (table[f"{name}_evaluated"].to_numpy() for name in ("up", "down"))
    assert np.array_equal(up, table["duration_s"].to_numpy() >= 4.5)
    assert up.sum() < down.sum() and np.all(down[up])


def test_progress_is_shared_by_work_and_rises_to_one():
    store = families(robust=True)
    seen = []
    parts = progress_parts(store, seen.append)
    for part in parts:
        part(1.0)
    base, robust, down, up = (end - start for start, end in pairwise([0.0, *seen]))
    # six settings, not two
    assert down == pytest.approx(up) and robust == pytest.approx(3 * up)
    assert 0.3 < base < 0.5 and seen[-1] == 1.0
    seen.clear()
    score_rows(store, FIRST, seen.append)
    assert seen == sorted(seen) and seen[-1] == 1.0


def test_an_opened_store_knows_its_families(tmp_path):
    summary = precompute(families(robust=True), tmp_path / "store")
    store = open_store(tmp_path / "store", verify=True)
    assert store.families == ("robust", "down", "up")
    assert list(summary.evaluated) == ["robust", "down", "up"]
    for family, count in summary.evaluated.items():
        name = f"{family}_evaluated"
        assert count == store.numpy([name])[name].sum() > 0
        mean = f"{family}_survived_fraction_mean"
        outcomes = store.outcomes(family, "survived_fraction")
        assert (
            np.isfinite(outcomes).all(axis=1).sum() == count
            and outcomes.dtype == np.float32
        )
        found = np.nan_to_num(outcomes.mean(axis=1))
        np.testing.assert_allclose(found, store.numpy([mean])[mean], rtol=1e-6)
        with refused("column: 'up_speed_worlds'"):
            store.outcomes("up", "speed")
    assert precompute(fake.specification(), tmp_path / "plain").evaluated == {}
    assert open_store(tmp_path / "plain").families == ()
    for changed, field in (
        ({"up": RAMPS["up"]}, "families.down"),
        (RAMPS | {"up": RAMPS["up"] | {"horizon_s": 7.0}}, "families.up.horizon_s"),
    ):
        with refused(rf"^{field}: "):
            precompute(
                fake.specification(robust=True, families=changed), tmp_path / "store"
            )


def test_points_have_a_column_more(tmp_path, monkeypatch):
    precompute(
        fake.specification(searched=["theta_ref"], robust=True), tmp_path / "store"
    )
    store = open_store(tmp_path / "store", verify=True)
    assert store.parameter_names == (*GAIN_NAMES, "theta_ref")
    assert store.columns[:19] == ("row", *GAIN_NAMES, "theta_ref", "duration_s")
    points = store.points()
    assert np.array_equal(points, sobol_points(7, 0, 50, (*GAINS, THETA_REF)))
    assert points.shape == (50, 17)
    angles = points[:, 16]
    assert (
        THETA_REF.low
        <= angles.min()
        < 0
        < np.deg2rad(25)
        < angles.max()
        <= THETA_REF.high
    )
    merged = merge(tmp_path / "store", tmp_path / "merged.parquet")
    assert np.array_equal(merged.points(), points)
    store.require_bounds()
    monkeypatch.setattr(walker_simulator, "LOW_LEVEL_GAINS", LOW_LEVEL_GAINS[:7])
    with refused(r"^store\.gains\.theta_ref: "):
        store.require_bounds()


def test_points_of_plain_stores_are_what_they_were():
    np.testing.assert_allclose(sobol_points(7, 16, 1, GAINS)[0, :3], POINT_3, rtol=1e-8)
    plain = fake.specification()
    assert plain.simulator.parameters == GAINS
    assert fake.specification(searched=[]).hash == plain.hash
    document = fake.specification(searched=["theta_ref"]).document
    assert list(document["gains"]) == [*GAIN_NAMES, "theta_ref"]
    assert document["gains"]["theta_ref"] == {
        "low": THETA_REF.low,
        "high": THETA_REF.high,
    }
    assert list(document["low_level_gains"]) == list(LOW_LEVEL_NAMES[:7])
    found = difference(fake.specification().document, document)
    assert found[0] == "gains.theta_ref"
    one = fake.specification(searched=["theta_ref", "k_oe"])
    assert one.hash == fake.specification(searched=["k_oe", "theta_ref"]).hash
    assert [parameter.name for parameter in one.simulator.searched] == [
        "k_oe",
        "theta_ref",
    ]
