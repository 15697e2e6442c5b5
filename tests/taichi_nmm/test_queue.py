"""Walkers that queue for the threads of a GPU: here for those of a processor."""

import numpy as np
import pytest

from taichi_nmm import Bodies, Settings, Worlds, queue, simulate, simulator
from taichi_nmm.kernel import backend
from taichi_nmm.parameters import PUBLISHED_GAINS, lower_bounds, upper_bounds
from taichi_nmm.settings import settings_of_batch
from taichi_nmm.walkers import Switch

SEATS = 128  # of one block
COUNT = 200
CPU = Settings(arch="cpu")


def queue_on_processor(monkeypatch, launch_ticks):
    """Let walkers queue for a few seats, a seat a turn of the processor's loop."""
    monkeypatch.setattr(backend, "is_gpu", lambda: True)
    monkeypatch.setattr(queue, "LAUNCH_TICKS", launch_ticks)
    monkeypatch.setattr(queue, "ROWS_A_PART", 64)
    for module in (queue, simulator):
        monkeypatch.setattr(module, "SEATS", SEATS)


def gains(count):
    rng = np.random.default_rng(3)
    some = rng.uniform(lower_bounds(), upper_bounds(), (count, 16))
    some[::4] = PUBLISHED_GAINS * rng.uniform(0.97, 1.03, (len(some[::4]), 1))
    return some


def same(one, other):
    return one.rows.tobytes() == other.rows.tobytes()


def test_worlds_recordings_and_switches_are_those_of_packs(monkeypatch):
    short = np.ones((COUNT, 14))
    short[::3, 2] = 0.95
    events = {"push": [[0.3, 0.1, 150.0]] * COUNT, "slip": [[0.5, 0.1, 0.1]] * COUNT}
    nominal = vars(Worlds.nominal(COUNT)) | events
    worlds = Worlds(**{**nominal, "optimal_length": short})
    words = {
        "duration_s": 0.7,
        "bodies": Bodies.disturbed(range(COUNT)),
        "worlds": worlds,
        "settings": CPU,
        "record": [0, 57, COUNT - 1],
    }
    switch = Switch(0.2, PUBLISHED_GAINS, over_s=0.1)
    packed = simulate(gains(COUNT), **words)
    switched = simulate(gains(COUNT), **words, switches=[switch])
    queue_on_processor(monkeypatch, 5000)
    queued = simulate(gains(COUNT), **words)
    assert same(queued, packed)
    for one, other in zip(queued.trajectories, packed.trajectories, strict=True):
        for name, values in vars(one).items():
            assert np.array_equal(values, getattr(other, name)), name
    # Sums are drained at other ticks: their last digits differ.
    later = simulate(gains(COUNT), **words, switches=[switch])
    for name in ("end_reason", "duration_s", "hip_x_m", "hip_z_m"):
        assert np.array_equal(later[name], switched[name])
        assert not same(switched, packed)
    assert np.allclose(later["phi_printed"], switched["phi_printed"], rtol=1e-5)


def test_float64_and_half_steps(monkeypatch):
    settings = Settings(arch="cpu", precision="float64", physics_step_s=0.5e-3)
    packed = simulate(gains(20), duration_s=0.3, settings=settings)
    queue_on_processor(monkeypatch, 100)
    assert same(simulate(gains(20), duration_s=0.3, settings=settings), packed)


def test_progress_grows_and_a_walk_stops_at_an_interrupt(monkeypatch):
    queue_on_processor(monkeypatch, 100)
    told = []
    for count, duration_s in ((30, 0.35), (COUNT, 0.35)):
        told.clear()
        simulate(
            gains(count),
            duration_s=duration_s,
            settings=CPU,
            progress=lambda now_s, up: told.append((now_s, up)),
        )
        times = [now_s for now_s, _ in told]
        assert times == sorted(times)
        assert told[-1] == (pytest.approx(duration_s), 0)
    assert len(told) > 4

    def interrupt(now_s, up):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(gains(5), duration_s=1.0, settings=CPU, progress=interrupt)


def test_few_walkers_are_no_work_for_a_gpu():
    asked = ("auto", 10), ("auto", 1_000_000), ("cpu", 10), ("cuda", 10)
    taken = [
        settings_of_batch(Settings(arch=arch), count).arch for arch, count in asked
    ]
    assert taken == ["cpu", "auto", "cpu", "cuda"]


def test_few_walkers_and_many_share_a_program_where_no_gpu_is(monkeypatch):
    monkeypatch.setattr(backend, "_automatic", "auto")
    monkeypatch.setattr(backend, "may_have_gpu", lambda: False)
    assert backend._engine(Settings()) == backend._engine(Settings(arch="cpu"))
