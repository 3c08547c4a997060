"""A plant under a linear, continuous controller, by its coprime factors.

With the plant ``B / A`` and a reference ``r``, input and output are driven by

    u_r = A(p) X(p) / D(p) r,        y_r = B(p) X(p) / D(p) r,                                 (1)

``D`` with the poles of the loop and ``X`` what of the controller acts on the reference. Both are
stable whatever the plant is: ``A`` is a numerator here. As ``r`` is known between the samples, so
are they. ``A``, ``B``, ``X`` and ``D`` are fitted together; the derivatives by numerators are
filters ``p^i / D`` of ``r``, those by ``D`` the states of a bank on its poles, driven by (1), and
all of them lie on one cascade that has every pole twice (`numerics.realization`): nothing of high
order is expanded. Errors are those of `plant_form`.

References: P. Van den Hof, R. Schrama, R. de Callafon & O. Bosgra, *Identification of normalised
coprime plant factors from closed-loop experimental data*, European Journal of Control 1 (1995)
62-74. E. van Donkelaar & P. Van den Hof, *Analysis of closed-loop identification with a
tailor-made parametrization*, European Journal of Control 6 (2000) 54-62.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.coprime.plant_form import Rows
from tridentify.estimation.closed_loop.driven import Driven, columns_of, starting
from tridentify.estimation.closed_loop.linear_errors import ramp
from tridentify.estimation.closed_loop.own_poles import FASTEST, LEAST_DAMPED, SLOWEST
from tridentify.estimation.closed_loop.predictor import Plant
from tridentify.models.regression import response_of
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.realization import Cascade, cascade, filter_map, monomials, roots_of

STEPS = 40
"""Of Levenberg and Marquardt; ten are usual."""
TRIALS = 10
"""Of a step that does not lower the errors."""
STILL = 1e-6
"""Relative fall of the errors that ends the steps."""
TOLD_APART = 1e-7
"""Of columns with unit length, what one must add to the others."""


@dataclass(frozen=True, eq=False)
class Factors:
    """Equation (1).

    Attributes
    ----------
    plant : Plant
        Of one input.
    x : (n_references, k) array
        Descending powers.
    poles : (n + k - 1,) complex array
        Of the loop [rad/s].
    """

    plant: Plant
    x: Array
    poles: Complex

    @property
    def numerators(self) -> tuple[Array, Array]:
        """Of plant: ``A`` and ``B``, descending powers."""
        return np.append(1.0, self.plant.a), self.plant.b[0]

    @cached_property
    def bank(self) -> Cascade:
        """On the poles of the loop."""
        return cascade(self.poles)

    @cached_property
    def twice(self) -> Cascade:
        """With every pole twice."""
        return cascade(np.concatenate([self.poles, self.poles]))

    @cached_property
    def _powers(self) -> tuple[Array, Array]:
        """Rows on the bank and direct parts of ``p^i / D``."""
        q = self.poles.size
        rows, direct = np.zeros((q + 1, q)), np.zeros(q + 1)
        rows[:q] = monomials(self.bank, q)
        direct[q], rows[q] = rows[q - 1] @ self.bank.b, rows[q - 1] @ self.bank.a
        return rows, direct

    def row(self, numerator: Array) -> tuple[Array, float]:
        """Row on the bank and direct part of a numerator over ``D``."""
        rows, direct = self._powers
        ascending = numerator[::-1]
        return ascending @ rows[: ascending.size], float(ascending @ direct[: ascending.size])

    def moved(self, change: Array) -> Factors:
        """Along a step: of the plant's free directions, of ``x``, and of ``D`` on its bank."""
        k, q = self.plant.free.shape[1], self.poles.size
        plant = self.plant.with_theta(self.plant.theta + self.plant.free @ change[:k])
        x = self.x + change[k:-q].reshape(self.x.shape)
        return Factors(plant, x, roots_of(self.bank, change[-q:]))

    def is_seen(self, loops: Sequence[Loop]) -> bool:
        """Whether every mode of the loop is one that the samples show."""
        sizes, decay = np.abs(self.poles), -self.poles.real
        step = float(loops[0].record.dt or 0.0)
        slowest = SLOWEST / min(loop.record.duration for loop in loops)
        return bool(
            np.isfinite(self.x).all()
            and np.isfinite(self.plant.theta).all()
            and np.all(decay > slowest)
            and np.all(sizes * step < FASTEST)
            and np.all(decay > LEAST_DAMPED * sizes)
        )


