"""Measured worlds: readers of publishers' files, targets, arms, and their comparison."""

import gzip
import json
import re
from itertools import product

import numpy as np
import pytest
from optuna.distributions import (
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from storage.inputs.errors import InputError
from tests.tools.running import load_tool
from tools import measured, peers, runs
from tools.measured import Target
from tools.measured_arms import ARMS, MeasuredRun
from tools.runs import Batches

TOOL = load_tool("compare_measured")
PARAMETERS = {"block": [16, 32, 64], "tile": [1, 2, 3], "flag": [0, 1], "one": [7]}
# Of each configuration (block, tile, flag) on a GPU that is `slow` times as slow.
SETTINGS = [*product(*PARAMETERS.values())]


def times(slow, best=64):
    """Entries of a GPU that likes one size of blocks; that of (16, 1, 0) fails."""
    found = {}
    for setting in SETTINGS:
        entry = dict(zip(PARAMETERS, setting, strict=True))
        block, tile, flag, _ = setting
        entry["time"] = slow * (
            1.0 + abs(np.log2(block / best)) + 0.1 * tile + 0.01 * flag
        )
        found[",".join(map(str, setting))] = entry
    found["16,1,0,7"]["time"] = "RuntimeFailedConfig"
    return found


def write_gpu(data, gpu, entries, **changes):
    """A cache file of Kernel Tuner."""
    folder = data / "kernels" / "convolution_milo"
    folder.mkdir(parents=True, exist_ok=True)
    document = {"tune_params": PARAMETERS, "cache": entries} | changes
    file = folder / f"{gpu}.json.gz"
    file.write_bytes(gzip.compress(json.dumps(document).encode()))
    return file


def write_reactions(data, folder, header, rows):
    """An index of experiments."""
    file = data / "reactions" / folder / "experiment_index.csv"
    file.parent.mkdir(parents=True)
    file.write_text("\n".join([header, *rows]) + "\n")
    return file


AMINATION = "entry,Aryl_halide_SMILES,Additive_SMILES,Base_SMILES,Ligand_SMILES,yield"
COUPLING = (
    "entry,Electrophile_SMILES,Nucleophile_SMILES,Ligand_SMILES,Base_SMILES,"
    "Solvent_SMILES,yield"
)


@pytest.fixture
def data(tmp_path):
    """Three GPUs, two products and three pairs of substrates."""
    data = tmp_path / "data"
    for gpu, slow, best in (("fast", 1.0, 64), ("like", 2.0, 64), ("odd", 3.0, 16)):
        write_gpu(data, gpu, times(slow, best))
    ends = [*product(["c1X", "c2X"], ["Cl", "I"], "ab", ["CN", "CCN"], "PQ")]
    rows = [
        f"{n},{aryl.replace('X', halogen)},{additive},{base},{ligand},{n % 7}"
        for n, (aryl, halogen, additive, base, ligand) in enumerate(ends)
    ]
    write_reactions(data, "aryl_amination", AMINATION, rows[1:])
    parts = [*product("xyz", "B", "PQR", ["[K+].[OH-]", "N"], "uv")]
    rows = [f"{n},{','.join(each)},{n % 5}.5" for n, each in enumerate(parts)]
    write_reactions(data, "suzuki", COUPLING, rows)
    return data


def test_a_gpus_worlds_are_the_slowdowns_of_the_others(data):
    """Parameters of one value go; a word in place of a time is a failure."""
    assert measured.names_of(data, "convolution") == [
        f"convolution-{gpu}" for gpu in ("fast", "like", "odd")
    ]
    found = measured.target(data, "convolution-fast")
    assert found.space == {
        "block": IntDistribution(16, 64, log=True),
        "tile": IntDistribution(1, 3),
        "flag": IntDistribution(0, 1),
    }
    assert len(found) == 18 and found.outcomes.shape == (18, 2)
    row = found.row_nearest_to({"block": 32, "tile": 2, "flag": 1})
    assert found.cost[row] == pytest.approx(2.21)
    best = 1.1  # the other GPUs' best is slower by their factor, 2 and 3, ...
    np.testing.assert_allclose(found.outcomes[row], [2.21 / best, 2.21 / 1.11])
    # ... which is not seen; (16, 1, 0) failed on all
    failed = found.row_nearest_to({"block": 16, "tile": 1, "flag": 0})
    assert np.isinf([found.cost[failed], *found.outcomes[failed]]).all()
    assert np.isfinite(np.delete(found.outcomes, failed, axis=0)).all()
    np.testing.assert_allclose(found.regret(np.array([1.1, 2.2])), [0.0, 100.0])
    half = found.drawn(3)
    assert len(half) == len(half.outcomes) == 9
    assert set(half.outcomes[:, 0]) <= set(found.outcomes[:, 0])


def test_only_common_configurations_are_candidates(data):
    fewer = {key: entry for key, entry in times(1.0).items() if key[:2] != "32"}
    write_gpu(data, "new", fewer)
    found = measured.target(data, "convolution-new")
    assert len(found) == 12 and set(found.columns["block"]) == {16, 64}
    assert found.outcomes.shape == (12, 3)


def test_a_products_halogen_is_chosen(data):
    """Its worlds are the other products' yields with the same components."""
    found = measured.target(data, "amination-1")
    assert [*found.columns] == ["ligand", "additive", "base", "halogen"]
    assert found.space["halogen"] == CategoricalDistribution(("Cl", "I"))
    # the first row was not measured: of 16 candidates 15 are common
    assert len(found) == 15 and found.outcomes.shape == (15, 1)
    settings = {"ligand": "Q", "additive": "a", "base": "CCN", "halogen": "I"}
    row = found.row_nearest_to(settings)
    number = 8 + 3  # of the product's rows
    assert found.settings(row) == settings
    assert found.cost[row] == 100.0 - number % 7
    assert found.outcomes[row, 0] == 100.0 - (16 + number) % 7
    assert found.regret(found.cost).min() == 0.0


def test_a_pair_of_substrates_is_a_machine(data):
    found = measured.target(data, "coupling-2")
    assert found.machine == "y + B" and found.outcomes.shape == (12, 2)
    row = found.row_nearest_to({"ligand": "R", "base": "N", "solvent": "v"})
    assert found.cost[row] == 99.5 - 23 % 5
    assert found.outcomes[row].tolist() == [99.5 - 11 % 5, 99.5 - 35 % 5]


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([1, 2, 4, 8], IntDistribution(1, 8, log=True)),
        ([16, 32, 48, 80], IntDistribution(16, 80, step=16)),
        ([1, 2], IntDistribution(1, 2)),
        ([0.5, 0.75, 2.0], FloatDistribution(0.5, 2.0)),
        (["b", "a"], CategoricalDistribution(("a", "b"))),
    ],
)
def test_a_parameters_values_tell_its_scale(values, expected):
    assert measured._space(np.array(values)) == expected


