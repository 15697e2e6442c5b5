"""The finished trials of a comparison: what its folder has, and what comes in."""

from collections.abc import Iterable
from dataclasses import dataclass

import pyarrow as pa

from study.comparison.experiment_folder import ExperimentFolder
from study.comparison.results import RESULT_SCHEMA, STATE_SCHEMA, Key, by_study, in_order, walkers


@dataclass(frozen=True)
class Progress:
    """How far a comparison is.

    Attributes:
        trials: finished, those of earlier sessions included.
        total: that there are to be.
        studies: that there are.
        walkers: studies with a trial that walked.
    """

    trials: int
    total: int
    studies: int
    walkers: int


class FinishedTrials:
    """Finished trials by study; the folder gets those of an arm whole, at each `commit`.

    Args:
        folder: whose arms are read and written.
        studies: arm and run of each study of this call; others of their arms are kept too.
        until_walker: whether a study ends with its first walker.
    """

    def __init__(
        self, folder: ExperimentFolder, studies: Iterable[Key], until_walker: bool = False
    ) -> None:
        """Read what is finished."""
        self.studies = tuple(studies)
        self._until_walker = until_walker
        self._walkers: set[Key] = set()
        self._folder = folder
        self._tables: dict[Key, list[pa.Table]] = {key: [] for key in self.studies}
        self._uncommitted: set[str] = set()
        for arm in dict.fromkeys(arm for arm, _ in self.studies):
            self._take(folder.read_arm(arm))

    def add(self, table: pa.Table) -> None:
        """Keep trials that have just been finished, `STATE_SCHEMA`."""
        self._take(table)
        self._uncommitted |= set(table["arm"].to_pylist())

    def known(self, studies: Iterable[Key]) -> pa.Table:
        """The trials of some studies, sorted, `STATE_SCHEMA`."""
        tables = [table for key in studies for table in self._tables[key]]
        return in_order([STATE_SCHEMA.empty_table(), *tables])

    def done(self, key: Key) -> int:
        """How many trials a study has."""
        return sum(len(table) for table in self._tables[key])

    def lacks(self, key: Key, trials: int) -> bool:
        """Whether a study has not yet come to its end, if each is to have so many trials."""
        ended = self._until_walker and key in self._walkers
        return self.done(key) < trials and not ended

    @property
    def count(self) -> int:
        """Trials of the studies of this call."""
        return sum(map(self.done, self.studies))

    def progress(self, trials: int) -> Progress:
        """How far they are, if each is to have so many trials."""
        found = sum(key in self._walkers for key in self.studies)
        total = sum(trials if self.lacks(key, trials) else self.done(key) for key in self.studies)
        return Progress(self.count, total, len(self.studies), found)

    def results(self) -> pa.Table:
        """All trials of the arms of this call, `RESULT_SCHEMA`."""
        return self.known(self._tables).select(RESULT_SCHEMA.names)

    def commit(self) -> None:
        """Write the arms that have new trials."""
        for arm in sorted(self._uncommitted):
            table = self.known(key for key in self._tables if key[0] == arm)
            self._folder.write_arm(arm, table)
        self._uncommitted.clear()

    def _take(self, table: pa.Table) -> None:
        self._walkers |= walkers(table)
        for arm, run, rows in by_study(table):
            self._tables.setdefault((arm, run), []).append(rows)
