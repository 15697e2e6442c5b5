"""Tune a real machine: what to try next, and results entered by hand, over days."""

import json
import shlex
import socket
import sys
import tempfile
import warnings
from argparse import Namespace
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import optuna

from storage.commit import commit_text, require_writable
from storage.inputs import typed
from storage.inputs.errors import InputError, listed
from storage.inputs.reading import json_document, toml_document
from study.bench.bench import Bench, Own
from study.bench.candidates import beyond_bounds, repeated
from study.bench.journal import Trial
from study.bench.words import PROGRAM, clashes, number_of, shown, times
from study.cli import ProgressBar
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
        path = needed(args.what, "what", "the TOML file of the bench")
        bench = Bench.new(path, args.operator)
        rows = bench.candidates
        print(f"{bench.plan.name}: {rows}; begun by {bench.entries[0].operator}")
        warn([*repeated(rows.rows), *bench.plan.cautions(), *bench.doubts()])
        if bench.plan.asked is not None:
            print(f"points off the table are simulated: {bench.plan.asked}")
        line = [*PROGRAM, "next", "--bench", str(bench.plan.path)]
        print(f"next: {shlex.join(line)}")
        tell_forecast(bench, is_asked=False)
        return
    require_used(args, [*used, "--bench"], args.action)
    bench = Bench(args.bench or only_bench(), args.operator)
    if not bench.entries:
        new = f"a bench that was begun: taichi-nmm bench new {bench.plan.path}"
        raise InputError("bench", str(bench.plan.path), new)
    ACTIONS[args.action](bench, args)


def only_bench() -> Path:
    """The TOML file of the working folder that describes a bench."""
    found = []
    for path in sorted(Path().glob("*.toml")):
        tables = toml_document("bench", path, "readable TOML")
        if "candidates" in tables and "goal" in tables:
            found.append(path)
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


def sheet(bench: Bench, trial: Trial, file: Path | None) -> str:
    """A trial to run, for paper, with the command line that enters its result.

    Args:
        bench: that it is of.
        trial: that runs next.
        file: of the bench, if the command line must name it.
    """
    plan = bench.plan
    head = " | ".join(filter(None, [f"trial {trial.number}", plan.name, trial.context]))
    if trial.aborted:
        head += f" (again: broken off {times(trial.aborted)})"
    width = max(map(len, trial.params))
    values = [f"  {name:<{width}}  {shown(of)}" for name, of in trial.params.items()]
    line = [*PROGRAM, "record", str(trial.number)]
    if file is not None:
        line += ["--bench", str(file)]
    enter = shlex.join(line)
    # A bench of 0.3.0 may have columns whose options are something else.
    named = clashes(plan.columns, bench.space)
    untyped = {name for field, name, _ in named if field == "columns"}
    for option in ("value", *(name for name in plan.columns if name not in untyped)):
        enter += f" {shlex.quote(f'--{option}')} ..."
    lines = [head, *values, trial.why, plan.horizon_note(), f"enter: {enter}"]
    if untyped:
        names = ", ".join(sorted(untyped))
        lines.append(f"on the page of `bench serve` alone: {names}")
    return "\n".join([*filter(None, lines), ""])


def json_line(document: Any) -> str:
    """A document as JSON in one line, with the letters that the terminal's encoding has."""
    text = json.dumps(document, ensure_ascii=False)
    try:
        text.encode(sys.stdout.encoding or "ascii")
    except UnicodeEncodeError:
        return json.dumps(document)
    return text


def record(bench: Bench, args: Namespace) -> None:
    """Enter, correct or add the result of a trial."""
    value = args.value
    if args.log is not None:
        from study.bench.walk_log import cost_of_log

        if value is not None:
            allowed = "the value, or --log, which gives it, not both"
            raise InputError("value", value, allowed)
        value = cost_of_log(args.log, bench.plan.goal.duration_s)
    told: dict[str, Any] = {
        "columns": {
            name: typed.number(name, word) for name, word in args.others.items()
        },
        "note": args.note,
    }
    if args.action == "add":
        path = needed(args.gains, "gains", PARAMETERS)
        gains = json_document("gains", path, PARAMETERS)
        value = needed(value, "value", "the trial's value")
        (which,) = bench.add([Own(gains, value, **told)])
        print(f"trial {which}")
    else:
        which = number(args)
        if args.action == "correct":
            bench.correct(which, value, failed_s=args.seconds, **told)
        elif args.action == "fail":
            seconds = needed(args.seconds, "seconds", "a time")
            bench.record(which, failed_s=seconds, **told)
        else:
            value = needed(value, "value", "the trial's value, or --log")
            bench.record(which, value, **told)
    warn(bench.doubts(which))
    print(bench.entries[-1])


def warn(lines: Sequence[str]) -> None:
    """Print what is to be looked at once more."""
    for line in lines:
        print(f"warning: {line}", file=sys.stderr)


def status(bench: Bench, args: Namespace) -> None:
    """Print the trials, and the entries."""
    state = bench.state
    print(" | ".join(filter(None, [bench.plan.name, bench.plan.about, state.context])))
    for field, name, why in clashes(bench.plan.columns, bench.space):
        warn([f"{field} {name}: {why}; what was typed may stand in another place"])
    warn(list(beyond_bounds(bench.plan.candidates, bench.space)))
    for trial in state.trials.values():
        value = "pending" if trial.value is None else f"{trial.value:.6g}"
        line = f"trial {trial.number:>3}  {value:<10}"
        line += "".join(f"  {name} {given:g}" for name, given in trial.columns.items())
        failed = "failed" if trial.failed else ""
        marks = ", ".join(filter(None, [failed, trial.context, trial.note]))
        print(f"{line}  {marks}".rstrip())
    for entry in bench.entries:
        print(f"{entry}{' (undone)' if entry.number in state.undone else ''}")
    warn(bench.doubts())


