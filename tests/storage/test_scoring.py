import numpy as np

from storage.points import sobol_points
from storage.precompute import score_shard
from storage.schema import columns_of, family_names
from taichi_nmm.parameters import GAIN_NAMES, GAINS
from taichi_nmm.result import END_REASONS, RESULT_DTYPE, SCORE_FIELDS
from tests.storage import fake


def report(_: float) -> None:
    pass


def test_names_of_robust_columns_end_with_the_unit() -> None:
    assert family_names("robust", "m5_sum_mps") == (
        "robust_m5_sum_mean_mps",
        "robust_m5_sum_sd_mps",
    )
    assert family_names("robust", "phi_printed") == (
        "robust_phi_printed_mean",
        "robust_phi_printed_sd",
    )


def test_a_shard_has_its_points_and_every_field_of_the_result() -> None:
    specification = fake.specification()
    table, computed_by = score_shard(specification, 2, report)
    assert columns_of(table.schema) == specification.document["columns"]
    assert table.column_names == ["row", *GAIN_NAMES, *(RESULT_DTYPE.names or ())]
    assert table["row"].to_pylist() == list(range(16, 24))
    gains = sobol_points(specification.seed, 16, 8, GAINS)
    assert np.array_equal(table["l_clr"].to_numpy(), gains[:, 15])
    assert set(table["end_reason"].to_pylist()) <= set(END_REASONS)
    assert computed_by == fake.ENGINE


def test_robust_columns_are_mean_and_spread_over_the_settings() -> None:
    specification = fake.specification(robust=True)
    (robust,) = specification.families
    table, _ = score_shard(specification, 0, report)
    evaluated = table["robust_evaluated"].to_numpy()
    assert 0 < evaluated.sum() < len(evaluated)
    assert np.array_equal(evaluated, table["duration_s"].to_numpy() >= 3.0)
    point = int(np.flatnonzero(evaluated)[0])
    runs = [
        fake.simulate(
            sobol_points(specification.seed, point, 1, GAINS),
            bodies=robust.worlds.bodies.take([setting]),
            terrains=robust.worlds.terrains[setting],
            duration_s=robust.horizon_s,
            progress=lambda now_s, active: None,
        ).rows[0]
        for setting in range(6)
    ]
    for component, _ in SCORE_FIELDS:
        values = np.array([run[component] for run in runs], dtype=float)
        mean, spread = (table[name][point].as_py() for name in family_names("robust", component))
        np.testing.assert_allclose([mean, spread], [values.mean(), values.std()], rtol=1e-12)


def test_points_that_were_not_evaluated_hold_zero() -> None:
    table, _ = score_shard(fake.specification(robust=True), 0, report)
    skipped = ~table["robust_evaluated"].to_numpy()
    for component, _ in SCORE_FIELDS:
        for name in family_names("robust", component):
            assert not table[name].to_numpy()[skipped].any()


def test_a_shard_without_survivors_needs_no_robust_run() -> None:
    specification = fake.specification(robust=True, samples=8, simulation={"duration_s": 60.0})
    object.__setattr__(specification.families[0], "min_survival_s", 60.0)
    table, _ = score_shard(specification, 0, report)
    assert not table["robust_evaluated"].to_numpy().any()


def test_progress_rises_to_one() -> None:
    seen: list[float] = []
    score_shard(fake.specification(robust=True), 0, seen.append)
    assert seen == sorted(seen) and seen[-1] == 1.0