def refused(data, family, message):
    measured.measurements.cache_clear()
    with pytest.raises(InputError, match=message) as error:
        measured.measurements(data, family)
    assert "\n" not in str(error.value)


def test_bad_kernels_are_one_line(data):
    other = {"block": [16], "unroll": [1]}
    file = write_gpu(data, "new", {}, tune_params=other)
    refused(
        data, "convolution", "new.*: block, unroll.* the parameters of fast.json.gz"
    )
    write_gpu(data, "new", {"a": dict.fromkeys(PARAMETERS, 99) | {"time": 1.0}})
    refused(data, "convolution", "machines with candidates in common")
    failed = {key: each | {"time": "Failed"} for key, each in times(1.0).items()}
    write_gpu(data, "new", failed)
    refused(data, "convolution", "a candidate that did not fail on new")
    for time in (0.0, -1.0, float("nan")):
        write_gpu(data, "new", {"a": next(iter(times(1.0).values())) | {"time": time}})
        refused(data, "convolution", f"Kernel Tuner.* .a time of {time}")
    file.write_bytes(gzip.compress(b'{"tune_params": {}}'))
    refused(data, "convolution", "the parameters of fast")
    for content in (b"", gzip.compress(b"{"), gzip.compress(b'{"cache": {}}')):
        file.write_bytes(content)
        refused(data, "convolution", "new.json.gz.*Kernel Tuner")
    for gpu in ("like", "odd", "new"):
        file.with_name(f"{gpu}.json.gz").unlink()
    refused(data, "convolution", "two machines or more")


