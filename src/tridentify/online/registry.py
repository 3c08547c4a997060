"""The on-line estimators by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from tridentify.online.estimator import Estimator
from tridentify.online.gradient import Gradient
from tridentify.online.kalman import Kalman
from tridentify.online.recursive_least_squares import RecursiveLeastSquares
from tridentify.online.three_model import ThreeModel

ESTIMATORS: Mapping[str, Callable[[], Estimator]] = MappingProxyType(
    {
        "three-model": ThreeModel,
        "recursive-least-squares": RecursiveLeastSquares,
        "kalman": Kalman,
        "gradient": Gradient,
    }
)
"""Name -> estimator with its default options; the command line and the contract tests read it."""
