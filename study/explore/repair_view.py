"""A repair from the page: its button, how far it is, and its best gait.

It runs while a tab looks at it, in a process of its own. What a tab repairs is written
down, so that the next one goes on with it, also after the server was killed.
"""

from collections.abc import Callable
from concurrent.futures import Executor
from pathlib import Path

from bokeh.document import Document
from bokeh.models import Column

from storage.commit import commit_json, writable
from storage.inputs.reading import json_document
from storage.store import Store
from study.experiment.gains import NamedGains
from study.experiment.repair import TRIALS, Repair, repair_of, repaired
from study.experiment.walker import WalkerExperiment
from study.explore.server import Latest, Message, flow
from study.explore.words import Tables

STOPPED = "stopped: the walker is another one; back there it goes on"


class RepairView:
    """A button, and a line beside it.

    Of processes, `menders` run the trials. `show` is called with a gait that is better
    than those before; `page` tells what a later tab must know, which is kept in the
    file `noted` in the folder of the repairs.
    """

    def __init__(
        self,
        document: Document,
        menders: Executor,
        noted: Path,
        store: Store,
        show: Callable[[NamedGains], None],
        page: Callable[[], Tables],
    ) -> None:
        self._store = store
        self._noted = noted
        self._show = show
        self._page = page
        self._now: tuple[WalkerExperiment, str]
        self._told_of: tuple[WalkerExperiment, str] | None = None
        self._runs = False
        self._best: int | None = None  # the trial that was shown
        self._refusal = Message("repair-message")
        self._told = Message("repair")
        self._told.layout.styles = {}
        self._trials = Latest(document, menders, self._tried, self._failed)
        button = self._refusal.button(
            f"repair it: {TRIALS} trials", self.begin, name="repair-it"
        )
        self.layout = Column(flow(button, self._told.layout), self._refusal.layout)

    def take(self, setting: WalkerExperiment) -> None:
        """The body, ground and world that the page has now; a repair of others stops."""
        self._now = repair_of(setting, self._store)
        if self._told_of in (None, self._now):
            return
        self._told_of = None
        self._told.tell(STOPPED if self._runs else "")
        if self._runs:
            self._end()

    def begin(self) -> None:
        """Repair the present walker, or go on."""
        if self._runs:
            self._refusal.tell(f"this repair runs: {self._told.layout.text}")
            return
        with writable(self._noted):
            self._noted.parent.mkdir(parents=True, exist_ok=True)
        commit_json(self._noted, self._page())
        self._refusal.tell("")
        self._told.tell("the first trial begins ...")
        self._told_of, self._runs, self._best = self._now, True, None
        self._ask()

    def left(self) -> Tables | None:
        """What an earlier tab was repairing; None: nothing. It is asked for once."""
        if not self._noted.is_file():
            return None
        try:
            return json_document("repair", self._noted, "what a tab wrote")
        finally:
            self._noted.unlink()

    def _ask(self) -> None:
        self._trials.ask(repaired, *self._now, self._noted.parent)

    def _tried(self, found: Repair) -> None:
        if not self._runs:  # it was stopped meanwhile
            return
        self._refusal.tell("")
        best = f"best: trial number {found.best}, {found.words}"
        self._told.tell(f"{found.trials} of {TRIALS} trials; {best}")
        if found.best != self._best:
            self._best = found.best
            self._show(found.gains)
        if found.trials < TRIALS:
            self._ask()
        else:
            self._end()

    def _failed(self, error: BaseException) -> None:
        self._end()
        self._told.tell("")
        self._refusal.failed(error)

    def _end(self) -> None:
        self._runs = False
        self._noted.unlink(missing_ok=True)