def test_units_that_differ_by_a_thousand_are_said(data, capsys):
    """They change nothing: a world is told as times of its own best."""
    before = measured.target(data, "convolution-odd").outcomes
    assert capsys.readouterr().err == ""
    write_gpu(data, "like", times(2000.0))
    measured.measurements.cache_clear()
    measured.target.cache_clear()
    np.testing.assert_allclose(
        measured.target(data, "convolution-odd").outcomes, before
    )
    said = capsys.readouterr().err
    assert "best of like is 2e+03 times that of fast" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("90,c1F,a,CN,P,3", "Aryl_halide_SMILES: 'c1F' .* with Cl, Br or I"),
        ("90,c1I,a,CN,P,101", "data.yield: 101.0 .* 0 to 100 %"),
        ("90,c1I,a,CN,P,", "data.yield: nan .* 0 to 100 %"),
        ("90,c1I,a,CN,P,3", r"c1\*: P, a, CN, I' .* each reaction once"),
    ],
)
def test_bad_reactions_are_one_line(data, row, message):
    file = data / "reactions" / "aryl_amination" / "experiment_index.csv"
    file.write_text(f"{file.read_text()}{row}\n")
    refused(data, "amination", message)
    file.write_text(file.read_text().replace("Base_SMILES", "Solvent_SMILES"))
    refused(data, "amination", "Base_SMILES")


def test_missing_families_are_left_out_with_a_line(data, tmp_path, tool):
    words = ("--out", tmp_path / "new", "--cache", tmp_path / "new", "--trials", 9)
    tool.refuses("data: .*reactions/suzuki", "compare_measured", *words, "--data", ".")
    for target, message in (
        ("coupling-9", "targets: 'coupling-9' cannot"),
        ("amination", "trials: 9 .* at most 7, half of the candidates of amination-1"),
    ):
        targets = ("--data", data, "--targets", target)
        assert tool("compare_measured", *words, *targets) == 2
        left_out, *others, error = tool.err.splitlines()
        assert left_out.startswith("dedispersion is left out: no kernels/dedispersion")
        folders = ("convolution", "gemm", "pnpoly")
        assert [line.partition(";")[0] for line in others] == [
            f"rtx_{each} is left out: no kernels/KernelTuner data/{each}"
            for each in folders
        ]
        assert re.match(f"error: {message}", error)
    assert not (tmp_path / "new").exists()


def run_on(target, arm, trials=6):
    return ARMS[arm].costs(target, 1, Batches(trials)).tolist()


@pytest.mark.filterwarnings("ignore:.*rows repeat:UserWarning")
def test_arms_begin_with_their_rows(data):
    """By the mean, or by the mean rank, of the worlds; ours with the mean."""
    found = measured.target(data, "convolution-fast")
    by_mean = found.cost[np.argsort(found.outcomes.mean(axis=1), kind="stable")]
    assert run_on(found, "ranking-mean", 18) == by_mean.tolist()
    for arm in ("hill", "residual", "tpe"):
        assert run_on(found, arm)[:3] == by_mean[:3].tolist()
    assert run_on(found, "ours-scores")[0] == by_mean[0]
    ranks = np.argsort(np.argsort(found.outcomes, axis=0), axis=0).mean(axis=1)
    first = run_on(found, "ranking-rank")[0]
    assert first in found.cost[ranks == ranks.min()]
    for arm in ("ours", "ours-scores"):
        # no candidate is tried twice, and the last is the one that fails everywhere
        assert sorted(run_on(found, arm, 18)) == sorted(found.cost)


