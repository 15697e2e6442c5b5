"""The walker behind the seam of `storage.simulator`; tests of stores run points with it."""

import numpy as np
import pytest

from storage.inputs.config import Table
from taichi_nmm import Settings, walker_simulator
from taichi_nmm.parameters import (
    DEVICE,
    GAIN_NAMES,
    GAINS,
    LOW_LEVEL_GAINS,
    PUBLISHED_GAINS,
    searched_parameters,
    split_points,
)
from taichi_nmm.result import COMPLETED, DIVERGED, ENERGY, FELL, RESULT_DTYPE
from taichi_nmm.walker_simulator import MEASURES, Walker, array_digest
from tests.cases import refused

# Digests by the purpose of the draws.
DIGESTS = {
    101: "5e8565d00aa2dc6f",
    103: "7dcc02119a2f7fec",
}


@pytest.mark.parametrize(
    ("settings", "processes"),
    [
        (Settings(arch="cpu"), 7),
        (Settings(engine="mujoco"), 7),
        (Settings(), 1),
    ],
)
def test_a_core_each(settings, processes, monkeypatch):
    """Where no GPU computes: MuJoCo computes on the processor, even beside a GPU."""
    monkeypatch.setattr(walker_simulator, "may_have_gpu", lambda: True)
    monkeypatch.setattr(walker_simulator, "started_arch", lambda settings: "cuda")
    uncached = walker_simulator.takes_gpu.__wrapped__
    monkeypatch.setattr(walker_simulator, "takes_gpu", uncached)
    walker = Walker(settings)
    assert walker.processes(7) == processes
    assert (walker.points_at_once > 0) == (processes == 1)
    # For small batches, too: a store does not mix bits of both.
    assert walker._one_machine().arch == ("cuda" if processes == 1 else "cpu")


def test_parameters_are_gains_and_named_low_level_gains_and_points_are_split_into_them():
    searched = searched_parameters(["theta_ref", "k_flex"])
    points = np.arange(36.0).reshape(2, 18)
    gains, low_level = split_points(points, searched)
    assert np.array_equal(gains, points[:, :16])
    assert low_level[:, 1].tolist() == [16.0, 34.0] and low_level[:, 7].tolist() == [
        17.0,
        35.0,
    ]
    defaults = [parameter.default for parameter in LOW_LEVEL_GAINS]
    assert low_level[1, [0, 2, 3, 4, 5, 6]].tolist() == [
        defaults[i] for i in (0, 2, 3, 4, 5, 6)
    ]
    gains, low_level = split_points(points[:, :16], ())
    assert np.array_equal(low_level, [defaults, defaults])
    # The parameters of a store.
    assert Walker(Settings()).parameters == Walker.parameters_of(["K_GAS"]) == GAINS
    theta_ref = LOW_LEVEL_GAINS[7]
    assert Walker.parameters_of(["K_GAS", "theta_ref", "nothing"]) == (
        *GAINS,
        theta_ref,
    )


def test_a_store_has_further_columns_where_it_names_them():
    names = ["activation_cubed_mean", "phi_printed"]
    plain, walker = (
        Walker.read(Table(table), "cpu") for table in ({}, {"kept": names})
    )
    assert (*plain.outcomes, *names) == walker.outcomes and walker.document()[
        "kept"
    ] == names
    assert [*plain.columns.descr, (names[0], "<f8")] == walker.columns.descr
    assert "kept" not in plain.document()
    assert ENERGY in plain.outcomes and ENERGY in (plain.columns.names or ())
    # As it had to be named once.
    assert Walker.read(Table({"kept": [ENERGY]}), "cpu") == plain
    for wrong in ("end_reason", "mean_speed_mps", "activation"):
        with refused(f"^kept: '{wrong}' .* a list of duration_s, .*_cubed"):
            Walker.read(Table({"kept": [wrong]}), "cpu")


