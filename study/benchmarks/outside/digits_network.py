"""Machine learning: the settings of a small network that reads scikit-learn's bundled digits.

The costly run trains on 1,000 digits; the cheap ones on 100 of them, and for the first two epochs
of the costly one, as somebody does who looks at learning curves. What diverges is as bad as
scikit-learn's log-loss can be.
"""

import warnings
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution
from sklearn.datasets import load_digits
from sklearn.metrics import log_loss
from sklearn.neural_network import MLPClassifier

from study.benchmarks.outside.definition import Definition, Feature, Settings

Floats = NDArray[np.float64]
Digits = tuple[Floats, NDArray[np.int64]]  # images [n, 64] in [0, 1], labels [n]

SPLIT_SEED = 1797
TRAINED, SMALL = 1000, 100  # digits trained on; the remaining 797 are never trained on
SMALL_TESTED = 200  # of the 1,000, by the cheap run
EPOCHS, FIRST_EPOCHS = 20, 2
CLASSES = 10
WORST_LOSS = -float(np.log(np.finfo(np.float64).eps))  # where log_loss clips probabilities

SPACE = {
    "layers": IntDistribution(1, 3),
    "width": IntDistribution(4, 128, log=True),
    "activation": CategoricalDistribution(("relu", "tanh", "logistic")),
    "solver": CategoricalDistribution(("adam", "sgd")),
    "learning_rate": FloatDistribution(1e-4, 1.0, log=True),
    "momentum": FloatDistribution(0.0, 0.99),  # of sgd alone
    "alpha": FloatDistribution(1e-6, 10.0, log=True),
    "batch": IntDistribution(16, 256, log=True),
}


def cheap(settings: Settings) -> tuple[float, ...]:
    """Loss and error of the small run, loss of the first epochs, and the network's size."""
    train, _ = _digits()
    small = _fitted(settings, _part(train, 0, SMALL), EPOCHS)
    tested = _part(train, SMALL, SMALL + SMALL_TESTED)
    first = _fitted(settings, train, FIRST_EPOCHS)
    sizes = [64] + [int(settings["width"])] * int(settings["layers"]) + [CLASSES]
    weights = sum((before + 1) * after for before, after in pairwise(sizes))
    if small is None:
        loss, error = float("inf"), float("nan")
    else:
        loss, error = _loss(small, tested), 1.0 - float(small.score(*tested))
    return loss, error, float("inf") if first is None else float(first.loss_), float(weights)


def costly(settings: Settings) -> float:
    """Log-loss on the digits that were not trained on."""
    train, test = _digits()
    network = _fitted(settings, train, EPOCHS)
    return WORST_LOSS if network is None else _loss(network, test)


@cache
def _digits() -> tuple[Digits, Digits]:
    """Those to train on, and those to test on."""
    images, labels = load_digits(return_X_y=True)
    order = np.random.default_rng(np.random.SeedSequence(SPLIT_SEED)).permutation(len(labels))
    shuffled = images[order] / 16.0, labels[order]
    return _part(shuffled, 0, TRAINED), _part(shuffled, TRAINED, len(labels))


def _part(digits: Digits, start: int, end: int) -> Digits:
    """Some of the digits."""
    return digits[0][start:end], digits[1][start:end]


def _fitted(settings: Settings, digits: Digits, epochs: int) -> Any:
    """A network trained for so many epochs; None where it diverged."""
    network = MLPClassifier(
        hidden_layer_sizes=(settings["width"],) * int(settings["layers"]),
        activation=settings["activation"],
        solver=settings["solver"],
        learning_rate_init=settings["learning_rate"],
        momentum=settings["momentum"],
        alpha=settings["alpha"],
        batch_size=min(int(settings["batch"]), len(digits[1])),
        max_iter=epochs,
        n_iter_no_change=epochs + 1,  # never stopped early
        random_state=0,
    )
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # not converged: it was not meant to
        try:
            return network.fit(*digits)
        except ValueError:  # weights that are not finite
            return None


def _loss(network: Any, digits: Digits) -> float:
    """Log-loss of a network, nats a digit."""
    probabilities = network.predict_proba(digits[0])
    if not np.isfinite(probabilities).all():
        return WORST_LOSS
    return float(log_loss(digits[1], probabilities))


DEFINITION = Definition(
    name="digits-network",
    purpose="tuning",
    field="machine learning",
    cost_meaning="log-loss of a network trained 20 epochs on 1,000 digits, on 797 others, nats",
    space=SPACE,
    features={
        "small_loss": Feature("low", "log-loss when trained on 100 digits, on 200 others, nats"),
        "small_error": Feature("low", "share of those 200 that it misreads"),
        "first_loss": Feature("low", "training loss of the second epoch of the costly run, nats"),
        "weights": Feature("high", "size of the network, weights and biases"),
    },
    cheap=cheap,
    costly=costly,
)
