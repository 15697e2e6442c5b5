"""Killed commands, resumed, leave what a whole run leaves; and what differs is found."""

import re

import pytest

from tests.processes import printed, python
from tests.tools import kills

KILLS = 10


@pytest.mark.campaign
def test_all_commands_resume_bit_equal_after_two_kills_each():
    """In a process of its own, since it forks."""
    pytest.importorskip("ribs")
    said = printed("-m", kills.__name__, "--kills", KILLS)
    rows = re.findall(r"\| ([\w-]+) \| (\d+) \| (\d+) \| (\d+) \| (\d+) \|", said)
    assert [row[0] for row in rows] == [*kills.SCENES]
    assert sum(int(row[1]) for row in rows) >= KILLS
    assert all(int(row[3]) > 0 and row[3] == row[4] for row in rows)


FORGETFUL = """
import os
from study.commands import report
from tests.tools import kills
write = report.write_report
def forget(results, **options):
    found = write(results, **options)
    (results.folder / "report" / "process.txt").write_text(str(os.getpid()))
    return found
report.write_report = forget
kills.main()
"""


@pytest.mark.campaign
def test_a_command_whose_file_differs_at_every_run_is_found():
    done = python("-c", FORGETFUL, "--kills", 2, "--commands", "report")
    assert done.returncode == 1, done.stderr
    assert "report: compared/report/process.txt" in done.stderr.splitlines()[-1]
