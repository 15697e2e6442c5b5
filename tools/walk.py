"""Simulate one controller and show how it walks.

    python tools/walk.py --gains reference --config configs/flat.toml --out out/walk/reference

writes strip.png, gait_cycle.png and movie.mp4 to the folder. Gains are a name (reference, K_T) or a
JSON file of the 16 gains. Exit codes: 0, 2 bad input, 130 interrupted.
"""

import argparse
import json
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from tqdm import tqdm

import taichi_nmm
from storage.commit import writable
from study.command import run_command
from study.draws import Purpose, stream
from study.pictures import find_ffmpeg, write_gait_cycle, write_movie, write_strip
from taichi_nmm.body import GRAVITY_MPS2, Bodies
from taichi_nmm.config import read_bodies, read_settings, read_terrain, read_toml
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAIN_NAMES, load_gains
from taichi_nmm.settings import ARCHITECTURES, Settings
from taichi_nmm.terrain import Terrain

ANGLES = (
    "knee_peak_swing_rad", "ankle_strike_rad", "ankle_takeoff_rad", "trunk_mean_rad",
)  # fmt: skip
REPOSITORY = Path(__file__).resolve().parents[1]
LARGEST_DURATION_S = 1000.0
LONGEST_MOVIE_S = 120.0
RECORD_RATE_HZ = 200.0
REPORTED = (
    "duration_s", "distance_m", "mean_speed_mps", "cost_of_transport_jpkgpm", "step_count",
    "phi_printed", "phi_corrected",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Setting:
    """Where and how long one controller walks."""

    duration_s: float
    settings: Settings
    bodies: Bodies
    terrain: Terrain

    @property
    def body_weight_n(self) -> float:
        """Of the one body."""
        return float(self.bodies.mass_kg[0].sum() * GRAVITY_MPS2)


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gains", default="reference", help="reference, K_T or FILE.json")
    parser.add_argument(
        "--config", default=REPOSITORY / "configs" / "flat.toml", help="TOML (configs/flat.toml)"
    )
    parser.add_argument("--duration", type=float, help="seconds; default: the config's")
    parser.add_argument("--out", type=Path, help="for the pictures; default: out/walk/NAME")
    parser.add_argument(
        "--movie-seconds", type=float, default=8.0, help="length; 0: no movie (%(default)s)"
    )
    parser.add_argument("--arch", choices=ARCHITECTURES, help="overrides the config's")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object")
    return parser.parse_args()


def read_setting(path: str | Path, duration_s: float | None, arch: str | None) -> Setting:
    """The config's body, ground and simulation; what a study's config says besides is not ours."""
    table = read_toml(path)
    seed = table.integer("seed", 0)
    simulation = table.table("simulation")
    configured = simulation.number("duration_s", 100.0, 0.1, LARGEST_DURATION_S)
    setting = Setting(
        duration_s=configured if duration_s is None else duration_s,
        settings=read_settings(simulation, arch),
        bodies=read_bodies(table.table("body"), stream(seed, Purpose.BODY)),
        terrain=read_terrain(table.table("terrain"), stream(seed, Purpose.TERRAIN)),
    )
    simulation.done()
    for of_studies in ("objective", "dog", "best"):
        table.table(of_studies)
    table.text("name", "")
    table.done()
    return setting


def check_range(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise InputError(name, value, f"{low:g} to {high:g}")


def make_folder(folder: Path) -> None:
    """Create the folder and see that it can be written, before the work."""
    with writable(folder):
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()


def simulate(gains: np.ndarray, setting: Setting) -> taichi_nmm.Result:
    with tqdm(total=setting.duration_s, unit="s", desc="walking", disable=None) as bar:

        def progress(simulated_s: float, active: int) -> None:
            bar.update(simulated_s - bar.n)

        return taichi_nmm.simulate(
            gains,
            duration_s=setting.duration_s,
            bodies=setting.bodies,
            terrains=setting.terrain,
            settings=setting.settings,
            record=[0],
            record_rate_hz=RECORD_RATE_HZ,
            progress=progress,
        )


def write_pictures(
    result: taichi_nmm.Result, setting: Setting, folder: Path, title: str, movie_s: float
) -> dict[str, str]:
    """Paths of the pictures by what they show."""
    trajectory = result.trajectories[0]
    terrain = setting.terrain
    paths = {
        "strip": write_strip(folder / "strip.png", trajectory, terrain, title),
        "gait_cycle": write_gait_cycle(
            folder / "gait_cycle.png", trajectory, setting.body_weight_n, title
        ),
    }
    if movie_s > 0:
        paths["movie"] = write_movie(folder / "movie.mp4", trajectory, terrain, movie_s, title)
    return {name: str(path) for name, path in paths.items()}


def outcome(row: np.void, end_reason: str) -> str:
    """How a walk ended, in one line."""
    how = "walked" if end_reason == "completed" else f"{end_reason} after"
    return (
        f"{how} {row['duration_s']:.1f} s, {row['distance_m']:.1f} m"
        f" at {row['mean_speed_mps']:.2f} m/s"
    )


def summary(name: str, setting: Setting, row: np.void, end_reason: str) -> str:
    """What a person wants to know, a line each."""
    degrees = {field: float(np.rad2deg(row[field])) for field in ANGLES}
    return "\n".join(
        (
            f"{name} on {setting.terrain.name}: {outcome(row, end_reason)}",
            f"cost of transport   {row['cost_of_transport_jpkgpm']:.2f} J/(kg m)",
            f"scored steps        {row['step_count']}, {row['step_length_mean_m']:.3f} m"
            f" and {row['step_duration_mean_s']:.3f} s each,"
            f" double support {100 * row['double_support_fraction']:.0f} %",
            f"knee peak in swing  {degrees['knee_peak_swing_rad']:.0f} deg flexed",
            f"ankle               {degrees['ankle_strike_rad']:+.0f} deg at strike,"
            f" {degrees['ankle_takeoff_rad']:+.0f} deg at take-off (plantarflexion +)",
            f"trunk               {degrees['trunk_mean_rad']:+.1f} deg (forward +)",
            f"score               phi {row['phi_printed']:.1f} as printed,"
            f" {row['phi_corrected']:.1f} corrected",
        )
    )


def report(
    gains: np.ndarray, row: np.void, end_reason: str, paths: dict[str, str]
) -> dict[str, Any]:
    """The same for programs: one object of plain values."""
    numbers = {field: row[field].item() for field in REPORTED}
    return {
        # JSON has no NaN: what a walker that diverged has not got is null.
        **{field: value if np.isfinite(value) else None for field, value in numbers.items()},
        "end_reason": end_reason,
        "gains": dict(zip(GAIN_NAMES, gains.tolist(), strict=True)),
        "pictures": paths,
    }


def main() -> None:
    args = parse()
    gains = load_gains(args.gains)
    if args.duration is not None:
        check_range("duration", args.duration, 0.1, LARGEST_DURATION_S)
    check_range("movie-seconds", args.movie_seconds, 0.0, LONGEST_MOVIE_S)
    setting = read_setting(args.config, args.duration, args.arch)
    if args.movie_seconds > 0:
        find_ffmpeg()
    name = Path(args.gains).stem
    folder = args.out or Path("out") / "walk" / name
    make_folder(folder)
    result = simulate(gains, setting)
    row, end_reason = result.rows[0], str(result.end_reason[0])
    title = f"{name} on {setting.terrain.name}: {outcome(row, end_reason)}"
    paths = write_pictures(result, setting, folder, title, args.movie_seconds)
    if args.json:
        print(json.dumps(report(gains, row, end_reason, paths)))
        return
    print(summary(name, setting, row, end_reason))
    for shows, path in paths.items():
        print(f"{shows.replace('_', ' '):<19} {path}")


if __name__ == "__main__":
    run_command(main)
