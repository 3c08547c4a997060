"""The standard errors that planned experiments will give, as a result."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tridentify.errors import OptionError, ParameterNameError, UndeterminedError, shown
from tridentify.estimation.answer.trace import freeze_arrays
from tridentify.excitation.information import Information
from tridentify.numerics.arrays import Array
from tridentify.writing.layout import format_std, format_table, format_value, html_table

LARGEST = 1e9
"""Factor of amplitude or of repetitions beyond which no plan is looked for."""


VISIBLY = 1.1
"""Ratio of relative errors beyond which a table shows both: a plan need not be known to a tenth."""


@dataclass(frozen=True, eq=False, repr=False)
class Precision:
    """Standard errors that planned experiments will give.

    Attributes
    ----------
    names : tuple of str
    theta : (p,) array
        The coefficients for which it holds.
    cov : (p, p) array
        The Cramer-Rao bound; zero for what is fixed.
    amplitude : (n_inputs,) array
        Largest magnitudes of the inputs over all experiments.
    noise_std : (n_outputs,) array
    nuisance : str
        What is estimated along, in words.
    notes : tuple of str
        What to know about these numbers.
    draws : (n_draws, p) array
        Standard errors for draws of the model, where it is an `Estimate`; else empty.
    draw_values : (n_draws, p) array
        The coefficients of those draws.
    own : Information
        What the experiments tell, for further questions.
    """

    names: tuple[str, ...]
    theta: Array
    cov: Array
    amplitude: Array
    noise_std: Array
    nuisance: str
    notes: tuple[str, ...]
    draws: Array
    draw_values: Array
    own: Information

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def std(self) -> Array:
        """(p,) standard errors."""
        return np.asarray(np.sqrt(np.diag(self.cov)))

    @property
    def relative(self) -> Array:
        """(p,) standard errors over the magnitudes of the coefficients."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.where(self.std > 0, self.std / np.abs(self.theta), 0.0))

    @property
    def correlations(self) -> Array:
        """(p, p) correlations of the errors; zero for what is fixed."""
        std = np.where(self.std > 0, self.std, np.inf)
        found = self.cov / np.outer(std, std)
        np.fill_diagonal(found, 1.0)
        return np.asarray(found)

    @property
    def relative_quantiles(self) -> Array:
        """(2, p) median and 95 % quantile of the relative errors over draws of the model.

        Each draw's standard errors are taken over its own coefficients. Empty without draws.
        """
        if not len(self.draws):
            return np.zeros((0, len(self.names)))
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(self.draws > 0, self.draws / np.abs(self.draw_values), 0.0)
        return np.asarray(np.quantile(ratio, [0.5, 0.95], axis=0))

    def factor_for(self, wanted: Mapping[str, float]) -> float:
        """By what all amplitudes must be multiplied for wanted relative errors.

        Parameters
        ----------
        wanted : mapping of str to float
            Relative standard errors by coefficient, 0.05 for 5 %.

        Returns
        -------
        float
            Below one where the plan gives more than is wanted.

        Raises
        ------
        ParameterNameError, OptionError
            There is no such coefficient, or no positive wish.

        Examples
        --------
        >>> from tridentify import Structure, TransferFunction
        >>> from tridentify.excitation import precision, prbs
        >>> model, plan = TransferFunction([2.0], [1.0, 1.0]), prbs(7, dt=0.2)
        >>> rest = Structure(1, 0, offset=False, initial_state="rest")
        >>> here = precision(model, plan, rest, noise_std=0.1)
        >>> twice = precision(model, plan.scaled(2.0), rest, noise_std=0.1)
        >>> round(here.factor_for({"a0": float(twice.relative[0])}), 6)
        2.0
        """
        goals = self._goals(wanted)
        if not self.own.held.size:
            return max(float(self.relative[k]) / goal for k, goal in goals.items())
        low, high = 1.0 / LARGEST, LARGEST
        if not self._meets(goals, high):
            raise UndeterminedError(
                f"found no amplitude that gives {shown(dict(wanted))}; expected wishes that the "
                "experiment can meet; excite at other frequencies"
            )
        while high / low > 1.0 + 1e-9:
            middle = math.sqrt(low * high)
            low, high = (low, middle) if self._meets(goals, middle) else (middle, high)
        return high

    def amplitude_for(self, wanted: Mapping[str, float]) -> Array:
        """(n_inputs,) amplitudes at which the same course gives wanted relative errors.

        Parameters and errors as in `factor_for`.
        """
        return np.asarray(self.factor_for(wanted) * self.amplitude)

    def repetitions_for(self, wanted: Mapping[str, float]) -> int:
        """How often the experiments must be made for wanted relative errors.

        Each repetition is a record of its own, with nuisance terms of its own. Parameters and
        errors as in `factor_for`.
        """
        return max(1, math.ceil(self.factor_for(wanted) ** 2 * (1.0 - 1e-9)))

    def _goals(self, wanted: Mapping[str, float]) -> dict[int, float]:
        found = {}
        for name, goal in dict(wanted).items():
            if name not in self.names:
                raise ParameterNameError.found(
                    "", name, f"one of {', '.join(self.names)}", "correct the name"
                )
            number = isinstance(goal, (int, float)) and math.isfinite(goal) and goal > 0
            if not number or self.theta[self.names.index(name)] == 0:
                raise OptionError(
                    f"found {shown(goal)} wanted for {name} = "
                    f"{self.theta[self.names.index(name)]:g}; expected a positive relative error "
                    "of a coefficient that is not zero; write for example {'a0': 0.05}"
                )
            found[self.names.index(name)] = float(goal)
        if not found:
            raise OptionError(
                "found no wish; expected relative errors by coefficient; write for example "
                "{'a0': 0.05}"
            )
        return found

    def _meets(self, goals: Mapping[int, float], factor: float) -> bool:
        std = np.sqrt(np.diag(self.own.covariance(factor)))
        return all(std[k] <= goal * abs(self.theta[k]) for k, goal in goals.items())

    @property
    def _titles(self) -> tuple[str, ...]:
        over = ("95 % of draws",) if self._draws_differ else ()
        return ("coefficient", "value", "std error", "relative", *over, "")

    @property
    def _draws_differ(self) -> bool:
        """Whether other models that the estimate allows give errors that differ visibly."""
        spread = self.relative_quantiles[1:]
        return bool(np.any(spread > VISIBLY * self.relative))

    def _rows(self) -> list[tuple[str, ...]]:
        spread = self.relative_quantiles[1:] if self._draws_differ else self.relative_quantiles[:0]
        rows = []
        for k, name in enumerate(self.names):
            value, std = float(self.theta[k]), float(self.std[k])
            if not std:
                rows.append((name, format_value(value), "-", "known", *("",) * len(spread), ""))
                continue
            over = [_percent(float(q[k])) for q in spread]
            cells = (format_value(value, std), format_std(std), _percent(float(self.relative[k])))
            rows.append((name, *cells, *over, ""))
        return rows

    def summary(self) -> str:
        """Fixed-width text: standard errors, the strongest correlation, what was assumed."""
        size = ", ".join(f"{a:.4g}" for a in self.amplitude)
        noise = ", ".join(f"{s:.4g}" for s in self.noise_std)
        lines = [
            "Precision of a planned experiment (Cramer-Rao bound)",
            f"amplitude {size}; noise std {noise}; {self.nuisance}",
            "",
            *format_table(self._titles, self._rows()),
        ]
        off = np.abs(self.correlations - np.eye(len(self.names)))
        if off.size > 1 and off.max() > 0:
            i, j = (int(k) for k in np.unravel_index(int(np.argmax(off)), off.shape))
            lines += ["", f"strongest correlation: {self.correlations[i, j]:+.3f} between "
                      f"{self.names[i]} and {self.names[j]}"]  # fmt: skip
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])

    def _repr_html_(self) -> str:
        titles, rows = self._titles[:-1], [row[:-1] for row in self._rows()]
        return html_table(titles, rows, f"Precision of a planned experiment; {self.nuisance}")

    def __repr__(self) -> str:
        pairs = zip(self.names, self.relative, strict=True)
        return f"Precision({', '.join(f'{name}: {_percent(float(r))}' for name, r in pairs)})"

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, text and lists, ready for JSON."""
        return {
            "names": list(self.names),
            "theta": self.theta.tolist(),
            "std": self.std.tolist(),
            "relative": [r if math.isfinite(r) else None for r in self.relative.tolist()],
            "cov": self.cov.tolist(),
            "amplitude": self.amplitude.tolist(),
            "noise_std": self.noise_std.tolist(),
            "nuisance": self.nuisance,
            "notes": list(self.notes),
        }


def _percent(ratio: float) -> str:
    if not math.isfinite(ratio):
        return "-"
    return f"{100.0 * ratio:.3g} %" if ratio <= 1.0 else "> 100 %"
