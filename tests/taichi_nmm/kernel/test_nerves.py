"""Lag and noise of the nerves, interpreted by NumPy: closed forms, and white noise."""

import numpy as np
import pytest

from taichi_nmm.kernel.layout import Const, Signal, State, Work
from tests.parity.interpreter import interpreted

TICKS, WALKERS = 2000, 50


@pytest.fixture(scope="module")
def nerves():
    return interpreted("nerves")[0]


def felt(nerves, signals, blend, amplitude, seeds):
    """What is felt of signals that stay the same, [t, signal, n]."""
    lanes = np.arange(len(seeds))
    state, const, work = (
        layout.of(np.zeros((layout.count, len(seeds))))
        for layout in (State, Const, Work)
    )
    const.nerve_blend[:] = blend
    const.sensing_noise[:] = amplitude
    const.noise_seed[:] = seeds
    heard = []
    for tick in range(TICKS):
        work.sensed[:] = signals
        nerves.feel(lanes, tick, state, const, work)
        heard.append(work.sensed[:].copy())
    return np.array(heard)


@pytest.mark.slow
def test_a_lag_is_of_first_order_flags_have_none_without_it_nothing_changes(nerves):
    lag_s = 0.05
    heard = felt(nerves, 1.0, 1.0 - np.exp(-1e-3 / lag_s), 0.0, np.zeros(1))[:, :, 0]
    expected = 1.0 - np.exp(-np.arange(1, TICKS + 1) * 1e-3 / lag_s)
    for signal in range(Signal.count):
        flag = signal in nerves.FLAGS
        np.testing.assert_allclose(
            heard[:, signal], 1.0 if flag else expected, rtol=1e-12
        )
    signals = np.random.default_rng(3).normal(size=(Signal.count, 4))
    heard = felt(nerves, signals, 1.0, 0.0, np.arange(4.0))
    assert np.array_equal(heard, np.broadcast_to(signals, heard.shape))


def test_noise_is_uniform_white_and_each_its_own(nerves):
    amplitude = 0.02
    seeds = np.random.default_rng(0).integers(2**24, size=WALKERS).astype(float)
    noise = felt(nerves, 0.0, 1.0, amplitude, seeds)
    assert not noise[:, list(nerves.FLAGS)].any()
    count = TICKS * WALKERS
    for signal, scale in nerves.FELT:
        share = noise[:, signal] / (amplitude * scale)
        assert share.min() >= -1.0 and share.max() < 1.0
        counts = np.histogram(share, 10, (-1, 1))[0]
        assert np.abs(counts - count / 10).max() < 5 * np.sqrt(count / 10)
        later = np.mean(share[1:] * share[:-1], axis=0) * 3.0  # variance 1/3
        assert np.abs(later).max() < 5 / np.sqrt(TICKS)
    streams = np.concatenate(
        [noise[:, signal] for signal, _ in nerves.FELT[:6]], axis=1
    )
    related = np.abs(np.corrcoef(streams.T) - np.eye(streams.shape[1]))
    assert related.max() < 6 / np.sqrt(TICKS)
    assert Signal.count == len(nerves.FELT) + len(nerves.FLAGS)
