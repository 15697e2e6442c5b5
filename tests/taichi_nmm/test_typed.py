"""Numbers that people type, and what parts the columns of their texts."""

import pytest

from taichi_nmm.errors import InputError
from taichi_nmm.typed import number, separator


@pytest.mark.parametrize(("word", "value"), [
    ("0.92", 0.92), ("0,92", 0.92), (" 12 ", 12.0), ("-0,5", -0.5), ("+3", 3.0), (",5", 0.5),
    ("5.", 5.0), ("1e-3", 0.001), ("1,5e3", 1500.0), ("0,920", 0.92), ("12,3456", 12.3456),
    ("1.234", 1.234), ("1234,5", 1234.5), ("\N{MINUS SIGN}3", -3.0),
])  # fmt: skip
def test_a_number_has_a_decimal_point_or_a_decimal_comma(word: str, value: float) -> None:
    assert number("cost", word) == value


@pytest.mark.parametrize(("word", "mend"), [
    ("1,234", "1234 or 1.234"), ("1.234,5", "1234.5"), ("1,234.5", "1234.5"),
    ("1,234,567", "1234567"), ("1.234.567", "1234567"), ("1'000", "1000"), ("1 000,5", "1000.5"),
    ("much", "a number, such as 0.92"), ("", "a number"), ("nan", "a number"), ("inf", "a number"),
    ("1e400", "a finite number"), ("1_000", "a number"), ("5 Nm", "a number"), ("0x10", "a number"),
    ("1e-400", "a finite number"),
])  # fmt: skip
def test_what_may_mean_two_numbers_or_none_is_refused_with_the_mend(word: str, mend: str) -> None:
    with pytest.raises(InputError) as refused:
        number("cost", word)
    assert str(refused.value).startswith(f"cost: {word!r} cannot be used; allowed: {mend}")


@pytest.mark.parametrize(("text", "mark"), [
    ("a,b\n1,2\n", ","), ("a;b\n1,5;2,5\n", ";"), ("a\tb\n1,5\t2,5\n", "\t"),
    ("a\n1\n", ","), ("", ","), ("0,5;0,1\n1,5;0,2\n", ";"), ("0,5\t0,1\n1,5\t0,2\n", "\t"),
    ("time position\n0.0  0,1\n", " "), ('a,"b;\nc"\n1,2\n', ","), ("a;b\r1,5;2\r", ";"),
    ("0 \t1\n1  2\n", " "),
    ("my time,pos\n2026-05-04 14:30,1\n", ","), ("a, b\n1, 2\n", ","), ("a,b\r\n\r\n1,2\r\n", ","),
    ("a;note\n1;one, two\n2;three\n", ";"), ("a,note\n1,one; two\n", ","),
    ("a;b\n" + 50000 * "1,5;2,5\n", ";"),
])  # fmt: skip
def test_columns_are_parted_by_what_parts_all_rows_alike(text: str, mark: str) -> None:
    assert separator(text) == mark


@pytest.mark.parametrize(("text", "said"), [
    ("a,b\n1,5,2\n", "row 2 has 3 cells, and row 1, of names, 2; decimal commas need"),
    ("x\n1,5\n", "row 2 has 2 cells, and row 1, of names, 1; decimal commas need"),
    ("a,b\n1,2\n1,5,2,5\n", "row 3 has 4 cells"),
    ("a,b;c,d\n1,2;3,4\n", "two of tabs, ; and ,"),
])  # fmt: skip
def test_columns_that_may_be_parted_in_two_ways_are_refused(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        separator(text)
