"""Tune a real machine: what to try next, and results entered by hand, over days."""

import csv
import json
import shlex
import socket
import sys
import tempfile
from argparse import Namespace
from collections.abc import Callable
from contextlib import suppress
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import optuna

from storage.commit import commit_text, require_writable
from study.bench import words
from study.bench.bench import Bench
from study.bench.journal import MOST_DIGITS, Trial
from study.bench.plan import read_columns
from study.bench.words import PROGRAM
from study.options import COMMANDS, require_used
from taichi_nmm import checks
from taichi_nmm.errors import InputError
from taichi_nmm.reading import json_document, toml_document
from taichi_nmm.result import COMPLETED, FELL, RESULT_DTYPE, smooth_cost

EVERYWHERE = "0.0.0.0"
PARAMETERS = "a JSON object of parameters by name"


def main(args: Namespace) -> None:
    """Do the action, and say what it did."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    if args.action not in ACTIONS:
        raise InputError("action", args.action, ", ".join(ACTIONS))
    used = COMMANDS["bench"]["uses"][args.action]
    if args.action == "new":
        require_used(args, used, args.action)
        bench = Bench.new(needed(args.what, "what", "the TOML file of the bench"), args.operator)
        rows = bench.candidates
        print(f"{bench.plan.name}: {rows}; begun by {bench.entries[0].operator}")
        print(f"next: {shlex.join([*PROGRAM, 'next', '--bench', str(bench.plan.path)])}")
        return
    require_used(args, [*used, "--bench"], args.action)
    bench = Bench(args.bench or only_bench(), args.operator)
    if not bench.entries:
        new = f"a bench that was begun: taichi-nmm bench new {bench.plan.path}"
        raise InputError("bench", str(bench.plan.path), new)
    ACTIONS[args.action](bench, args)


def only_bench() -> Path:
    """The TOML file of the working folder that describes a bench."""
    found = [
        path for path in sorted(Path().glob("*.toml"))
        if {"candidates", "goal"} <= toml_document("bench", path, "readable TOML").keys()
    ]  # fmt: skip
    if len(found) != 1:
        names = ", ".join(map(str, found)) or "none in this folder"
        raise InputError("bench", names, "one: give --bench FILE")
    return found[0]


def next_trials(bench: Bench, args: Namespace) -> None:
    """Propose, and print a sheet."""
    if args.json is not None:
        require_writable(args.json, "json")  # before the entry
    trials = bench.next(args.batch, args.repeat)
    for trial in trials:
        print(sheet(bench, trial, args.bench))
    if args.json is not None:
        known = [{"trial": trial.number, "params": trial.params} for trial in trials]
        commit_text(args.json, json.dumps(known, indent=1, ensure_ascii=False) + "\n")


def sheet(bench: Bench, trial: Trial, file: Path | None = None) -> str:
    """A trial to run, for paper; the command line on it names the file of the bench, if any."""
    plan = bench.plan
    return words.sheet(
        trial, name=plan.name, columns=plan.columns, parameters=bench.space,
        remark=plan.horizon_note(), file=file,
    )  # fmt: skip


def record(bench: Bench, args: Namespace) -> None:
    """Enter, correct or add the result of a trial."""
    value = args.value
    columns = others(args)
    if args.log is not None:
        if value is not None:
            raise InputError("value", value, "the value, or --log, which gives it, not both")
        value = of_log(bench, args.log)
    if args.action == "fail":
        seconds = needed(args.seconds, "seconds", "a time")
        bench.record(number(args), failed_s=seconds, columns=columns, note=args.note)
    elif args.action == "correct":
        bench.correct(number(args), value, failed_s=args.seconds, columns=columns, note=args.note)
    elif args.action == "add":
        gains = json_document("gains", needed(args.gains, "gains", PARAMETERS), PARAMETERS)
        value = needed(value, "value", "the trial's value")
        print(f"trial {bench.add([(gains, value, columns, args.note)])[0]}")
    else:
        value = needed(value, "value", "the trial's value, or --log")
        bench.record(number(args), value, columns=columns, note=args.note)
    if value is not None and (odd := bench.odd(value)):
        print(f"warning: {odd}", file=sys.stderr)
    print(bench.entries[-1])


def of_log(bench: Bench, path: Path) -> float:
    """The walker's smooth cost of a walk that was logged."""
    columns = read_columns(path, "log")
    for name in ("time", "position"):
        if name not in columns or not np.isfinite(columns[name].astype(float)).all():
            raise InputError("log", name, "a column of finite numbers")
    time, position = columns["time"].astype(float), columns["position"].astype(float)
    rows = np.zeros(1, RESULT_DTYPE)
    rows["duration_s"], rows["distance_m"] = time[-1] - time[0], position[-1] - position[0]
    rows["end_reason"] = COMPLETED if time[-1] - time[0] >= bench.plan.goal.duration_s else FELL
    rows["mean_speed_mps"] = rows["distance_m"] / max(float(rows["duration_s"][0]), 1e-9)
    return float(smooth_cost(rows)[0])


