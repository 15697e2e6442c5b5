"""Studies of the walker in Optuna: the determinants-of-gait sampler, objectives, experiments.

Importing this package imports neither Taichi nor matplotlib.
"""

from study.dog_sampler import DoGSampler
from study.score_table import ScoreTable

__all__ = ["DoGSampler", "ScoreTable"]
