"""A structure and its records, resolved: what every pass of an estimator works on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.realization import Cascade, Complex, sort_poles
from tridentify.regression import Experiment, Regression, restricted
from tridentify.structure import Structure

Array = NDArray[np.float64]

SLOWEST = 1e-3
FASTEST = 20.0
LEAST_DAMPED = 1e-6
BELOW_NYQUIST = 0.98

REFLECTED = "reflected an unstable pole"
TOO_FAST = "held a pole at the fastest the sampling can show"
TOO_SLOW = "held a pole at the slowest decay the record can show"


@dataclass(frozen=True, eq=False)
class Problem:
    """Experiments and orders; nuisance terms are decided.

    Attributes
    ----------
    experiments : tuple of Experiment
    n_poles : int
        Degree of the shared denominator.
    n_zeros : tuple of tuples of int
        Degrees of the numerators, ``[output][input]``.
    power : (n_outputs,) array
        Mean squares of the outputs about their means.
    size : (n_outputs,) array
        Mean squares of the outputs as recorded: what rounding is relative to.
    """

    experiments: tuple[Experiment, ...]
    n_poles: int
    n_zeros: tuple[tuple[int, ...], ...]
    power: Array
    size: Array

    @classmethod
    def of(
        cls,
        experiments: Sequence[Experiment],
        n_poles: int,
        n_zeros: tuple[tuple[int, ...], ...],
    ) -> Problem:
        """A problem with the scales of its outputs."""
        spread = np.zeros(len(n_zeros))
        size = np.zeros(len(n_zeros))
        count = np.zeros(len(n_zeros))
        for e in experiments:
            y = e.y
            n = np.full(len(n_zeros), float(e.n_samples))
            if np.isnan(y.sum()):
                n = np.maximum(np.isfinite(y).sum(axis=0), 1.0)
                y = np.where(np.isfinite(y), y, np.nansum(y, axis=0) / n)
            squares = np.einsum("ij,ij->j", y, y)
            # centred on the first value, so that a large trim does not drown the movement
            moved = y - y[0]
            about = np.einsum("ij,ij->j", moved, moved)
            spread += np.maximum(about - moved.sum(axis=0) ** 2 / y.shape[0], 0.0)
            size = np.maximum(size, squares / y.shape[0])
            count += n
        return cls(tuple(experiments), n_poles, n_zeros, spread / count, size)

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return len(self.n_zeros)

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return len(self.n_zeros[0])

    @property
    def biproper(self) -> bool:
        """Whether any channel has as many zeros as poles."""
        return any(m == self.n_poles for row in self.n_zeros for m in row)

    @property
    def n_coefficients(self) -> int:
        """Number of physical coefficients."""
        return self.n_poles + sum(m + 1 for row in self.n_zeros for m in row)

    @property
    def n_nuisance(self) -> int:
        """Number of nuisance terms over all experiments and outputs."""
        return self.n_outputs * sum(
            self.n_poles * e.free + e.offset + e.drift for e in self.experiments
        )

    @property
    def noise(self) -> tuple[Array, ...]:
        """Autoregressive coefficients of each output's noise; empty where all are white."""
        return self.experiments[0].noise

    def whitened(self, noise: tuple[Array, ...]) -> Problem:
        """The same problem with a model of the noise (the empty tuple: white)."""
        experiments = tuple(replace(e, noise=noise) for e in self.experiments)
        return replace(self, experiments=experiments)

    @property
    def slowest(self) -> float:
        """Slowest decay that can be told from a constant [rad/s]."""
        return SLOWEST / max(e.duration for e in self.experiments)

    @property
    def fastest(self) -> float:
        """Fastest pole that leaves a trace between two samples [rad/s]."""
        return FASTEST / min(e.dt for e in self.experiments)

    def admissible(self, poles: Complex) -> tuple[Complex, str]:
        """Reflect unstable poles and keep all of them where the record can see them.

        Parameters
        ----------
        poles : (n,) complex array [rad/s]

        Returns
        -------
        poles : (n,) complex array
            In the open left half plane.
        note : str
            What was done; empty when nothing was.
        """
        size = np.abs(poles)
        size = np.where(np.isfinite(size), size, self.fastest)
        real = np.where(np.isfinite(poles.real), poles.real, -self.fastest)
        imag = np.where(np.isfinite(poles.imag), poles.imag, 0.0)
        note = ""
        if np.any(real > 0):
            note = REFLECTED
        real = -np.abs(real)
        factor = np.where(size > self.fastest, self.fastest / np.maximum(size, 1e-300), 1.0)
        if np.any(factor < 1):
            note = TOO_FAST
        real, imag = real * factor, imag * factor
        nyquist = BELOW_NYQUIST * np.pi / min(e.dt for e in self.experiments)
        if np.any(np.abs(imag) > nyquist):
            note = TOO_FAST
            imag = np.clip(imag, -nyquist, nyquist)
        floor = np.maximum(self.slowest, LEAST_DAMPED * np.abs(imag))
        if np.any(-real < floor):
            note = TOO_SLOW
        real = -np.maximum(-real, floor)
        return sort_poles(real + 1j * imag), note


@dataclass(frozen=True, eq=False)
class Variant:
    """A choice of nuisance terms seen from a problem that has all of them.

    Attributes
    ----------
    free, offset, drift : bool
        Which terms to keep.
    constants : tuple of (n_inputs,) arrays or None
        Per experiment, what has to be added back to the inputs.
    """

    free: bool
    offset: bool
    drift: bool
    constants: tuple[Array | None, ...]

    def problem(self, base: Problem) -> Problem:
        """The smaller problem; its inputs are the base's, so it is for counting only."""
        experiments = tuple(
            replace(e, free=self.free, offset=self.offset, drift=self.drift)
            for e in base.experiments
        )
        return replace(base, experiments=experiments)

    def regressions(self, whole: Sequence[Regression], bank: Cascade) -> tuple[Regression, ...]:
        """Triangles of the smaller problem from those of the base."""
        return tuple(
            restricted(
                regression,
                bank,
                free=self.free,
                offset=self.offset,
                drift=self.drift,
                constants=constants,
            )
            for regression, constants in zip(whole, self.constants, strict=True)
        )


def poles_of(structure: Structure) -> int:
    """Degree of the shared denominator."""
    assert isinstance(structure.poles, int)
    return structure.poles
