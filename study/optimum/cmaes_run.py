"""One run of CMA-ES in the unit cube, a generation at a time, the same after a replay."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from study.draws import Purpose, generator
from study.experiment.experiment import CmaesOptions
from study.experiment.samplers import new_strategy
from taichi_nmm.parameters import GAINS, lower_bounds, upper_bounds

Floats = NDArray[np.float64]

CUT = "max_generations"


class CmaesRun:
    """A run: `ask`, `tell`, `ask`, ... until `stopped` says why it ended.

    Args:
        options: of the run.
        seed: of the experiment.
        run: its number; start and draws depend on both and on nothing else.
    """

    def __init__(self, options: CmaesOptions, seed: int, run: int) -> None:
        """Start from a random point."""
        start = generator(seed, Purpose.CMAES_MEAN, run).random(len(GAINS))
        draws = generator(seed, Purpose.CMAES, run)
        wanted: dict[str, Any] = {"tolfun": options.tolerance}
        if options.population:
            wanted["popsize"] = options.population
        self._strategy = new_strategy(start, options.sigma, draws, **wanted)
        self._asked: list[Floats] | None = None
        self._stop: dict[str, Any] = {}
        self.generation = 0

    @property
    def population(self) -> int:
        """Points of a generation."""
        return int(self._strategy.popsize)

    def stopped(self, max_generations: int) -> str:
        """Why the run ended: pycma's criteria, or the cap; "" while it goes on."""
        if self._stop:
            return ", ".join(sorted(self._stop))
        return CUT if self.generation >= max_generations else ""

    def ask(self) -> Floats:
        """The gains of the generation, [population, 16]; the same until told."""
        if self._asked is None:
            self._asked = self._strategy.ask()
        low, high = lower_bounds(), upper_bounds()
        return np.asarray(np.clip(low + (high - low) * np.array(self._asked), low, high))

    def tell(self, costs: Floats) -> None:
        """What the generation costs, finite, [population]."""
        assert self._asked is not None
        self._strategy.tell(self._asked, costs.tolist())
        self._stop = dict(self._strategy.stop())
        self._asked = None
        self.generation += 1
