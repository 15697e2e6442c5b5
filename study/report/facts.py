"""How the runs of an experiment were made, as far as its folder says: machine, stores, versions."""

from contextlib import suppress
from pathlib import Path
from typing import Any

from study.experiment.stores import store_digest
from study.report.runs import Results
from study.report.words import escaped
from taichi_nmm.errors import InputError

SECONDS_A_MINUTE = 60.0


def facts(results: Results) -> dict[str, str]:
    """A line a fact; what the folder does not say is left out."""
    sessions = results.facts.get("sessions", [])
    simulation = results.facts.get("simulation", {})
    found = {
        "date": _days(sessions),
        "machine": "; ".join(dict.fromkeys(_words(each.get("machine")) for each in sessions)),
        "wall time": _wall_time(sessions),
        "versions": _words(results.facts.get("versions")),
        "cost": results.cost,
        "a trial": f"{simulation['duration_s']:g} s" if "duration_s" in simulation else "",
        "simulation": _words({k: v for k, v in simulation.items() if k != "duration_s"}),
        "body": _words(results.facts.get("body")),
        "terrain": str(results.facts.get("terrain", {}).get("name", "")),
        "searched beside the 16 gains": ", ".join(results.facts.get("searched", [])),
        "seed": str(results.facts.get("seed", "")),
    }
    return {name: escaped(value) for name, value in found.items() if value}


def known_stores(results: Results) -> dict[str, Path]:
    """The stores that still are what the results were made with, by key.

    The latest session that says where they are counts; folders from before such sessions have none.
    """
    digests: dict[str, str] = results.facts.get("stores", {})
    sessions = [each["stores"] for each in results.facts.get("sessions", []) if "stores" in each]
    known = {}
    for key, path in (sessions[-1] if sessions else {}).items():
        with suppress(InputError, OSError):  # not there, or damaged
            if store_digest(Path(path)) == digests.get(key):
                known[key] = Path(path)
    return known


def _days(sessions: list[dict[str, Any]]) -> str:
    """The first and the last day on which it ran."""
    days = sorted({str(each["started"])[:10] for each in sessions if "started" in each})
    return " to ".join(dict.fromkeys([days[0], days[-1]])) if days else ""


def _wall_time(sessions: list[dict[str, Any]]) -> str:
    """Minutes that all sessions took together, pictures and films not included."""
    if not sessions:
        return ""
    seconds = sum(float(each.get("wall_s", 0.0)) for each in sessions)
    trials = sum(int(each.get("trials", 0)) for each in sessions)
    times = f" in {len(sessions)} sessions" if len(sessions) > 1 else ""
    return f"{seconds / SECONDS_A_MINUTE:.1f} min for {trials:,} trials{times}"


def _words(values: dict[str, Any] | None) -> str:
    """Names and values in a line."""
    return ", ".join(f"{name} {value}" for name, value in (values or {}).items())
