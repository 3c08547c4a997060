"""What machine code is given of a problem: the samples of its experiments, and what is fitted."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tridentify.estimation.likelihood.linear_fit import Linear
from tridentify.estimation.likelihood.setup.bank import Bank
from tridentify.estimation.likelihood.setup.problem import LEAST_DAMPED, Problem, Variant
from tridentify.estimation.likelihood.setup.triangles import Triangles
from tridentify.models.columns import Layout
from tridentify.numerics.arrays import Array, Complex


class Given(NamedTuple):
    """The arguments of `compiled_fit.fit_there`.

    Attributes
    ----------
    charts : tuple
        Of `models.flat_charts.FlatCharts`, but for its places and counts.
    shape : tuple
        Triangle and column of each output, the pattern of the problem, whether impulse states are
        among the columns and whether a free state is fitted, which of constant and ramp are kept,
        and constants that are put back on the inputs.
    """

    charts: tuple[Any, ...]
    shape: tuple[Any, ...]

    @property
    def is_shifted(self) -> bool:
        """Whether constants are put back on the inputs."""
        return bool(self.shape[9].size)


def given(base: Problem, variant: Variant | None) -> Given | None:
    """What machine code is given of a choice of nuisance terms; None where it does not serve."""
    if variant not in base.charted:
        base.charted[variant] = _given(base, variant)
    found: Given | None = base.charted[variant]
    return found


def _given(base: Problem, variant: Variant | None) -> Given | None:
    flat, e = base.flat, base.experiments[0]
    if flat is None:
        return None
    free, offset, drift, constants = e.free, e.offset, e.drift, np.zeros((0, 0))
    if variant is not None:
        free, offset, drift = variant.free, offset and variant.offset, min(drift, variant.drift)
        if shifts(variant):
            if any(one.leads is not None for one in base.experiments):
                return None
            none = np.zeros(base.n_inputs)
            constants = np.array([none if one is None else one for one in variant.constants])
    nuisance = np.array([0] * offset + [e.offset + k for k in range(drift)], dtype=np.int64)
    shape = flat.which, flat.place, *base.pattern, int(e.free), free, nuisance, constants
    return Given(flat[:5], shape)


def fitted(
    base: Problem, variant: Variant | None, poles: Complex, repeats: int
) -> tuple[Triangles, Linear] | None:
    """Triangles and linear fit at some poles in one call; None where machine code does not serve.

    Parameters
    ----------
    base : Problem
    variant : Variant, optional
        The nuisance terms that are kept (default: all).
    poles : (n,) complex array
        Admissible.
    repeats : int
        How often each stands in the bank.
    """
    known = given(base, variant)
    if known is None or known.is_shifted:
        return None
    from tridentify.estimation.likelihood.compiled.fit import fit_there

    poles = np.ascontiguousarray(poles, dtype=np.complex128)
    return told(base, variant, known, poles, repeats, fit_there(*known, poles, repeats))


def told(
    base: Problem,
    variant: Variant | None,
    known: Given,
    poles: Complex,
    repeats: int,
    fit: tuple[Any, ...],
) -> tuple[Triangles, Linear]:
    """What `compiled_fit.fit_there` has told, in the words of those who go on with it."""
    flat, e = base.flat, base.experiments[0]
    assert flat is not None
    parts, stack, targets, columns, linear = fit
    bank = Bank.made(base.pattern, poles, repeats, *parts)
    layout = Layout(parts[1].size, base.n_inputs, e.free, e.offset, e.drift)
    free, experiments = known.shape[7], base.experiments
    triangles = Triangles(
        variant, bank, stack, flat.which, targets, layout, free, columns, flat.counts, experiments
    )
    return triangles, Linear(*linear)


def shifts(variant: Variant) -> bool:
    """Whether a choice puts constants back on the inputs."""
    return any(constant is not None and constant.any() for constant in variant.constants)


def limits_of(problem: Problem) -> Array:
    """(4,) the fastest and the slowest pole, the largest imaginary part, the least damping."""
    return np.array([problem.fastest, problem.slowest, problem.nyquist, LEAST_DAMPED])
