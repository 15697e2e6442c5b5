import copy
import tomllib
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from storage.document import difference, document_hash
from storage.specification import read_specification
from taichi_nmm.config import Table, read_toml
from taichi_nmm.errors import InputError
from tests.storage.fake import configuration, specification

CONFIGS = Path(__file__).parents[2] / "configs"


def test_shards_cover_the_samples_once() -> None:
    store = specification(samples=50, shard_rows=8)
    ranges = [store.layout.shard_range(number) for number in range(store.layout.shards)]
    rows = [row for first, count in ranges for row in range(first, first + count)]
    assert rows == list(range(50))
    assert ranges[-1] == (48, 2)


def test_shipped_configs_are_valid() -> None:
    flat = read_specification(read_toml(CONFIGS / "store.toml"))
    assert (flat.horizon_s, flat.families, flat.worlds.terrains[0].name) == (5.0, (), "flat")
    families = read_specification(read_toml(CONFIGS / "store-diverse.toml")).families
    assert [family.name for family in families] == ["blocks", "down", "rough", "up"]
    for each in families:
        assert len(each.worlds.bodies) == len(each.worlds.terrains) == 4
        assert (each.min_survival_s, each.horizon_s, each.rule.disturbance) == (5.0, 20.0, 0.15)


def test_robust_settings_differ_from_each_other_and_come_from_the_seed() -> None:
    (robust,) = specification(robust=True).families
    (again,) = specification(robust=True).families
    assert len(np.unique(robust.worlds.bodies.mass_kg[:, 0])) == 6
    assert len({terrain.height_m.tobytes() for terrain in robust.worlds.terrains}) == 6
    assert np.array_equal(robust.worlds.bodies.com_m, again.worlds.bodies.com_m)
    assert np.array_equal(robust.worlds.terrains[5].height_m, again.worlds.terrains[5].height_m)


def test_hash_ignores_machine_and_notices_everything_else() -> None:
    plain = specification()
    assert specification(simulation={"arch": "cpu"}).hash == plain.hash
    changes = [
        {"samples": 51},
        {"seed": 8},
        {"shard_rows": 9},
        {"simulation": {"duration_s": 4.0}},
        {"simulation": {"physics_step_s": 0.0005}},
        {"simulation": {"precision": "float64"}},
        {"simulation": {"contact_relaxation_speed_mps": 0.03}},
        {"terrain": {"kind": "rough"}},
        {"body": {"disturbance": 0.1}},
        {"robust": True},
    ]
    hashes = {specification(**change).hash for change in changes}
    assert len(hashes | {plain.hash}) == len(changes) + 1


def test_a_store_on_another_engine_says_which_version_of_it() -> None:
    plain = specification().document
    assert "engine_version" not in plain
    other = specification(simulation={"engine": "mujoco"}).document
    assert other["engine_version"] == version("mujoco")
    assert other["simulation"]["engine"] == "mujoco"
    changed = {key for key in other if other[key] != plain.get(key)}
    assert changed == {"engine_version", "simulation"}


def test_hash_follows_the_drawn_terrain_not_its_name() -> None:
    rough = {"kind": "rough"}
    seven, eight = specification(terrain=rough), specification(terrain=rough, seed=8)
    found = difference(seven.document["terrain"], eight.document["terrain"], "terrain")
    assert found is not None and found[0] == "terrain.sha256"


def test_difference_names_the_first_field() -> None:
    document = specification().document
    other = copy.deepcopy(document)
    other["simulation"]["duration_s"] = 9.0
    assert difference(document, other) == ("simulation.duration_s", 5.0, 9.0)
    other = copy.deepcopy(document)
    other["columns"].append("new: double")
    assert difference(document, other) == (
        f"columns.{len(document['columns'])}",
        None,
        "new: double",
    )
    assert difference(document, copy.deepcopy(document)) is None


def test_document_survives_json() -> None:
    document = specification(robust=True).document
    import json

    assert document_hash(json.loads(json.dumps(document))) == document_hash(document)


@pytest.mark.parametrize(
    ("line", "field"),
    [
        ("sample = 5", "samples"),
        ("samples = 0", "samples"),
        ("samples = 2_000_000_000", "samples"),
        ('samples = "many"', "samples"),
        ("samples = true", "samples"),
        ("samples = 5\nshard_rows = 0", "shard_rows"),
        ("samples = 5\nseed = -1", "seed"),
        ("samples = 5\ncolour = 1", "colour"),
        ("samples = 5\nsimulation = 3", "simulation"),
        ("samples = 5\n[simulation]\nduration_s = nan", "simulation.duration_s"),
        ("samples = 5\n[simulation]\nduration_s = 0", "simulation.duration_s"),
        ("samples = 5\n[simulation]\nthreads = 2", "simulation.threads"),
        ("samples = 5\n[simulation]\nprecision = 'float16'", "simulation.precision"),
        ("samples = 5\n[terrain]\nkind = 'moon'", "terrain.kind"),
        ("samples = 5\n[body]\ndisturbance = 2.0", "body.disturbance"),
        ("samples = 5\n[body]\nmass = 2.0", "body.mass"),
        ("samples = 5\n[robust]\nhorizon_s = 8.0", "robust.horizon_s"),
        ("samples = 5\n[robust]\nsettings = 65", "robust.settings"),
        ("samples = 5\n[robust]\nsettings = 6\nmin_survival_s = 6", "robust.min_survival_s"),
        ("samples = 5\n[robust]\nsettings = 6\nsurvival = 6", "robust.survival"),
        (
            "samples = 5\n[robust]\nsettings = 6\n[robust.terrain]\nkind = 'rough'\nslope = 2",
            "robust.terrain.slope",
        ),
        (
            "samples = 5\n[robust]\nsettings = 6\n[robust.body]\ndisturbance = -1",
            "robust.body.disturbance",
        ),
    ],
)
def test_bad_configurations_name_the_field(line: str, field: str) -> None:
    with pytest.raises(InputError) as caught:
        read_specification(Table(tomllib.loads(line)))
    assert caught.value.field == field


def test_samples_given_by_hand_are_checked_too() -> None:
    assert read_specification(Table(configuration()), samples=9).samples == 9
    with pytest.raises(InputError, match="samples: 0"):
        read_specification(Table(configuration()), samples=0)