def status(bench: Bench, args: Namespace) -> None:
    """Print the trials, and the entries."""
    state = bench.state
    print(" | ".join(filter(None, [bench.plan.name, bench.plan.about, state.context])))
    for field, name, why in words.clashes(bench.plan.columns, bench.space):
        warning = f"{field} {name}: {why}; what was typed may stand in another place"
        print(f"warning: {warning}", file=sys.stderr)
    for trial in state.trials.values():
        value = "pending" if trial.value is None else f"{trial.value:.6g}"
        marks = ", ".join(filter(None, ["failed" * trial.failed, trial.context, trial.note]))
        columns = "".join(f"  {name} {given:g}" for name, given in trial.columns.items())
        print(f"trial {trial.number:>3}  {value:<10}{columns}  {marks}".rstrip())
    for entry in bench.entries:
        print(f"{entry}{' (undone)' if entry.number in state.undone else ''}")


def recommend(bench: Bench, args: Namespace) -> None:
    """Print the best gains by the model, and what to repeat; or that nothing is known yet."""
    state = bench.state
    finished = [trial for trial in state.trials.values()
                if trial.value is not None and trial.context == state.context]  # fmt: skip
    if not finished:
        where = f" in {state.context}" if state.context else ""
        print(f"Nothing to recommend yet: no trial is finished{where}.")
        return
    best = bench.best()
    print(best)
    print(json.dumps(dict(best.params), ensure_ascii=False))
    print("The interval is that of the mean, without the noise of a single trial.")
    number = bench.repeat()
    if number is not None:
        print(f"A repeat of trial {number} would tell most: --repeat {number}")


def compare_to_simulator(bench: Bench, args: Namespace) -> None:
    """Print, draw and note what was simulated beside what was seen."""
    from optuna_dashboard import save_note

    from study.pictures import style
    from study.sampler.diagnostics import RankCorrelation

    trials, simulated = bench.state.trials, bench.simulated()
    told = np.array([(simulated[n], trials[n].value) for n in simulated], dtype=float)
    lines = [f"trial {n:>3}  simulated {a:10.4g}  seen {b:10.4g}"
             for n, (a, b) in zip(simulated, told.tolist(), strict=True)]  # fmt: skip
    r = RankCorrelation.of(told[:, 0], told[:, 1]) if len(told) else None
    lines += [f"Rank correlation of simulated and seen: {r or 'too few trials'}", "", bench.worth()]
    print("\n".join(lines))
    path = bench.plan.path.with_name(f"{bench.plan.name}-simulator.png")
    figure = style.new_figure(4.5, 4.0)
    axes = figure.add_subplot()
    style.tidy(axes)
    axes.plot(*told.reshape(-1, 2).T, "o", color=style.BLACK)
    axes.set_xlabel("simulated")
    axes.set_ylabel(f"seen: {bench.plan.goal.value}")
    figure.tight_layout()
    print(f"picture: {style.save_png(figure, path)}")
    save_note(bench.shown(), "\n".join(["```text", *lines, "```"]))


