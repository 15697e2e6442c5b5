"""Small faults in the product, one at a time: do the tests notice them?

    python -m tests.faults --count 80 --seed 1

draws places of the product's source (an operator, a constant, a condition), changes one
in a copy of the checkout, and runs the tests there until one fails: first those of the
same folder, then all. Pictures, messages, command lines and annotations are left out. A
run of the tests that takes longer than LONGEST_S counts as noticed. What was found is
kept in out/faults-SEED.jsonl: the same command goes on where it was stopped, with any
number of --workers. Exit codes: 0, 2 bad input.
"""

import ast
import json
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from tqdm import tqdm

from study.cli import run_command
from study.options import MOST_WORKERS, Options
from tests.processes import python

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("taichi_nmm", "storage", "study")
LEFT_OUT = (
    "study/pictures",
    "study/explore",
    "study/hub",
    "study/options.py",
    "study/report/figures.py",
)
LONGEST_S = 1200.0
# Each operator stands for the one after the slash; of the first ones also the other way.
EXCHANGED = (
    "Lt/LtE Gt/GtE Eq/NotEq Is/IsNot In/NotIn Add/Sub Mult/Div And/Or BitAnd/BitOr"
)
REPLACED = "FloorDiv/Mult Mod/Mult"
PAIRS = [pair.split("/") for pair in f"{EXCHANGED} {REPLACED}".split()]
PAIRS += [pair.split("/")[::-1] for pair in EXCHANGED.split()]
OTHER = {getattr(ast, operator): getattr(ast, other) for operator, other in PAIRS}


def places(tree):
    """Expressions in which one operator, constant or condition can be changed."""
    for field, value in ast.iter_fields(tree):
        if field in ("annotation", "returns"):
            continue
        for node in value if isinstance(value, list) else [value]:
            if isinstance(node, ast.AST) and not isinstance(
                node, (ast.Raise, ast.JoinedStr)
            ):
                if isinstance(node, ast.expr) and faulty(node) is not None:
                    yield node
                yield from places(node)


def faulty(node):
    """The expression with its fault, or None for one that is left as it is."""
    if (
        isinstance(node, ast.Compare)
        and len(node.ops) == 1
        and type(node.ops[0]) in OTHER
    ):
        return ast.Compare(node.left, [OTHER[type(node.ops[0])]()], node.comparators)
    if isinstance(node, ast.BinOp) and type(node.op) in OTHER:
        return ast.BinOp(node.left, OTHER[type(node.op)](), node.right)
    if isinstance(node, ast.BoolOp):
        return ast.BoolOp(OTHER[type(node.op)](), node.values)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.Not, ast.USub)):
        return node.operand
    if isinstance(node, ast.IfExp):
        return ast.IfExp(ast.UnaryOp(ast.Not(), node.test), node.body, node.orelse)
    if isinstance(node, ast.Constant) and isinstance(node.value, bool):
        return ast.Constant(not node.value)
    if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        return ast.Constant(node.value * 2 if node.value else 1)
    return None


def drawn(count, seed):
    """Files, and numbers of places in them; every place of the product is as likely."""
    paths = [
        path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))
    ]
    files = [path.relative_to(ROOT).as_posix() for path in paths]
    every = [
        (file, number)
        for file in files
        if not file.startswith(LEFT_OUT)
        for number, _ in enumerate(places(ast.parse((ROOT / file).read_text())))
    ]
    chosen = np.random.default_rng(seed).permutation(len(every))[:count]
    return [every[index] for index in chosen]


def changed(source, number):
    """The source with the fault at a place, and the fault in words; all other bytes are kept."""
    node = list(places(ast.parse(source)))[number]
    new = faulty(node)
    assert new is not None
    assert node.end_lineno is not None and node.end_col_offset is not None
    lines = source.encode().splitlines(keepends=True)
    first, last = node.lineno - 1, node.end_lineno - 1
    before, after = lines[first][: node.col_offset], lines[last][node.end_col_offset :]
    text = f"({ast.unparse(ast.fix_missing_locations(new))})"
    lines[first : last + 1] = [before + text.encode() + after]
    words = f"line {node.lineno}: {ast.unparse(node)} -> {text}"
    return b"".join(lines).decode(), words


def tests_of(file):
    """The tests to run one after another: the folder's, of kernels also parity; and all."""
    folder = Path("tests", file).parent
    near = folder if (ROOT / folder).is_dir() else folder.parent
    physics = ["tests/parity/test_frozen_walks.py", "tests/parity"]
    first = physics if file.startswith("taichi_nmm/") else []
    return [[*first, near.as_posix()], ["tests"]]


def tried(file, number, copy, near_only):
    """Whether the tests notice a fault, in a copy of the checkout."""
    source = (ROOT / file).read_text()
    text, words = changed(source, number)
    noticed = None
    (copy / file).write_text(text)
    try:
        for paths in tests_of(file)[: 1 if near_only else 2]:
            words = ("-m", "pytest", "-x", "-q", "--no-header", *paths)
            done = python(*words, cwd=copy, timeout=LONGEST_S)
            if done.returncode not in (0, 5):  # 5: the folder has no tests of this kind
                noticed = done.stdout.strip().splitlines()[-2:-1] or ["?"]
                break
    except subprocess.TimeoutExpired:
        noticed = [f"no end after {LONGEST_S:.0f} s"]
    finally:
        (copy / file).write_text(source)
    return {"file": file, "number": number, "fault": words, "noticed": noticed}


def main():
    """Try the faults, and list those that the tests did not notice."""
    options = Options(__file__)
    options.whole("--count", 1, 10_000, default=80, help="faults; %(default)s")
    options.whole(
        "--seed", 0, 2**32, default=1, help="of the drawn places; %(default)s"
    )
    options.whole("--workers", 1, MOST_WORKERS, default=2, help="copies; %(default)s")
    options.add_argument(
        "--near-only", action="store_true", help="only tests of the same folder"
    )
    args = options.parse_args()
    kept = ROOT / "out" / f"faults-{args.seed}.jsonl"
    kept.parent.mkdir(exist_ok=True)
    kept.touch()
    known = [json.loads(line) for line in kept.read_text().splitlines()]
    done = {(row["file"], row["number"]) for row in known}
    open_places = [place for place in drawn(args.count, args.seed) if place not in done]
    bar = tqdm(total=args.count, initial=len(known))

    def work(worker):
        copy = ROOT / "out" / f"faults-copy-{worker}"
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(
            ROOT, copy, ignore=shutil.ignore_patterns("out", ".git", ".venv")
        )
        while open_places:
            row = tried(*open_places.pop(), copy, args.near_only)
            with kept.open("a") as file:
                file.write(json.dumps(row) + "\n")
            known.append(row)
            bar.update()
        shutil.rmtree(copy)

    with ThreadPoolExecutor(args.workers) as pool:
        list(pool.map(work, range(args.workers)))
    bar.close()
    for row in known:
        if row["noticed"] is None:
            print(f"not noticed: {row['file']}, {row['fault']}")
    print(f"{sum(row['noticed'] is not None for row in known)} of {len(known)} noticed")


if __name__ == "__main__":
    run_command(main)
