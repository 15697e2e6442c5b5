"""`Controller`: muscles, delays, reflexes and swing-leg placement, for a body anywhere.

The body may be one of any simulator, or a robot. Every physics step, `Controller.step`
takes its `Observation` and returns the torques of its six joints. docs/controller.md
has an example.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from storage.inputs import checks
from storage.inputs.errors import InputError
from taichi_nmm.body import Bodies
from taichi_nmm.initial import relax
from taichi_nmm.kernel import backend
from taichi_nmm.kernel.actuation import actuate
from taichi_nmm.kernel.layout import LEGS, Sense, WalkerRows
from taichi_nmm.kernel.muscle_table import FMAX_N, muscle_table
from taichi_nmm.kernel.swing import HOLD
from taichi_nmm.observation import JOINTS, Observation, sense_rows
from taichi_nmm.packs import Packs
from taichi_nmm.settings import Settings
from taichi_nmm.walkers import blends, check_batch, constant_rows


@dataclass(frozen=True, eq=False)
class Muscles:
    """State of the muscles of n controllers, [n, 14]: `MUSCLES` left leg, then right.

    Attributes:
        activation: 0.01 to 1.
        stimulation: ordered by the reflexes, 0.01 to 1.
        length: of the contractile element, over its optimal length.
        force_n: of the muscle-tendon unit, N.
    """

    activation: NDArray[np.float64]
    stimulation: NDArray[np.float64]
    length: NDArray[np.float64]
    force_n: NDArray[np.float64]


class Controller:
    """A batch of n neuromuscular controllers, each for a body that another simulator moves.

    Call `step` once a physics step (`settings.physics_step_s`); new orders go to the
    muscles every 1 ms. The first call begins the walk: muscles are relaxed, and nerves
    feel that moment.

    Args:
        gains: [n, gain] or [gain], in the order of `parameters.GAINS`.
        bodies: whose weights the controllers assume, one for all or n; None is the
            nominal 80 kg. Loads are felt relative to the trunk's weight.
        low_level_gains: [n, gain] or [gain], in the order of
            `parameters.LOW_LEVEL_GAINS`.
        settings: precision and physics step; contact and engine are not used.

    Raises:
        InputError: a shape or a value that cannot be used.
    """

    def __init__(
        self,
        gains: ArrayLike,
        *,
        bodies: Bodies | None = None,
        low_level_gains: ArrayLike | None = None,
        settings: Settings | None = None,
    ) -> None:
        checks.optional(checks.instance(Settings))("settings", settings)
        self._settings = (settings or Settings()).on_processor()
        batch = check_batch(gains, bodies, low_level_gains=low_level_gains)
        self._constants = constant_rows(batch, self._settings)
        self._packs: Packs | None = None  # until the first step
        self._step = 0

    def __len__(self) -> int:
        return len(self._constants)

    def step(self, observation: Observation) -> NDArray[np.float64]:
        """Joint torques for the coming physics step, N m, [n, 6], in the order of `joint_rad`.

        They are those of muscles and swing control; stops of the joints are the body's
        own.

        Args:
            observation: what the n bodies sense at the beginning of the step.

        Raises:
            InputError: an array of another shape, or one with NaN or infinity. Nothing
                has then happened: the step may be repeated.
        """
        arrays = checks.instance(Observation)("observation", observation).checked(
            len(self)
        )
        backend.start(self._settings)
        packs = self._packs or self._bind(_first_rows(arrays))
        tick, within = divmod(self._step, self._settings.substeps)
        self._step += 1
        self._senses[...] = packs.fold(sense_rows(arrays))
        self._kernel.launch(tick=tick, commands=int(within == 0))
        return packs.unfold(self._torques).astype(np.float64)

    def keep(self, rows: ArrayLike) -> None:
        """Go on with some controllers alone: the others' bodies have fallen.

        Args:
            rows: numbers of the controllers that go on, in their new order.

        Raises:
            InputError: a row that is not there.
        """
        index = checks.row_numbers("rows", rows, len(self))
        self._constants = self._constants[index]
        if self._packs is not None:
            backend.start(self._settings)
            self._bind(self._packs.unfold(self._packs.rows)[index])

    @property
    def muscles(self) -> Muscles:
        """The muscles after the last step.

        Raises:
            InputError: before the first.
        """
        if self._packs is None:
            raise InputError("controller.muscles", "no step yet", "a first step")
        rows = self._packs.unfold(self._packs.rows).astype(np.float64)
        fibres = WalkerRows.of(rows.T).fibres
        return Muscles(
            activation=fibres.activation.T,
            stimulation=fibres.stimulation.T,
            length=fibres.length.T,
            force_n=fibres.force.T * np.tile(FMAX_N, LEGS),
        )

    def _bind(self, rows: NDArray[Any]) -> Packs:
        """The controllers' rows in packs, and the kernel bound to them."""
        step_s = self._settings.physics_step_s
        real = backend.real_dtype()
        packs = self._packs = Packs(rows, self._constants)
        self._senses = np.zeros((len(packs.rows), Sense.count, packs.lanes), dtype=real)
        self._torques = np.zeros((len(packs.rows), JOINTS, packs.lanes), dtype=real)
        self._kernel = backend.BoundKernel(
            actuate,
            packs.lanes,
            packs.rows,
            packs.constants,
            muscle_table(step_s).astype(real),
            self._senses,
            self._torques,
            0,
            1,
            *blends(step_s),
        )
        return packs


def _first_rows(observation: dict[str, NDArray[Any]]) -> NDArray[np.float64]:
    """The controllers at the start: relaxed muscles, nerves that feel the first moment."""
    contact = observation["contact"]
    rows = np.zeros((len(contact), WalkerRows.count))
    state = WalkerRows.of(rows.T).state
    state.leg_angle_filter[:] = observation["leg_angle_rad"].T
    state.stance_before[:] = contact.T
    state.swing_phase[:] = HOLD
    state.active[:] = 1.0
    joints_rad = observation["joint_rad"].reshape(-1, LEGS, 3)
    rates_radps = observation["joint_rate_radps"].reshape(-1, LEGS, 3)
    for n in range(len(rows)):
        relax(
            WalkerRows.of(rows[n : n + 1].T),
            joints_rad[n],
            contact[n],
            knee_rates_radps=rates_radps[n, :, 1],
            trunk=(observation["trunk_rad"][n], observation["trunk_rate_radps"][n]),
        )
    return rows
