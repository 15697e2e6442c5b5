"""Draw the moving picture of README.md: on the same rough ground one walker falls, then one walks.

    python tools/readme_picture.py --out docs/img/falls-then-walks.gif

The walkers are simulated anew, so a change of the model shows here. Exit codes: 0, 2 bad input.
"""

from pathlib import Path

from checkout import guarded_imports, run_command

with guarded_imports():
    from PIL import Image

    import taichi_nmm
    from storage.commit import commit, require_folder
    from study.options import Options
    from study.pictures.scene import Film, frames
    from taichi_nmm import terrain

FILM = Film((640, 320), 12, effort="", quality=0, threads=1)  # only size and rate matter to a GIF
GROUND = terrain.rough(seed=1)
WALKERS = (
    ("gait 'reference': falls", taichi_nmm.load_gains("reference")),
    ("gait 'published gains': walks", taichi_nmm.PUBLISHED_GAINS),
)
DURATION_S = 20.0
SHOWN_S = 4.5  # of each walk's end
PAUSE_MS = 1200  # on the last picture of each walk
COLOURS = 48


def write_gif(path: Path) -> None:
    """Simulate and draw the walks; one palette for all frames, or the background flickers."""
    gains = [vector for _, vector in WALKERS]
    result = taichi_nmm.simulate(gains, duration_s=DURATION_S, terrains=GROUND, record=[0, 1])
    shown, times_ms = [], []
    for (title, _), trajectory in zip(WALKERS, result.trajectories, strict=True):
        walk = list(frames(trajectory, GROUND, SHOWN_S, title, FILM))
        shown += [Image.frombytes("RGB", FILM.size_px, frame) for frame in walk]
        times_ms += [1000 // FILM.rate_hz] * (len(walk) - 1) + [PAUSE_MS]
    palette = shown[0].quantize(COLOURS)
    few = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in shown]
    few[0].save(
        path, "GIF", save_all=True, append_images=few[1:], duration=times_ms, loop=0, optimize=True
    )


def main() -> None:
    """Write the picture."""
    parser = Options(Path(__file__))
    place = Path("docs/img/falls-then-walks.gif")
    parser.path("--out", "where the picture goes (%(default)s)", "FILE", default=place)
    path = parser.parse_args().out
    require_folder(path.parent)
    commit(path, write_gif, lambda file: Image.open(file).verify())
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    run_command(main)
