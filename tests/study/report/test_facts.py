"""What a folder says of how its runs were made, and where its stores are."""

import json
from dataclasses import replace
from pathlib import Path

from study.experiment.stores import store_digest
from study.report.markdown import facts
from study.report.runs import known_stores, read_results
from tests.study.report import synthetic


def test_facts_of_several_sessions(tmp_path: Path) -> None:
    folder = synthetic.write(tmp_path, {"dog": (0.1, 0.0)}, 2, 3)
    machine = {"system": "Linux", "cores": 2}
    sessions = [
        {
            "started": f"2026-11-{day}T10:00:00+00:00",
            "trials": 3,
            "wall_s": 90.0,
            "machine": machine,
        }
        for day in (21, 22)
    ]
    (folder / "run.json").write_text(json.dumps({"sessions": sessions}))
    found = facts(read_results(folder))
    assert found["date"] == "2026-11-21 to 2026-11-22"
    assert found["wall time"] == "3.0 min for 6 trials in 2 sessions"
    assert found["machine"] == "system Linux, cores 2"
    (folder / "run.json").unlink()
    assert "date" not in facts(read_results(folder))


def test_stores_that_still_are_what_the_results_were_made_with_are_known(tmp_path: Path) -> None:
    paths = {name: tmp_path / f"{name}.parquet" for name in ("flat", "mild", "ramps")}
    for name in ("flat", "mild"):
        paths[name].write_text(name)
    digests = {key: store_digest(paths["flat"]) for key in paths}
    made = read_results(synthetic.write(tmp_path / "made-up", {"dog": (0.1, 0.0)}, 1, 3))

    def known(*sessions: dict[str, str]) -> dict[str, Path]:
        noted = [{"trials": 1}, *({"stores": stores} for stores in sessions), {"trials": 0}]
        return known_stores(replace(made, facts={"stores": digests, "sessions": noted}))

    where = {key: str(path) for key, path in paths.items()}
    assert known(where) == {"flat": paths["flat"]}
    assert known({"flat": "nowhere"}, where) == {"flat": paths["flat"]}
    assert known(where, {"flat": "nowhere"}) == {}  # the latest counts
    assert known() == known_stores(replace(made, facts={})) == {}
