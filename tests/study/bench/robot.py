"""A robot: two parameters, six simulated worlds, and the truth, which is none of them."""

import numpy as np

ROWS, DURATION_S = 150, 30.0
TOML = """
name = "walk"
about = "10 m of treadmill"
[candidates]
file = "candidates.csv"
parameters = ["stiffness", "damping"]
log = ["stiffness"]
{known}
[goal]
value = "J/m"
success = 0.5
duration_s = 30
failed_at_once = 6
failed_at_end = 3
[columns.torque]
unit = "N m"
most = 90
"""
WORLDS = 'outcomes = ["world*"]'
FEATURES = 'features = ["world0", "world1"]'


def write(folder, known=WORLDS, more=""):
    """The candidates and the file of a bench."""
    rng = np.random.default_rng(1)
    stiffness, damping = 10 ** rng.uniform(1, 3, ROWS), rng.uniform(0.1, 2.0, ROWS)
    middles = zip(10 ** rng.uniform(1.5, 2.5, 6), rng.uniform(0.5, 1.5, 6), strict=True)
    worlds = [0.2 + abs(np.log(stiffness / k)) + abs(damping - d) for k, d in middles]
    head = "stiffness,damping," + ",".join(f"world{number}" for number in range(6))
    columns = np.column_stack([stiffness, damping, *worlds])
    np.savetxt(
        folder / "candidates.csv", columns, "%.17g", ",", header=head, comments=""
    )
    path = folder / "walk.toml"
    path.write_text(TOML.format(known=known) + more)
    return path


def change(file, old, new):
    """Replace some words of a file."""
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def cost(params, stiffness=150.0):
    """What a trial shows, on a ground that wants this stiffness."""
    softness = abs(np.log(params["stiffness"] / stiffness))
    return 0.2 + softness + abs(params["damping"] - 0.9)


def tell(bench, value, **columns):
    """Run the next trial; its number."""
    (trial,) = bench.next()
    bench.record(trial.number, value, columns=columns)
    return trial.number


def enter(bench, call, given, **named):
    """Make an entry, as tests/assets/bench-entries.toml has it."""
    getattr(bench, call)(*given, **named)


def run(bench, trials, stiffness=150.0):
    """Run the next trials one after another; their parameters."""
    tried = []
    for _ in range(trials):
        (trial,) = bench.next()
        bench.record(trial.number, cost(trial.params, stiffness))
        tried.append(trial.params)
    return tried