@pytest.mark.filterwarnings("ignore:.*rows repeat:UserWarning")
def test_an_arm_may_see_the_worlds_of_one_kind_alone(data, monkeypatch):
    """GPUs of one maker; where no kind is known, all worlds."""
    assert measured.target(data, "coupling-2").kin.all()
    monkeypatch.setattr(measured, "KINDS", (("odd", "fast"), ("like",)))
    measured.target.cache_clear()
    found = measured.target(data, "convolution-fast")
    measured.target.cache_clear()
    assert found.kin.tolist() == [False, True]  # like, odd
    by_odd = found.cost[np.argsort(found.outcomes[:, 1], kind="stable")]
    assert run_on(found, "ranking-kin", 18) == by_odd.tolist()
    assert run_on(found, "ours-kin")[0] == by_odd[0] != run_on(found, "ours")[0]


def test_peers_are_told_the_best_rows_of_each_world(data, monkeypatch):
    """And some others; a failure is as bad as the worst, and times are logarithms."""
    monkeypatch.setattr(peers, "BEST", 4)
    monkeypatch.setattr(peers, "DRAWN", 2)
    found = measured.target(data, "convolution-fast")
    known = peers.told(found, 3)
    assert known.rows.shape == known.values.shape == (2, 6)
    for world, rows, values in zip(
        found.outcomes.T, known.rows, known.values, strict=True
    ):
        assert rows[:4].tolist() == np.argsort(world, kind="stable")[:4].tolist()
        assert len(set(rows.tolist())) == 6
        ran = np.isfinite(world[rows])
        np.testing.assert_allclose(values[ran], -np.log(world[rows[ran]]))
    told = known.value(np.array([2.0, np.inf, 8.0]))
    np.testing.assert_allclose(told, [-np.log(2.0), -np.log(8.0), -np.log(8.0)])
    assert peers.told(found, 3).rows.tolist() == known.rows.tolist()
    yields = measured.target(data, "coupling-2")
    known = peers.told(yields, 3)
    np.testing.assert_array_equal(known.values[0], -yields.outcomes[known.rows[0], 0])


@pytest.mark.parametrize("size", [1, 4])
def test_a_peer_proposes_after_the_ranking(data, size, monkeypatch):
    monkeypatch.setattr(peers, "BEST", 4)
    monkeypatch.setattr(peers, "DRAWN", 2)
    found = measured.target(data, "convolution-fast")
    seen = []

    def last(_, left, tried, values, wanted):
        """Its candidates from the end."""
        assert not set(left) & set(tried) and len(values) == len(tried)
        seen.append((len(tried), wanted))
        return left[::-1][:wanted]

    costs = peers.after_ranking(lambda seed: last)(found, 1, Batches(6, size))
    first = np.argsort(found.outcomes.mean(axis=1), kind="stable")[:3]
    ends = [row for row in range(17, -1, -1) if row not in first][:3]
    assert costs.tolist() == found.cost[[*first, *ends]].tolist()
    assert seen == {1: [(3, 1), (4, 1), (5, 1)], 4: [(3, 1), (4, 2)]}[size]


def test_a_peer_that_cannot_be_loaded_is_left_out_with_a_line(monkeypatch, capsys):
    def offline():
        raise OSError("no network")

    monkeypatch.setattr(peers, "hub_module", offline)
    assert runs.runnable(["ours", "meta-tpe"], ARMS) == ["ours"]
    said = (
        "MetaLearnTPE after 3 is left out: OptunaHub's samplers/meta_learn_tpe cannot"
    )
    assert capsys.readouterr().err.startswith(said)


