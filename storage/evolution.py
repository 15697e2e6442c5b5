"""The search for gaits that survive one family: quality-diversity by CMA-ME.

Points are those of the unit cube, [n, d]. Fontaine, Togelius, Nikolaidis & Hoover 2020, Covariance
matrix adaptation for the rapid illumination of behavior space; the archive and the emitters are
those of pyribs.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from storage.gait_measures import MEASURE_CELLS, MEASURE_RANGES

if TYPE_CHECKING:
    from ribs.emitters import EvolutionStrategyEmitter

EMITTERS = 4  # evolution strategies, each begun elsewhere
BATCH = 24  # points of an emitter in a generation: twice what CMA-ES takes in 16 dimensions
STEP = 0.1  # of an emitter at its start, in widths of the bounds
GENERATION = EMITTERS * BATCH  # points that are tried at a time


class Evolution:
    """An archive of gaits, and the evolution strategies that fill it.

    What it asks depends on the seed and on what it was told, on nothing else.

    Args:
        dimensions: d.
        seed: of all that is drawn.
    """

    def __init__(self, dimensions: int, seed: np.random.SeedSequence) -> None:
        """Nothing is known yet: the first points that it is told of are the caller's."""
        from ribs.archives import GridArchive  # here: it compiles, and most stores do without

        own, *self._seeds = map(int, seed.generate_state(1 + EMITTERS))
        self._archive = GridArchive(
            solution_dim=dimensions,
            dims=MEASURE_CELLS,
            ranges=MEASURE_RANGES,
            seed=own,
        )
        self._emitters: list[EvolutionStrategyEmitter] = []

    def begin(
        self,
        points: NDArray[np.float64],
        objective: NDArray[np.float64],
        measures: NDArray[np.float64],
    ) -> None:
        """Take in the points to start from, [n, d]; emitters begin at the best of them.

        Args:
            points: of the grid.
            objective: [n].
            measures: [n, m].
        """
        from ribs.emitters import EvolutionStrategyEmitter

        self._archive.add(points, objective, measures)
        best = np.argsort(-objective, kind="stable")
        for number, seed in enumerate(self._seeds):
            emitter = EvolutionStrategyEmitter(
                self._archive,
                x0=points[best[number % len(best)]],
                sigma0=STEP,
                ranker="2imp",  # new cells first, then by what a cell gained
                batch_size=BATCH,
                seed=seed,
            )
            self._emitters.append(emitter)

    def ask(self) -> NDArray[np.float64]:
        """The next generation, [GENERATION, d]."""
        return folded(np.concatenate([emitter.ask() for emitter in self._emitters]))

    def tell(
        self,
        points: NDArray[np.float64],
        objective: NDArray[np.float64],
        measures: NDArray[np.float64],
    ) -> None:
        """What came of the generation that was asked last."""
        added = self._archive.add(points, objective, measures)
        for number, emitter in enumerate(self._emitters):
            own = slice(number * BATCH, (number + 1) * BATCH)
            told = {name: values[own] for name, values in added.items()}
            emitter.tell(points[own], objective[own], measures[own], told)


def folded(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points beyond the cube's faces, reflected into it.

    The library would draw until all are inside, for ever where a wide strategy sits in a corner.
    """
    return 1.0 - np.abs(np.mod(points, 2.0) - 1.0)
