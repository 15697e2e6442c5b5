import copy
import json
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from storage.inputs.config import Table, read_toml
from storage.specification import read_specification
from storage.tables import difference, document_hash
from taichi_nmm.body import Build
from tests.cases import asset, refused
from tests.storage.fake import configuration, specification

CONFIGS = Path(__file__).parents[2] / "configs"


def test_shards_cover_the_samples_which_may_be_given_by_hand():
    store = specification(samples=50, shard_rows=8)
    ranges = [store.layout.shard_range(number) for number in range(store.layout.shards)]
    rows = [row for first, count in ranges for row in range(first, first + count)]
    assert rows == list(range(50))
    assert ranges[-1] == (48, 2)
    assert read_specification(Table(configuration()), samples=9).samples == 9
    with refused("samples: 0"):
        read_specification(Table(configuration()), samples=0)


def test_shipped_configs_are_valid():
    flat = read_specification(read_toml(CONFIGS / "store.toml"))
    assert (flat.horizon_s, flat.families, flat.worlds.terrains[0].name) == (
        5.0,
        (),
        "flat",
    )
    families = read_specification(read_toml(CONFIGS / "quickstart-store.toml")).families
    assert [family.name for family in families] == ["blocks", "down", "rough", "up"]
    for each in families:
        assert len(each.worlds.bodies) == len(each.worlds.terrains) == 2
        assert (each.min_survival_s, each.horizon_s) == (5.0, 10.0)
        assert each.rule.build == Build(0.15)
    for family, sign in ((families[1], -1), (families[3], 1)):
        slopes = np.diff(family.worlds.terrains[0].height_m) / 0.05 * sign
        assert slopes.max() == pytest.approx(0.20) and slopes.min() == 0.0


def test_hash_ignores_machine_and_notices_everything_else():
    plain = specification()
    assert specification(simulation={"arch": "cpu"}).hash == plain.hash
    changes = asset("other-hashes.toml")["changes"]
    hashes = {specification(**change).hash for change in changes}
    assert len(hashes | {plain.hash}) == len(changes) + 1
    rough = {"kind": "rough"}
    seven, eight = specification(terrain=rough), specification(terrain=rough, seed=8)
    found = difference(seven.document["terrain"], eight.document["terrain"], "terrain")
    assert found[0] == "terrain.sha256"
    plain = specification().document
    assert "engine_version" not in plain
    other = specification(simulation={"engine": "mujoco"}).document
    assert other["engine_version"] == version("mujoco")
    assert other["simulation"]["engine"] == "mujoco"
    changed = {key for key in other if other[key] != plain.get(key)}
    assert changed == {"engine_version", "simulation"}


def test_difference_names_the_first_field():
    document = specification().document
    other = copy.deepcopy(document)
    other["simulation"]["duration_s"] = 9.0
    assert difference(document, other) == ("simulation.duration_s", 5.0, 9.0)
    other = copy.deepcopy(document)
    other["columns"].append("new: double")
    place = f"columns.{len(document['columns'])}"
    assert difference(document, other) == (place, None, "new: double")
    assert difference(document, copy.deepcopy(document)) is None

    document = specification(robust=True).document
    assert document_hash(json.loads(json.dumps(document))) == document_hash(document)


BAD = asset("bad-stores.toml")


@pytest.mark.parametrize(
    ("field", "data"),
    [
        pytest.param(field, data, id=f"{field}: {why}")
        for field, reasons in BAD.items()
        for why, data in reasons.items()
    ],
)
def test_bad_configurations_name_the_field(field, data):
    whole = data if field == "samples" else {"samples": 5} | data
    with refused(rf"^{field}: "):
        read_specification(Table(whole))