def recommend(bench: Bench, args: Namespace) -> None:
    """Print the gains of the best reading, and what to repeat; or that nothing is known yet."""
    state = bench.state
    where = f" in {state.context}" if state.context else ""
    finished = [trial for trial in state.finished if trial.context == state.context]
    if not finished:
        print(f"Nothing to recommend yet: no trial is finished{where}.")
        return
    if not any(bench.plan.may_be_named(trial) for trial in finished):
        print(f"Nothing to recommend yet: all trials{where} failed or broke a limit.")
        return
    best = bench.best()
    print(best)
    print(json_line(dict(best.params)))
    print("The interval is that of the mean, without the noise of a single trial.")
    number = bench.repeat()
    if number is not None:
        print(f"A repeat of trial {number} would tell most: --repeat {number}")


def forecast(bench: Bench, args: Namespace) -> None:
    """Print what to expect before the first trial."""
    tell_forecast(bench, is_asked=True)


def tell_forecast(bench: Bench, *, is_asked: bool) -> None:
    """Print what to expect; if it takes long and nobody asked for it, how to ask."""
    from study.bench import forecasts
    from study.sampler.forecast import require_worlds

    try:
        require_worlds(bench.candidates.rows)
    except InputError as error:
        if is_asked:
            raise
        print(f"what to expect before the first trial is unknown: {error}")
        return
    is_quick = forecasts.is_quick(bench.candidates.rows)
    if not (is_asked or is_quick or forecasts.known_forecast(bench)):
        line = [*PROGRAM, "forecast", "--bench", str(bench.plan.path)]
        print(f"what to expect before the first trial: {shlex.join(line)}")
        return
    with closing(ProgressBar()) as bar:
        print(forecasts.forecast_of(bench, partial(bar.move, "robot")))


def compare_to_simulator(bench: Bench, args: Namespace) -> None:
    """Print, draw and note what was simulated beside what was seen."""
    from optuna_dashboard import save_note

    from study.pictures import style
    from study.sampler.diagnostics import RankCorrelation

    simulated = bench.simulated()
    seen = {number: bench.state.trials[number].result for number in simulated}
    lines = [
        f"trial {number:>3}  simulated {value:10.4g}  seen {seen[number]:10.4g}"
        for number, value in simulated.items()
    ]
    expected = np.array([*simulated.values()])
    found = np.array([*seen.values()])
    r = RankCorrelation.of(expected, found) if simulated else None
    lines.append(f"Rank correlation of simulated and seen: {r or 'too few trials'}")
    worlds = bench.candidates.rows.worlds
    if worlds is not None and worlds.as_before is not None:
        lines.append("Infinite costs count as numbers beyond all others.")
    lines += ["", bench.worth()]
    print("\n".join(lines))
    path = bench.plan.path.with_name(f"{bench.plan.name}-simulator.png")
    figure = style.new_figure(4.5, 4.0)
    axes = figure.add_subplot()
    style.tidy(axes)
    axes.plot(expected, found, "o", color=style.BLACK)
    axes.set_xlabel("simulated")
    axes.set_ylabel(f"seen: {bench.plan.goal.value}")
    figure.tight_layout()
    print(f"picture: {style.save_png(figure, path)}")
    save_note(bench.shown(), "\n".join(["```text", *lines, "```"]))


def export(bench: Bench, args: Namespace) -> None:
    """Write the trials as CSV."""
    from study.bench.exchange import export_text

    path = needed(args.what, "what", "a file to write, or -, standard output")
    if path == "-":
        print(export_text(bench), end="")
        return
    commit_text(Path(path), export_text(bench))
    print(f"{len(bench.state.trials)} trials: {path}")


def import_trials(bench: Bench, args: Namespace) -> None:
    """Enter the trials of a CSV, those that are not there yet."""
    from study.bench.exchange import read_trials

    path = Path(needed(args.what, "what", "a CSV file"))
    with warnings.catch_warnings(record=True, action="always") as said:
        entered, known = bench.add_new(read_trials(bench, path))
    warn([str(each.message) for each in said])
    if entered:
        print(f"trials {', '.join(map(str, entered))}")
    if known:
        numbers = ", ".join(map(str, known))
        print(f"there already: trials {numbers}; `add` enters a trial again")


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

    address = args.listen or HOST
    filming = filming_of(bench, args.simulator)
    with tempfile.TemporaryDirectory() as folder, Processes(1) as makers:
        films = None if filming is None else Films(filming, makers, Path(folder))
        app, token = application(bench, address, films)
        with wsgi_server(app, address, args.port) as server:
            host = socket.gethostname() if address == EVERYWHERE else address
            link = f"http://{host}:{server.server_port}/"
            if token:
                link += f"?token={token}"
            print(f"bench       {link}  (Ctrl-C ends it)", flush=True)
            with suppress(KeyboardInterrupt):
                server.serve_forever()


def number(args: Namespace) -> int:
    """The number of a trial or an entry."""
    return number_of("what", needed(args.what, "what", "the number of a trial"))


def needed(value: Any, field: str, allowed: str) -> Any:
    """An option that the action cannot do without."""
    if value is None:
        raise InputError(field, "missing", allowed)
    return value


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
    "forecast": forecast,
    "compare-to-simulator": compare_to_simulator,
    "export": export,
    "import": import_trials,
    "serve": serve,
}
