"""Coefficients that drift as random walks, on the equation error (`online.equation`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tridentify.errors import OptionError, shown
from tridentify.numerics.arrays import Array
from tridentify.online.equation import EquationError, unknowns_of
from tridentify.online.equation_plan import maps_of, output_weights
from tridentify.online.kernels import slots
from tridentify.online.layout import Blueprint, Setting
from tridentify.online.saved.state import State
from tridentify.transfer_function import TransferFunction

SAMPLES_PER_UNKNOWN = 10
"""Samples for each unknown that least squares is given before the filter begins from it."""


@dataclass(frozen=True)
class Kalman(EquationError):
    """Coefficients that drift as random walks, on state-variable filters.

    Parameters
    ----------
    drift : float or mapping of str to float
        Standard deviation of the way that a coefficient goes in one second: one number relative
        to its size where the filter takes over, or in its own units by name (zero for those not
        named).
    filter : sequence of float, optional
        Coefficients of ``c(p)``, as for `RecursiveLeastSquares`.
    start : TransferFunction or Estimate, optional
        Model whose denominator is the filter.
    on_change : {"flag", "restart"}
        Whether a change of the coefficients is only flagged, or makes the estimator begin anew on
        the samples since.

    Raises
    ------
    OptionError
        An option is out of range.

    Examples
    --------
    >>> from tridentify import online
    >>> online.Kalman(drift={"a1": 0.05}).drift
    {'a1': 0.05}
    """

    drift: float | Mapping[str, float] = 0.01
    filter: tuple[float, ...] | None = None
    start: TransferFunction | None = None
    on_change: str = "flag"

    name: ClassVar[str] = "kalman"

    def __post_init__(self) -> None:
        self._check()
        given = self.drift.values() if isinstance(self.drift, Mapping) else [self.drift]
        for one in given:
            number = isinstance(one, (int, float)) and not isinstance(one, bool)
            if not number or not 0.0 <= one < np.inf:
                raise OptionError(
                    f"found drift={shown(self.drift)}; expected numbers of at least zero: how far "
                    "a coefficient walks in one second; correct it"
                )
        if isinstance(self.drift, Mapping):
            object.__setattr__(self, "drift", dict(self.drift))

    def __hash__(self) -> int:
        drift = tuple(self.drift.items()) if isinstance(self.drift, Mapping) else self.drift
        return hash((drift, self.filter, self.start, self.on_change))

    def begin(self, setting: Setting) -> State:
        """The state before the first sample."""
        if isinstance(self.drift, Mapping):
            wrong = [name for name in self.drift if name not in setting.names]
            if wrong:
                raise OptionError(
                    f"found drift of {shown(wrong[0])}; expected coefficients: "
                    f"{', '.join(setting.names)}; correct the name"
                )
        return super().begin(setting)

    def wait(self, setting: Setting, blueprint: Blueprint) -> float:
        """Samples that least squares is given."""
        return float(SAMPLES_PER_UNKNOWN * blueprint.n_columns + setting.late)

    def adapt(self, state: State) -> State:
        """Search for the filter, then take over from least squares."""
        x, stage = state
        if stage.searching:
            return super().adapt(state)
        old, setting = stage.blueprint, stage.setting
        if old.ints[slots.FILTERING]:
            return state
        unknowns, root, _ = unknowns_of(old, x, setting.n_outputs)
        diagonal = np.diagonal(root)
        # nothing left over is a covariance of nothing, which has no triangle
        if not (np.all(np.isfinite(root)) and np.all(diagonal > 0.0)):
            x[slots.TICK] = x[slots.COUNT] + self.wait(setting, old)
            return state
        weights = output_weights(old)
        new = self.plan(
            setting, old.poles, weights, restarted=old.nuisance.free, filtering=True,
            keep=bool(old.ints[slots.CHUNK]),
        )  # fmt: skip
        walk, widths = self._walk(setting, new, unknowns)
        c = new.constants
        at = int(new.ints[slots.C_WALK])
        c[at : at + walk.size] = walk.ravel()
        at = int(new.ints[slots.C_WIDTHS])
        c[at : at + widths.size] = widths
        found = np.zeros(new.size)
        end = int(old.ints[slots.AT_FACTOR])
        found[:end] = x[:end]
        n = new.n_columns
        found[int(new.ints[slots.AT_THETA]) :][:n] = unknowns
        at = int(new.ints[slots.AT_COVARIANCE])
        found[at : at + n] = diagonal**2
        upper = root / diagonal
        for j in range(n):
            begin = at + n + j * (j - 1) // 2
            found[begin : begin + j] = upper[:j, j]
        return State(found, stage.but(blueprint=new))

    def _walk(self, setting: Setting, blueprint: Blueprint, unknowns: Array) -> tuple[Array, Array]:
        """Directions of the walk among the unknowns, and variances a second."""
        k = len(setting.names)
        maps = maps_of(setting, blueprint.bank)
        theta = maps.constant + maps.matrix @ unknowns[-k:]
        if isinstance(self.drift, Mapping):
            speed = np.array([float(self.drift.get(name, 0.0)) for name in setting.names])
        else:
            speed = self.drift * np.abs(theta)
        walk = np.zeros((blueprint.n_columns, k))
        walk[-k:] = np.linalg.inv(maps.matrix)
        return walk, speed**2
