"""The document of a folder: written once, then the same or refused."""

import json
from pathlib import Path
from typing import Any

import pytest

from storage.document import agree
from taichi_nmm.errors import InputError

OURS: dict[str, Any] = {"seed": 1, "arms": {"dog": {"k": 1}}}


def agreed(path: Path, document: dict[str, Any], *growing: str) -> dict[str, Any]:
    return agree(path / "experiment.json", document, growing=growing, remedy="another --out")


def read(path: Path) -> Any:
    return json.loads((path / "experiment.json").read_text())


def test_a_new_folder_gets_the_document_and_an_old_one_keeps_it(tmp_path: Path) -> None:
    assert agreed(tmp_path, OURS) == read(tmp_path) == OURS
    before = (tmp_path / "experiment.json").stat()
    assert agreed(tmp_path, OURS, "arms") == OURS
    assert (tmp_path / "experiment.json").stat() == before


def test_the_first_difference_is_named_with_both_values(tmp_path: Path) -> None:
    agreed(tmp_path, OURS)
    with pytest.raises(InputError) as caught:
        agreed(tmp_path, {"seed": 2, "arms": {}})
    path = tmp_path / "experiment.json"
    expected = f"seed: 2 cannot be used; allowed: 1, as {path} says; or another --out"
    assert str(caught.value) == expected
    assert read(tmp_path) == OURS


def test_growing_parts_are_gathered_and_sorted(tmp_path: Path) -> None:
    agreed(tmp_path, OURS, "arms")
    more = OURS | {"arms": {"cmaes": {"k": 2}}}
    grown = {"seed": 1, "arms": {"cmaes": {"k": 2}, "dog": {"k": 1}}}
    assert agreed(tmp_path, more, "arms") == read(tmp_path) == grown
    assert list(read(tmp_path)["arms"]) == ["cmaes", "dog"]
    assert agreed(tmp_path, OURS, "arms") == read(tmp_path) == grown


def test_the_order_of_a_growing_part_is_the_same_in_a_new_folder_and_in_an_old_one(
    tmp_path: Path,
) -> None:
    """It goes into the footers of tables, which are compared byte by byte."""
    unsorted = {"ground": {"kind": "rough", "amplitude_m": 0.08}}
    new = json.dumps(agreed(tmp_path, unsorted, "ground"))
    assert json.dumps(agreed(tmp_path, unsorted, "ground")) == new


def test_a_part_that_the_old_document_lacks_is_empty_there(tmp_path: Path) -> None:
    agreed(tmp_path, {"seed": 1})
    assert agreed(tmp_path, OURS, "arms") == read(tmp_path) == OURS


def test_a_conflict_within_a_growing_part_is_refused(tmp_path: Path) -> None:
    agreed(tmp_path, OURS, "arms")
    with pytest.raises(InputError) as caught:
        agreed(tmp_path, OURS | {"arms": {"dog": {"k": 3}}}, "arms")
    assert caught.value.field == "arms.dog.k" and read(tmp_path) == OURS


@pytest.mark.parametrize("text", ["", "{", "[]", '{"seed": 1, "arms": 3}'])
def test_an_unreadable_document_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "experiment.json").write_text(text)
    with pytest.raises(InputError, match="a readable experiment; or another --out"):
        agreed(tmp_path, OURS, "arms")


def test_another_kind_of_value_is_a_difference(tmp_path: Path) -> None:
    (tmp_path / "experiment.json").write_text("[]")
    with pytest.raises(InputError, match="experiment"):
        agreed(tmp_path, OURS)
