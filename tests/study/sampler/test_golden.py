"""332 proposals of version 0.2.0, frozen: whoever rewrites the sampler keeps them.

Another processor may round otherwise in the last places, so that numbers are compared to 1e-9.
"""

import json
from pathlib import Path

import pytest

from tests.study.sampler.golden import cases

GOLDEN = json.loads(
    (Path(__file__).resolve().parents[2] / "assets" / "golden-proposals.json").read_text()
)


def test_every_case_is_frozen():
    assert set(GOLDEN) == set(cases())


@pytest.mark.parametrize("name", GOLDEN)
@pytest.mark.filterwarnings("ignore")
def test_proposals_are_those_of_0_2_0(name):
    frozen, made = GOLDEN[name], list(cases()[name]())
    assert len(frozen) == len(made)
    for number, (was, now) in enumerate(zip(frozen, made, strict=True)):
        assert now["row"] == was["row"], number
        expected = {
            key: pytest.approx(value, rel=1e-9) if isinstance(value, float) else value
            for key, value in was["params"].items()
        }
        assert now["params"] == expected, number
