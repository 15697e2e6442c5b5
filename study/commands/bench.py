"""Tune a real machine: what to try next, and results entered by hand, over days."""

import json
import shlex
import socket
import sys
import tempfile
import warnings
from argparse import Namespace
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import optuna

from storage.commit import commit_text, require_writable
from storage.inputs import typed
from storage.inputs.errors import InputError, listed
from storage.inputs.reading import json_document, toml_document
from study.bench import words
from study.bench.bench import Bench
from study.bench.candidates import beyond_bounds
from study.bench.exchange import export_text, read_trials
from study.bench.journal import MOST_DIGITS, Trial
from study.bench.words import PROGRAM
from study.options import COMMANDS, require_used

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
        bench = Bench.new(
            needed(args.what, "what", "the TOML file of the bench"), args.operator
        )
        rows = bench.candidates
        print(f"{bench.plan.name}: {rows}; begun by {bench.entries[0].operator}")
        warn([*bench.plan.cautions(), *bench.doubts()])
        print(
            f"next: {shlex.join([*PROGRAM, 'next', '--bench', str(bench.plan.path)])}"
        )
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
        path
        for path in sorted(Path().glob("*.toml"))
        if {"candidates", "goal"}
        <= toml_document("bench", path, "readable TOML").keys()
    ]
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
        trial,
        name=plan.name,
        columns=plan.columns,
        parameters=bench.space,
        remark=plan.horizon_note(),
        file=file,
    )


def record(bench: Bench, args: Namespace) -> None:
    """Enter, correct or add the result of a trial."""
    value = args.value
    columns = others(args)
    if args.log is not None:
        from study.bench.walk_log import cost_of_log

        if value is not None:
            raise InputError(
                "value", value, "the value, or --log, which gives it, not both"
            )
        value = cost_of_log(args.log, bench.plan.goal.duration_s)
    which = None if args.action == "add" else number(args)
    if args.action == "fail":
        seconds = needed(args.seconds, "seconds", "a time")
        bench.record(number(args), failed_s=seconds, columns=columns, note=args.note)
    elif args.action == "correct":
        bench.correct(
            number(args), value, failed_s=args.seconds, columns=columns, note=args.note
        )
    elif args.action == "add":
        gains = json_document(
            "gains", needed(args.gains, "gains", PARAMETERS), PARAMETERS
        )
        value = needed(value, "value", "the trial's value")
        (which,) = bench.add([(gains, value, columns, args.note)])
        print(f"trial {which}")
    else:
        value = needed(value, "value", "the trial's value, or --log")
        bench.record(number(args), value, columns=columns, note=args.note)
    odd = "" if value is None else bench.odd(value)
    warn([odd] if odd else bench.doubts(which))
    print(bench.entries[-1])


def warn(lines: Sequence[str]) -> None:
    """Print what is to be looked at once more."""
    for line in lines:
        print(f"warning: {line}", file=sys.stderr)


def status(bench: Bench, args: Namespace) -> None:
    """Print the trials, and the entries."""
    state = bench.state
    print(" | ".join(filter(None, [bench.plan.name, bench.plan.about, state.context])))
    for field, name, why in words.clashes(bench.plan.columns, bench.space):
        warn([f"{field} {name}: {why}; what was typed may stand in another place"])
    warn(list(beyond_bounds(bench.plan.candidates, bench.space)))
    for trial in state.trials.values():
        value = "pending" if trial.value is None else f"{trial.value:.6g}"
        marks = ", ".join(
            filter(None, ["failed" * trial.failed, trial.context, trial.note])
        )
        columns = "".join(
            f"  {name} {given:g}" for name, given in trial.columns.items()
        )
        print(f"trial {trial.number:>3}  {value:<10}{columns}  {marks}".rstrip())
    for entry in bench.entries:
        print(f"{entry}{' (undone)' if entry.number in state.undone else ''}")
    warn(bench.doubts())


def recommend(bench: Bench, args: Namespace) -> None:
    """Print the best gains by the model, and what to repeat; or that nothing is known yet."""
    state = bench.state
    where = f" in {state.context}" if state.context else ""
    finished = [
        trial for trial in state.of_context(state.context) if trial.value is not None
    ]
    if not finished:
        print(f"Nothing to recommend yet: no trial is finished{where}.")
        return
    if not any(bench.plan.may_be_named(trial) for trial in finished):
        print(f"Nothing to recommend yet: all trials{where} failed or broke a limit.")
        return
    best = bench.best()
    print(best)
    print(words.json_line(dict(best.params), sys.stdout.encoding))
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
    lines = [
        f"trial {n:>3}  simulated {a:10.4g}  seen {b:10.4g}"
        for n, (a, b) in zip(simulated, told.tolist(), strict=True)
    ]
    r = RankCorrelation.of(told[:, 0], told[:, 1]) if len(told) else None
    lines += [
        f"Rank correlation of simulated and seen: {r or 'too few trials'}",
        "",
        bench.worth(),
    ]
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
    path = Path(needed(args.what, "what", "a file to write"))
    commit_text(path, export_text(bench))
    print(f"{len(bench.state.trials)} trials: {path}")


def import_trials(bench: Bench, args: Namespace) -> None:
    """Enter the trials of a CSV, those that are not there yet."""
    path = Path(needed(args.what, "what", "a CSV file"))
    with warnings.catch_warnings(record=True, action="always") as said:
        entered, known = bench.add_new(read_trials(bench, path))
    warn([str(each.message) for each in said])
    if entered:
        print(f"trials {', '.join(map(str, entered))}")
    if known:
        print(
            f"there already: trials {', '.join(map(str, known))}; `add` enters a trial again"
        )


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
    "new": other,
    "next": next_trials,
    "record": record,
    "fail": record,
    "abort": other,
    "correct": record,
    "undo": other,
    "add": record,
    "context": other,
    "status": status,
    "recommend": recommend,
    "compare-to-simulator": compare_to_simulator,
    "export": export,
    "import": import_trials,
    "serve": serve,
}
