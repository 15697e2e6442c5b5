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
from storage.foreign_tables import ForeignTable
from study.bench import words
from study.bench.bench import Bench
from study.bench.candidates import beyond_bounds, choices_of
from study.bench.journal import MOST_DIGITS, Trial
from study.bench.words import PROGRAM
from study.options import COMMANDS, require_used
from taichi_nmm import typed
from taichi_nmm.errors import InputError, listed
from taichi_nmm.reading import json_document, toml_document

EVERYWHERE = "0.0.0.0"
PARAMETERS = "a JSON object of parameters by name"


def main(args: Namespace) -> None:
    """Do the action, and say what it did."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    if args.action not in ACTIONS:
        raise InputError("action", args.action, listed(ACTIONS, args.action))
    used = COMMANDS["bench"]["uses"][args.action]
    if args.action == "new":
        require_used(args, used, args.action)
        bench = Bench.new(needed(args.what, "what", "the TOML file of the bench"), args.operator)
        rows = bench.candidates
        print(f"{bench.plan.name}: {rows}; begun by {bench.entries[0].operator}")
        for line in bench.plan.cautions():
            print(f"warning: {line}", file=sys.stderr)
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
        names = listed(found) or "none in this folder"
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
        from study.bench.walk_log import cost_of_log

        if value is not None:
            raise InputError("value", value, "the value, or --log, which gives it, not both")
        value = cost_of_log(args.log, bench.plan.goal.duration_s)
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


def status(bench: Bench, args: Namespace) -> None:
    """Print the trials, and the entries."""
    state = bench.state
    print(" | ".join(filter(None, [bench.plan.name, bench.plan.about, state.context])))
    for field, name, why in words.clashes(bench.plan.columns, bench.space):
        warning = f"{field} {name}: {why}; what was typed may stand in another place"
        print(f"warning: {warning}", file=sys.stderr)
    for warning in beyond_bounds(bench.plan.candidates, bench.space):
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
    names, columns = list(bench.space), bench.plan.columns
    path = Path(needed(args.what, "what", "a CSV file"))
    known = ForeignTable.read("import", path)
    for name in (*names, "value"):
        if name not in known.names:
            raise InputError(
                "import", name, f"a file with the columns {listed(names, name)}, value"
            )
    choices = {name: choices_of(distribution) for name, distribution in bench.space.items()}
    named = [name for name in names if choices[name]]
    found = ForeignTable.read("import", path, words=[*named, "note"])
    params = dict[str, list[Any]]()
    for name in names:
        given = found.values(name)
        is_text = given.dtype.kind == "O" and name not in named
        params[name] = (found.numbers(name) if is_text else given).tolist()  # or says what is wrong
    for name in named:
        told_words = ["" if word is None else str(word) for word in params[name]]
        params[name] = [choices[name].get(word, word) for word in told_words]
    values = found.numbers("value")
    told = {name: found.numbers(name) for name in columns if name in found.names}
    notes = found.values("note").tolist() if "note" in found.names else [""] * len(found)
    rows = []
    for place in np.flatnonzero(np.isfinite(values)).tolist():
        own = {name: float(of[place]) for name, of in told.items() if np.isfinite(of[place])}
        row = {name: of[place] for name, of in params.items()}
        rows.append((row, float(values[place]), own, str(notes[place] or "")))
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
        found[name] = typed.number(name, word)
    return found


ACTIONS: dict[str, Callable[[Bench, Namespace], None]] = {
    "new": other, "next": next_trials, "record": record, "fail": record, "abort": other,
    "correct": record, "undo": other, "add": record, "context": other, "status": status,
    "recommend": recommend, "compare-to-simulator": compare_to_simulator, "export": export,
    "import": import_trials, "serve": serve,
}  # fmt: skip
