"""The three models while the data arrive: one sample at a time, or a record run through."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from tridentify.online.asked import NotReadyError
from tridentify.online.estimator import Estimator
from tridentify.online.gradient_rule.gradient import Gradient
from tridentify.online.kalman import Kalman
from tridentify.online.recursive_least_squares import RecursiveLeastSquares
from tridentify.online.run import Run, run
from tridentify.online.saved.state import Flag, State
from tridentify.online.three_model import ThreeModel

__all__ = [
    "ESTIMATORS",
    "Estimator",
    "Flag",
    "Gradient",
    "Kalman",
    "NotReadyError",
    "RecursiveLeastSquares",
    "Run",
    "State",
    "ThreeModel",
    "run",
]

ESTIMATORS: Mapping[str, Callable[[], Estimator]] = MappingProxyType(
    {one.name: one for one in (ThreeModel, RecursiveLeastSquares, Kalman, Gradient)}
)
"""Name -> estimator with its default options; the command line and the contract tests read it."""