@pytest.mark.slow
def test_the_command_writes_a_page_and_a_picture(data, tmp_path, tool):
    out, cache = tmp_path / "out", tmp_path / "cache"
    words = ("--data", data, "--out", out, "--cache", cache, "--processes", 1)
    words = (*words, "--seeds", 2, "--trials", 6, "--targets", "convolution,coupling-2")
    arms = ("ours", "ranking-mean", "hill")
    words = (*words, "--arms", ",".join(arms))
    assert tool("compare_measured", *words) == 0, tool.err
    assert "dedispersion is left out: no kernels/dedispersion_milo; get it" in tool.err
    assert "DOI 10.5281/zenodo.15364124" in tool.err
    names = [*measured.names_of(data, "convolution"), "coupling-2"]
    for name, arm, seed in product(names, arms, range(2)):
        run = MeasuredRun(name, arm, seed, Batches(6), data)
        costs = run.kept(cache)
        assert set(costs) <= set(measured.target(data, name).drawn(seed).cost)
    text = (out / "sampler-measured.md").read_text()
    wanted = [
        "`docs/measured.md` says how",
        "| ours against | after 1 | p | after 3 | p | after 5 | p | after 6 | p |",
        "## convolution: run time, ms",
        "| convolution-odd | odd | 9 | 2 |",
        "| coupling-2 | y + B | 6 | 2 |",
    ]
    assert [line for line in wanted if line not in text] == []
    assert (out / "sampler-measured.png").stat().st_size < 100_000
    before = {file: file.stat().st_mtime_ns for file in cache.rglob("*.json")}
    assert tool("compare_measured", *words) == 0, tool.err
    assert {file: file.stat().st_mtime_ns for file in before} == before
    # other data: its runs are made again
    file = data / "reactions" / "suzuki" / "experiment_index.csv"
    file.write_text(file.read_text().replace("\n0,", "\n00,"))
    runs._fingerprint.cache_clear()
    run = MeasuredRun("coupling-2", "ours", 0, Batches(6), data)
    assert run.code != json.loads(run.file(cache).read_text())["code"]
    assert tool("compare_measured", *words, "--batch", 4) == 0, tool.err
    assert (out / "sampler-measured-by-4.md").exists()


def compared(mine, theirs):
    """Targets of ten seeds and two trials; costs of their seeds are alike."""
    targets, best = [], {}
    for place, costs in enumerate(zip(mine, theirs, strict=True)):
        targets.append(
            Target(
                name=f"coupling-{place}",
                space={"x": FloatDistribution(0.0, 1.0)},
                columns={"x": np.array([0.0, 0.5, 1.0, 0.2])},
                cost=np.full(4, 1.0),
                family="coupling",
                machine="m",
                outcomes=np.ones((4, 3)),
                kin=np.ones(3, bool),
            )
        )
        for arm, each in zip(("ours", "hill"), costs, strict=True):
            best[f"coupling-{place}", arm] = np.tile(each, (10, 1))
    seconds = {arm: np.full((len(mine), 10), 0.4) for arm in ("ours", "hill")}
    return TOOL.Comparison(targets, best, seconds)


def test_a_target_is_won_by_its_seeds():
    good, bad = [[3.0, 1.0]] * 7, [[3.0, 2.0]] * 7
    lines = compared(good, bad).figures()
    assert "| hill climber after 3 | 0:0 | 1 | 7:0 | 0.016 |" in lines
    lines = compared(bad, good).figures()
    assert "| hill climber after 3 | 0:0 | 1 | 0:7 | **0.016** |" in lines
    found = compared(good, bad)
    # a cost of 1 is the least there is; a run of two trials took 0.4 s
    assert found.regret(found.targets[0], "hill").tolist() == [2.0, 1.0]
    assert any(line.endswith("| 2 | 1 | 200 |") for line in found.figures())
    versus = TOOL.Versus.of([3, -1, 0, 10])
    assert versus == (2, 1, 1.0) and versus.cells() == "2:1 | 1"