@dataclass(frozen=True, eq=False)
class Fit:
    """Factors beside the records of a loop, their errors seen through `Rows`.

    Attributes
    ----------
    loops : tuple of Loop
    factors : Factors
    rows : Rows
    """

    loops: tuple[Loop, ...]
    factors: Factors
    rows: Rows

    @cached_property
    def _states(self) -> list[tuple[Array, Array, Array]]:
        """Per record: references, states of the doubled bank by reference, free response."""
        found, width = [], 2 * self.factors.poles.size
        for loop in self.loops:
            part = loop.fitted
            assert isinstance(part, Driven)
            experiment = replace(starting(loop.record, part.before), free=True)
            r = experiment.u
            k = width * (r.shape[1] + 1)
            pick = np.eye(k, k + r.shape[1])
            seen = response_of(experiment, self.factors.twice, pick, outputs=[0] * k)
            own = seen[:, width:].reshape(len(r), r.shape[1], width)
            found.append((r, own, seen[:, : width // 2]))
        return found

    def _signal(self, k: int, numerators: Sequence[Array]) -> Array:
        """(n_samples,) sum over references of numerators over ``D``."""
        r, own, _ = self._states[k]
        q, found = self.factors.poles.size, np.zeros(len(r))
        for j, one in enumerate(numerators):
            row, direct = self.factors.row(one)
            found += own[:, j, :q] @ row + direct * r[:, j]
        return found

    def _pair(self, k: int, u: Sequence[Array] | None, y: Sequence[Array] | None) -> Array:
        """(n_samples, 2) of input and output, the latter as late as it answers."""
        none = np.zeros(len(self._states[k][0]))
        both = [none if one is None else self._signal(k, one) for one in (u, y)]
        return np.column_stack([both[0], self._late(both[1])])

    def _late(self, signal: Array) -> Array:
        late = round(self.loops[0].late[0]) if self.loops[0].late else 0
        return np.concatenate([np.zeros(late), signal[: len(signal) - late]])

    @cached_property
    def driven(self) -> list[Array]:
        """(n_samples, 2) what the references drive of input and output, per record."""
        a, b = self.factors.numerators
        by_u, by_y = ([np.polymul(one, x) for x in self.factors.x] for one in (a, b))
        return [self._pair(k, by_u, by_y) for k in range(len(self.loops))]

    @cached_property
    def raw(self) -> list[Array]:
        """(n_samples, 2) what is left of input and output, from their first samples."""
        found = []
        for loop, own in zip(self.loops, self.driven, strict=True):
            left = np.column_stack([loop.record.u[:, 0], loop.record.y[:, 0]]) - own
            found.append(left - left[0])
        return found

    @cached_property
    def _starts(self) -> list[Array]:
        """(n_samples, k, 2) columns of starts, offsets and drifts in both rows, per record."""
        found = []
        for k, loop in enumerate(self.loops):
            count = loop.record.n_samples
            level = [np.ones(count)] + ([ramp(count)] if loop.drift else [])
            free = np.column_stack([self._states[k][2], *level])
            found.append(self.rows.starts(loop, free))
        return found

    @property
    def pairs(self) -> list[Array]:
        """(n_samples, 2) both rows beside their own best starts, unweighed, per record."""
        found = []
        for raw, starts in zip(self.raw, self._starts, strict=True):
            own = self.rows.of(raw[:, None, :])[:, 0]
            rest = np.empty_like(own)
            for c in range(2):
                table = starts[:, :, c]
                table = table[:, np.any(table != 0.0, axis=0)]
                table = table / np.linalg.norm(table, axis=0)
                rest[:, c] = own[:, c] - table @ np.linalg.lstsq(table, own[:, c], rcond=1e-7)[0]
            found.append(rest)
        return found

    @cached_property
    def beside(self) -> Array:
        """Orthonormal columns of starts, offsets and drifts."""
        blocks = [self.rows.white(one) for one in self._starts]
        ends = np.cumsum([0, *(one.shape[1] for one in blocks)])
        table = np.zeros((sum(len(one) for one in blocks), ends[-1]))
        at = 0
        for one, low, high in zip(blocks, ends, ends[1:], strict=False):
            table[at : at + len(one), low:high] = one
            at += len(one)
        u, values, _ = np.linalg.svd(
            table / (np.linalg.norm(table, axis=0) + 1e-300), full_matrices=False
        )
        return np.asarray(u[:, values > TOLD_APART * values[0]])

    @cached_property
    def errors(self) -> Array:
        """(n,) whitened, beside starts and offsets; the two rows of a sample side by side."""
        pairs = [self.rows.of(one[:, None, :]) for one in self.raw]
        own = np.concatenate([self.rows.white(one)[:, 0] for one in pairs])
        return np.asarray(own - self.beside @ (self.beside.T @ own))

    @cached_property
    def cost(self) -> float:
        """Their sum of squares."""
        found = float(self.errors @ self.errors)
        return found if np.isfinite(found) else np.inf

    @cached_property
    def slopes(self) -> Array:
        """(n, n_unknowns) minus the derivatives of the errors."""
        tables = [
            self.rows.white(self.rows.of(self.derivatives(k))) for k in range(len(self.loops))
        ]
        whole = np.vstack(tables)
        return np.asarray(whole - self.beside @ (self.beside.T @ whole))

    def derivatives(self, k: int) -> Array:
        """(n_samples, n_unknowns, 2) of what is driven, by plant, ``x`` and ``D``."""
        a, b = self.factors.numerators
        x, q = self.factors.x, self.factors.poles.size
        by_plant = [
            self._pair(k, [_times(one, a.size - 2 - i) for one in x], None)
            for i in range(a.size - 1)
        ]
        by_plant += [
            self._pair(k, None, [_times(one, b.size - 1 - i) for one in x]) for i in range(b.size)
        ]
        along = np.einsum("knc,nf->kfc", np.stack(by_plant, axis=1), self.factors.plant.free)
        by_x = []
        for j in range(len(x)):
            for power in range(x.shape[1])[::-1]:
                alone = [np.zeros(1)] * len(x)
                u, y = list(alone), list(alone)
                u[j], y[j] = _times(a, power), _times(b, power)
                by_x.append(self._pair(k, u, y))
        by_d = np.zeros((len(along), q, 2))
        _, own, _ = self._states[k]
        answers = filter_map(self.factors.bank, self.factors.twice)
        for j, one in enumerate(x):
            for c, numerator in enumerate((a, b)):
                row, direct = self.factors.row(np.polymul(numerator, one))
                on_twice = np.append(row, np.zeros(q)) + direct * self.factors.twice.b
                by_d[:, :, c] -= own[:, j] @ np.tensordot(on_twice, answers, 1).T
        by_d[:, :, 1] = np.column_stack([self._late(one) for one in by_d[:, :, 1].T])
        return np.concatenate([along, np.stack(by_x, axis=1), by_d], axis=1)

    def solved(self, damping: float, which: slice = slice(None)) -> Array:
        """(n_unknowns,) a step; of some unknowns alone, where it is asked for."""
        table = self.slopes[:, which]
        size = np.linalg.norm(table, axis=0) + 1e-300
        u, values, turned = np.linalg.svd(table / size, full_matrices=False)
        found = np.zeros(self.slopes.shape[1])
        weights = values / (values**2 + damping + np.finfo(float).eps)
        found[which] = (turned.T @ (weights * (u.T @ self.errors))) / size
        return found

    def at(self, factors: Factors) -> Fit:
        """The same with other factors."""
        return Fit(self.loops, factors, self.rows)

    def descended(self) -> Fit:
        """The least squares that Levenberg and Marquardt's steps lead to."""
        here, damping = self, 1e-3
        for _ in range(STEPS):
            following = None
            for _ in range(TRIALS):
                factors = here.factors.moved(here.solved(damping))
                if factors.is_seen(here.loops):
                    other = here.at(factors)
                    if other.cost < here.cost:
                        following = other
                        break
                damping = max(6.0 * damping, 1e-9)
            if following is None:
                return here
            fell, here = 1.0 - following.cost / here.cost, following
            damping *= 0.15
            if fell < STILL:
                break
        return here

    def parts(self) -> list[Driven]:
        """What is driven, as a continuous function of time, per record."""
        found = []
        a, b = self.factors.numerators
        for k, loop in enumerate(self.loops):
            record, part = loop.record, loop.fitted
            assert isinstance(part, Driven)
            _, own, _ = self._states[k]
            q, direct = self.factors.poles.size, np.asarray(record.reference)
            states = own[:, :, :q].reshape(len(own), -1)
            n_refs = direct.shape[1]
            weights = np.zeros((1 + n_refs + states.shape[1], 2))
            for j, x in enumerate(self.factors.x):
                for c, numerator in enumerate((a, b)):
                    row, through = self.factors.row(np.polymul(numerator, x))
                    weights[1 + j, c] = through
                    weights[1 + n_refs + j * q : 1 + n_refs + (j + 1) * q, c] = row
            columns = columns_of(direct, states)
            signals = np.column_stack([record.u[:, 0], record.y[:, 0]])
            weights[0] = np.mean(signals - columns @ weights, axis=0)
            found.append(Driven(record, self.factors.poles, part.before, weights, columns))
        return found


def _times(polynomial: Array, power: int) -> Array:
    """A polynomial times ``p^power``."""
    return np.concatenate([polynomial, np.zeros(power)])
