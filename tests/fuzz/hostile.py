"""Values that no field expects: of documents, of texts, of options."""

from typing import Any

from numpy.random import Generator

HUGE = 10**400
SURROGATE = "\udcff"  # of a name that is not UTF-8, as Python has it

# Of JSON, TOML, Parquet and SQLite.
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 3, 7, 2**31, 2**63 - 1, 2**63, -(2**63), 10**30, HUGE, 0.0,
    -0.0, 0.5, -1.5, 1e-320, 1e-9, 1e16, 1e308, -1e308, float("nan"), float("inf"), float("-inf"),
    "", " ", "a", "dog", "random", "flat", "rough", "file", "mujoco", "cuda", "1", "nan", "null",
    "..", ".", "/", "a/b", "../toy", "hill.csv", "store", "nowhere", "\n", "\x00", "\x1b[31m", "é",
    "\u202eab", "\U0001f600", "%s{0}", "$x^2$", "<script>", "x" * 5000, [], [[]], {}, {"a": 1},
    [1, 2], [2, 1], [0.5, 0.5], [None], ["a", "a"], ["theta_ref"], [{}], {"": ""}, {"kind": "flat"},
    [0] * 2000,
)  # fmt: skip

# Of text files, in place of a word or between two.
WORDS: tuple[str, ...] = (
    "", "nan", "inf", "-inf", "1e400", "-1", "0", "-0.0", "1e-320", "9" * 5000, "0x10", "1_000",
    "\u0663", "true", "null", "None", "\"a\"", "'", '"', "[" * 200, "{", "}", "]", ",", ":", "=",
    "#", "\\", "\\u0000", "\\ud800", "\x00", "\ufeff", "\r", "\r\n", "\t", "\x1b", "\x85", "\u2028",
    "/*", "//", "[a]", "[[a]]", "a.b = 1", "\n\n", ";", "1,2,3", "1 2", "1;2", "1,5",
)  # fmt: skip

# Of options. Some are names of files and folders of the world. None is an absolute path that can be
# written: whoever runs this may be root.
OPTIONS: tuple[str, ...] = (
    "", " ", "-", "--", "-1", "0", "1", "2", "00", "+1", "1.5", "1e3", "nan", "inf", "-inf",
    "1e400", "9" * 30, "9" * 5000, "\u0663", "\u00b2", "1_0", "0x1", " 1 ", "1\n", "a", "dog",
    "dog,dog", "dog,", ",", "random", "best", "é", "\u202ea", "\U0001f600", "a b", "a\nb", "a\tb",
    "\x1b[31m",
    SURROGATE, f"a{SURROGATE}", "x" * 300, "x" * 5000, "%s", "%(default)s", "{}", "{0}", "*", "~",
    ".", "..", "./.", "a/b/c", "store", "compared", "toy.toml", "hill.csv", "live.db", "gains.json",
    "toy.toml/x", "/dev/null/x", "auto", "cpu", "cuda", "vulkan",
    "mujoco", "both", "taichi", "few", "all", "sqlite:///", "sqlite:///live.db",
    "sqlite:///toy.toml", "sqlite:///store", "sqlite:///a/b.db", "sqlite:///:memory:",
    "sqlite:///x?mode=ro", "sqlite:///%00", "sqlite:///%ff", "sqlite:///~/x", "sqlite://",
    "mysql://a", "postgresql+psycopg://", "postgresql://x:secret@y/z",
    "postgresql+psycopg://u:secret@127.0.0.1:1/x", "postgresql+psycopg://[::1",
    "toy/dog/run-000/0", "toy/dog/run-000/1", "toy/dog/run-000/9", "toy/dog/run-000/x", "toy/dog/0",
    "////", "toy/dog/run-000/\u0663", "toy/dog/run-000/-1", "K_T", "reference", "rough8", "store-v",
)  # fmt: skip


def pick(rng: Generator, values: Any) -> Any:
    """One of a sequence."""
    return values[int(rng.integers(len(values)))]


def chance(rng: Generator, of: float) -> bool:
    """True in this part of all calls."""
    return bool(rng.random() < of)
