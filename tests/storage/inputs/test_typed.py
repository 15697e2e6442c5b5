"""Numbers that people type, and what parts the columns of their texts."""

import pytest

from storage.inputs.errors import InputError
from storage.inputs.typed import number, separator
from tests.cases import asset

TYPED = asset("typed.toml")


@pytest.mark.parametrize(("word", "value"), TYPED["numbers"].items())
def test_a_number_has_a_decimal_point_or_a_decimal_comma(word, value):
    assert number("cost", word) == value


@pytest.mark.parametrize(("word", "mend"), TYPED["refused"].items())
def test_what_may_mean_two_numbers_or_none_is_refused_with_the_mend(word, mend):
    with pytest.raises(InputError) as refused:
        number("cost", word)
    assert str(refused.value).startswith(
        f"cost: {word!r} cannot be used; allowed: {mend}"
    )


LONG = "a;b\n" + 50_000 * "1,5;2,5\n"


@pytest.mark.parametrize(("text", "mark"), [*TYPED["marks"].items(), (LONG, ";")])
def test_columns_are_parted_by_what_parts_all_rows_alike(text, mark):
    assert separator(text) == mark


@pytest.mark.parametrize(("text", "said"), TYPED["ambiguous"].items())
def test_columns_that_may_be_parted_in_two_ways_are_refused(text, said):
    with pytest.raises(ValueError, match=said):
        separator(text)
