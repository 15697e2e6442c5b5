"""Medicine: the settings of boosted trees that tell benign from malignant tumours.

scikit-learn's bundled breast cancer data (569 tumours, 30 measurements of cell nuclei each). The
costly objective is a cross-validation on all of them; the cheap run trains once, on 110.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution
from sklearn.datasets import load_breast_cancer
from sklearn.ensemble import GradientBoostingClassifier
from sklearn.metrics import log_loss
from sklearn.model_selection import StratifiedKFold

from study.benchmarks.outside.definition import Definition, Feature, Settings

Floats = NDArray[np.float64]
Tumours = tuple[Floats, NDArray[np.int64]]  # measurements [n, 30], 1 where benign [n]

SPLIT_SEED = 569
TRAINED, TESTED = 110, 110  # tumours of the cheap run
FOLDS = 3

SPACE = {
    "trees": IntDistribution(5, 120, log=True),
    "learning_rate": FloatDistribution(0.01, 1.0, log=True),
    "depth": IntDistribution(1, 8),
    "leaf": IntDistribution(1, 40, log=True),  # least tumours in one
    "rows": FloatDistribution(0.3, 1.0),  # share that a tree sees
    "columns": FloatDistribution(0.05, 1.0, log=True),  # share that a split may choose from
    "loss": CategoricalDistribution(("log_loss", "exponential")),
}


def cheap(settings: Settings) -> tuple[float, ...]:
    """Loss and error on other tumours, loss on those trained on, and the size of the trees."""
    measurements, benign = _tumours()
    few = measurements[:TRAINED], benign[:TRAINED]
    others = measurements[TRAINED : TRAINED + TESTED], benign[TRAINED : TRAINED + TESTED]
    model = _model(settings).fit(*few)
    trained, _ = _loss_and_error(few[1], model.predict_proba(few[0]))
    loss, error = _loss_and_error(others[1], model.predict_proba(others[0]))
    leaves = sum(int(tree.tree_.n_leaves) for tree in model.estimators_.ravel())
    return loss, error, trained, float(leaves)


def costly(settings: Settings) -> float:
    """Cross-validated log-loss on all tumours."""
    measurements, benign = _tumours()
    probabilities = np.empty((len(benign), 2))
    for train, test in StratifiedKFold(FOLDS).split(measurements, benign):
        model = _model(settings).fit(measurements[train], benign[train])
        probabilities[test] = model.predict_proba(measurements[test])
    return _loss_and_error(benign, probabilities)[0]


@cache
def _tumours() -> Tumours:
    """All tumours in a random order."""
    measurements, benign = load_breast_cancer(return_X_y=True)
    order = np.random.default_rng(np.random.SeedSequence(SPLIT_SEED)).permutation(len(benign))
    return measurements[order], benign[order]


def _loss_and_error(benign: NDArray[np.int64], probabilities: Floats) -> tuple[float, float]:
    """Log-loss, nats, and share of errors of probabilities [n, 2]."""
    wrong = probabilities.argmax(axis=1) != benign
    return float(log_loss(benign, probabilities)), float(wrong.mean())


def _model(settings: Settings) -> GradientBoostingClassifier:
    """Not yet trained."""
    return GradientBoostingClassifier(
        n_estimators=settings["trees"],
        learning_rate=settings["learning_rate"],
        max_depth=settings["depth"],
        min_samples_leaf=settings["leaf"],
        subsample=settings["rows"],
        max_features=settings["columns"],
        loss=settings["loss"],
        random_state=0,
    )


DEFINITION = Definition(
    name="tumour-boosting",
    purpose="reported",
    field="medicine",
    cost_meaning="log-loss of boosted trees, cross-validated on 569 tumours, nats",
    space=SPACE,
    features={
        "small_loss": Feature("low", "log-loss when trained on 110 tumours, on 110 others, nats"),
        "small_error": Feature("low", "share of those 110 others that are told wrong"),
        "trained_loss": Feature("low", "log-loss on the 110 that were trained on, nats"),
        "leaves": Feature("low", "leaves of all trees, trained on the 110"),
    },
    cheap=cheap,
    costly=costly,
)
