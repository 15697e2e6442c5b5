"""The report of a sweep in words: what no person does is bold, and told once."""

from study.report.sweep import text


def found(*rates):
    """A sweep over made-up values, each with a gait of so many steps a minute."""
    values = [
        {
            "value": place,
            "walkers": 2,
            "first_walker": None,
            "best_cost": 1.5,
            "best_cost_quartiles": [1.0, 2.0],
            "gait": {"step_rate_pmin": rate},
        }
        for place, rate in enumerate(rates)
    ]
    top = {"experiment": "toy", "key": "a.b", "arm": "dog", "trials": 7, "robots": 3}
    return {**top, "cost": "smooth", "values": values}


def test_what_no_person_does_is_told_once():
    lines = text(found(66.0, 117.0, 60.0), is_drawn=False).splitlines()
    assert "| steps a minute | 98 to 136 | **66** | 117 | **60** |" in lines
    assert "- takes few steps a minute: 0, 2" in lines
    assert "| 0 | 2 | > 7 | 1 | 1.5 | 2 |" in lines
    assert not any("gaits.png" in line for line in lines)
    lines = text(found(66.0, 60.0), is_drawn=True).splitlines()
    assert "- takes few steps a minute: all" in lines
    assert any("gaits.png" in line for line in lines)
