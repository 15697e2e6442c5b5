"""The one line of an error."""

import pickle

import numpy as np

from storage.inputs.errors import MOST_LISTED, InputError, listed


class Unspeakable:
    def __repr__(self):
        raise RuntimeError


def test_it_has_field_value_and_allowed_values():
    error = InputError("field", 3, "4 or more")
    assert str(error) == "field: 3 cannot be used; allowed: 4 or more"
    again = pickle.loads(pickle.dumps(error))
    assert (again.field, again.value, again.allowed) == ("field", 3, "4 or more")


def test_it_is_one_printable_line_of_bounded_length():
    nested = []
    for _ in range(100_000):
        nested = [nested]
    values = [
        10**5000,
        Unspeakable(),
        np.zeros((3, 3)),
        "x" * 10_000,
        "\udcff\x1b[31m\n",
        nested,
    ]
    for value in values:
        line = str(InputError("a\nb\x1b", value, "c\r\nd\u2028"))
        assert line.isprintable(), line
        assert len(line) < 600
    line = str(InputError("x" * 5000, 1, "y" * 5000))
    assert len(line) < 2000 and "xx: 1 cannot be used; allowed: yy" in line
    line = str(InputError("path", f"/begin/{'x' * 5000}/end.json", "a file"))
    assert "/begin/" in line and "/end.json'" in line  # both ends


def test_of_many_names_the_nearest_are_listed_and_the_others_counted():
    names = [f"world{number}" for number in range(300)]
    few = names[:MOST_LISTED]
    assert listed(few, "world7") == ", ".join(few)
    line = listed([*names, "Torque"], "torqe")
    assert line.startswith("Torque, ") and line.endswith(
        f" and {301 - MOST_LISTED} more"
    )
    assert line.count(",") == MOST_LISTED - 1
    assert listed(names, "world29").startswith("world29, ")
    assert listed(names).startswith("world0, world1, ") and len(listed(names)) < 200
    assert listed([]) == ""
    assert listed(["damping ", "mass"]) == "'damping ', mass"