def export(bench: Bench, args: Namespace) -> None:
    """Write the trials as CSV."""
    names, columns = list(bench.space), bench.plan.columns
    text = StringIO()
    write = csv.writer(text, lineterminator="\n").writerow
    write(["trial", "context", "value", "failed", *names, *columns, "operator", "note"])
    for trial in bench.state.trials.values():
        write([
            trial.number, trial.context, trial.value, int(trial.failed),
            *(trial.params[name] for name in names), *(trial.columns.get(c) for c in columns),
            trial.operator, trial.note,
        ])  # fmt: skip
    commit_text(Path(needed(args.what, "what", "a file to write")), text.getvalue())
    print(f"{len(bench.state.trials)} trials: {args.what}")


def import_trials(bench: Bench, args: Namespace) -> None:
    """Enter the trials of a CSV as the operator's own."""
    found = read_columns(Path(needed(args.what, "what", "a CSV file")), "import")
    table = {name: column.tolist() for name, column in found.items()}
    names, columns = list(bench.space), bench.plan.columns
    for name in (*names, "value"):
        if name not in table:
            raise InputError("import", name, f"a file with the columns {', '.join(names)}, value")
    rows = []
    values = checks.numbers("import: value", found["value"])
    for place in np.flatnonzero(np.isfinite(values)).tolist():
        row = {name: column[place] for name, column in table.items()}
        numbers = {name: float(row[name]) for name in columns if row.get(name) is not None}
        own = {name: value for name, value in numbers.items() if np.isfinite(value)}
        note = row.get("note") or ""
        rows.append(({name: row[name] for name in names}, float(row["value"]), own, str(note)))
    print(f"trials {', '.join(map(str, bench.add(rows)))}")


def other(bench: Bench, args: Namespace) -> None:
    """Abort a trial, undo an entry, or go on in another context."""
    if args.action == "abort":
        bench.abort(number(args), args.note)
    elif args.action == "undo":
        print(f"undone: {bench.undo(number(args) if args.what else None)}")
    else:
        bench.context(needed(args.what, "what", "the name of a context"))
    print(bench.entries[-1])


def serve(bench: Bench, args: Namespace) -> None:
    """Serve the page with forms until Ctrl-C."""
    from storage.processes import Processes
    from study.bench.form import Films, application, filming_of
    from study.loopback import HOST, wsgi_server

    address, filming = args.listen or HOST, filming_of(bench, args.simulator)
    with tempfile.TemporaryDirectory() as folder, Processes(1) as makers:
        films = None if filming is None else Films(filming, makers, Path(folder))
        app, token = application(bench, address, films)
        with wsgi_server(app, address, args.port) as server:
            host = socket.gethostname() if address == EVERYWHERE else address
            link = f"http://{host}:{server.server_port}/{f'?token={token}' if token else ''}"
            print(f"bench       {link}  (Ctrl-C ends it)", flush=True)
            with suppress(KeyboardInterrupt):
                server.serve_forever()


def number(args: Namespace) -> int:
    """The number of a trial or an entry."""
    word = needed(args.what, "what", "the number of a trial")
    if not word.isdecimal() or len(word) > MOST_DIGITS:
        raise InputError("what", word, "a number")
    return int(word)


def needed(value: Any, field: str, allowed: str) -> Any:
    """An option that the action cannot do without."""
    if value is None:
        raise InputError(field, "missing", allowed)
    return value


def others(args: Namespace) -> dict[str, float]:
    """Columns that options name."""
    found = {}
    for name, word in args.others.items():
        try:
            found[name] = float(word)
        except ValueError:
            raise InputError(name, word, "a number") from None
    return found


ACTIONS: dict[str, Callable[[Bench, Namespace], None]] = {
    "new": other, "next": next_trials, "record": record, "fail": record, "abort": other,
    "correct": record, "undo": other, "add": record, "context": other, "status": status,
    "recommend": recommend, "compare-to-simulator": compare_to_simulator, "export": export,
    "import": import_trials, "serve": serve,
}  # fmt: skip