def test_gains_may_be_fixed_so_that_points_are_of_the_other_parameters_alone():
    tables = {"fixed_gains": "published", "searched": ["exo_torque", "exo_peak"]}
    walker = Walker.read(Table(tables), "cpu")
    assert (
        walker.parameters
        == walker.parameters_of(["exo_peak", "exo_torque"])
        == DEVICE[:2]
    )
    assert walker.fixed == tuple(PUBLISHED_GAINS)
    document = walker.document()
    assert document["fixed_gains"] == dict(
        zip(GAIN_NAMES, PUBLISHED_GAINS, strict=True)
    )
    assert list(document["low_level_gains"]) == [
        each.name for each in LOW_LEVEL_GAINS[:8]
    ]
    assert (
        Walker.read(Table(tables | {"fixed_gains": document["fixed_gains"]}), "cpu")
        == walker
    )
    gains, low_level = split_points(
        np.array([[20.0, 0.4], [30.0, 0.5]]), DEVICE[:2], walker.fixed
    )
    assert np.array_equal(gains, [PUBLISHED_GAINS] * 2)
    assert low_level[:, 8:10].tolist() == [[20.0, 0.4], [30.0, 0.5]]
    outside = document["fixed_gains"] | {"K_GAS": -1.0}
    for changed, message in (
        ({"searched": []}, r"^searched: 'nothing'"),
        ({"fixed_gains": "nobody"}, r"^gains: 'nobody'"),
        ({"fixed_gains": {"K_GAS": 1.0}}, r"^fixed_gains\.K_GLU: None"),
        ({"fixed_gains": outside}, r"^fixed_gains\.K_GAS: -1\.0"),
    ):
        with refused(message):
            Walker.read(Table(tables | changed), "cpu")


def test_contact_of_our_own_engine_is_refused_with_mujoco():
    walker = Walker(Settings(engine="mujoco"))
    tables = {"world": {"contact_stiffness": [0.5, 2.0]}}
    with refused(r"^families\.up\.world\.contact_stiffness: "):
        walker.read_worlds(Table(tables, "families.up"))
    assert Walker(Settings()).read_worlds(Table(tables)).ranges.contact_stiffness == (
        0.5,
        2.0,
    )


@pytest.mark.parametrize(("purpose", "digest"), DIGESTS.items())
def test_worlds_of_a_seed_are_those_of_0_2_0(purpose, digest):
    family = {
        "terrain": {"kind": "rough"},
        "body": {"disturbance": 0.1},
        "world": {"strength": [0.8, 1.2], "friction": [0.5, 1]},
    }
    seeds = [
        np.random.SeedSequence(7, spawn_key=(purpose, index)) for index in range(2)
    ]
    drawn = Walker(Settings()).read_worlds(Table(family)).draw(seeds)
    heights = [terrain.height_m for terrain in drawn.terrains]
    # The newer catches are left out.
    surroundings = list(vars(drawn.surroundings).values())[:7]
    parts = (*vars(drawn.bodies).values(), *surroundings, *heights)
    assert array_digest(*parts)[:16] == digest
    walker = Walker(Settings()).read_worlds
    assert walker(Table(family)).document(drawn)["world"]["sha256"] == array_digest(
        *surroundings
    )
    catches = walker(
        Table(family | {"world": family["world"] | {"catch_ns": [0.0, 2.0]}})
    )
    both = catches.draw(seeds)
    assert np.array_equal(both.surroundings.strength, drawn.surroundings.strength)
    every = array_digest(*surroundings, both.surroundings.catch_ns)
    assert catches.document(both)["world"]["sha256"] == every


def test_a_search_selects_for_distance_walked_and_not_for_standing():
    rows = np.zeros((3, 2), RESULT_DTYPE)
    rows["duration_s"] = [[8.0, 4.0], [8.0, 8.0], [8.0, 2.0]]
    rows["distance_m"] = [[8.0, 4.0], [0.4, 0.4], [8.0, 1e9]]  # walks, stands, diverges
    rows["end_reason"] = [
        [COMPLETED, FELL],
        [COMPLETED, COMPLETED],
        [COMPLETED, DIVERGED],
    ]
    rows["mean_speed_mps"] = [[1.0, 2.0], [0.05, 0.05], [1.0, np.inf]]
    objective, measures = Walker(Settings()).judge(rows, 8.0)
    np.testing.assert_allclose(objective, [0.75, 1.0 / 8.0, 0.5])
    assert measures.shape == (3, len(MEASURES))
    np.testing.assert_allclose(
        measures[:, 0], [(8.0 + 2 * 4.0) / 12.0, 0.05, 8.0 / 10.0]
    )


def test_digest_ignores_the_last_bits_and_the_sign_of_zero():
    values = np.array([[0.0, 1.0], [2.0, 3.0]])
    assert array_digest(values) == array_digest(*values)
    assert array_digest(-values[:1] * 0.0) == array_digest(np.zeros((1, 2)))
    assert array_digest(values) == array_digest(values + 1e-10)
    assert array_digest(values) != array_digest(values + 1e-8)
