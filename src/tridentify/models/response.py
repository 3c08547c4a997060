"""What the three models hand to one another: a noise-free, continuous-time output on a bank.

A model's output is never a list of samples. It is a combination of the states of an orthonormal
cascade driven by the recorded inputs (and by ``delta(t - t0)`` for the initial state), so it is
known between the samples too and can be filtered further without approximation.

Where channels have denominators of their own, the bank is one cascade beside another, a `Branch`
for each denominator, all driven by every input; a channel uses the states of its own branch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tridentify.models.regression import Regression
from tridentify.numerics.arrays import Array, Flags
from tridentify.numerics.realization import Cascade, DegreeBasis


@dataclass(frozen=True, eq=False)
class Branch:
    """One denominator's part of a bank.

    Attributes
    ----------
    inner : Cascade
        Its poles once (n states).
    bank : Cascade
        Its poles repeated: its states among those of the whole bank.
    basis : DegreeBasis
        Of ``inner``.
    states : slice
        Where its states stand.
    poles : slice
        Where its poles stand among those of all denominators.
    channels : (n_outputs, n_inputs) bool array
        Which channels have this denominator.
    """

    inner: Cascade
    bank: Cascade
    basis: DegreeBasis
    states: slice
    poles: slice
    channels: Flags

    @property
    def own(self) -> slice:
        """Its first states, with its poles once."""
        return slice(self.states.start, self.states.start + self.inner.order)


def spread(rows: Array, states: slice, order: int) -> Array:
    """Rows on some states as rows on all ``order`` states of the bank."""
    if rows.shape[-1] == order:
        return rows
    found = np.zeros((*rows.shape[:-1], order))
    found[..., states] = rows
    return found


@dataclass(frozen=True, eq=False)
class Response:
    """Outputs ``y_i = sum_j (rows[i, j] X + direct[i, j]) u_j + free[e][i] X delta``.

    Attributes
    ----------
    rows : (n_outputs, n_inputs, q) array
    direct : (n_outputs, n_inputs) array
    free : (n_experiments, n_outputs, q) array
        Free responses; zero where the experiment starts at rest.
    """

    rows: Array
    direct: Array
    free: Array

    def on(self, bank: Cascade) -> Response:
        """The same outputs on a longer bank that begins with the same poles."""
        more = bank.order - self.rows.shape[2]
        pad = ((0, 0), (0, 0), (0, more))
        return Response(np.pad(self.rows, pad), self.direct, np.pad(self.free, pad))

    def signal(self, regression: Regression, experiment: int, output: int) -> Array:
        """One output in the coordinates of an experiment's triangle."""
        total = np.zeros(regression.signals[output].shape[0])
        for j in range(self.rows.shape[1]):
            total = total + regression.input_signal(
                output, j, self.rows[output, j], self.direct[output, j]
            )
        if regression.layout.free:
            total = total + regression.impulse_signal(output, self.free[experiment, output])
        return total

    def part(self, states: slice, channels: Flags) -> Response:
        """What some channels contribute, on the states that they use.

        Parameters
        ----------
        states : slice
        channels : (n_outputs, n_inputs) bool array
        """
        outputs = np.asarray(channels.any(axis=1))
        return Response(
            self.rows[:, :, states] * channels[:, :, None],
            self.direct * channels,
            self.free[:, :, states] * outputs[:, None],
        )

    def spread(self, states: slice, order: int) -> Response:
        """A part on all ``order`` states of the bank."""
        rows, free = spread(self.rows, states, order), spread(self.free, states, order)
        return Response(rows, self.direct, free)

    def filtered(self, bank: Cascade, map_: Array) -> FilteredResponse:
        """The states of a filter driven by each output.

        Parameters
        ----------
        bank : Cascade
            On which this response is expanded.
        map_ : (q, q_c, q) array
            Of the filter, from `numerics.realization.filter_map`.
        """
        driven = self.rows + self.direct[:, :, None] * bank.b
        return FilteredResponse(_through(driven, map_), _through(self.free, map_))


def _through(rows: Array, map_: Array) -> Array:
    """``tensordot(rows, map_, 1)`` without its checks, which take longer than such a product."""
    order = map_.shape[0]
    found = np.dot(rows.reshape(-1, order), map_.reshape(order, -1))
    return np.asarray(found.reshape(*rows.shape[:-1], *map_.shape[1:]))


@dataclass(frozen=True, eq=False)
class FilteredResponse:
    """States of a filter driven by the outputs of a `Response`.

    Attributes
    ----------
    rows : (n_outputs, n_inputs, q_c, q) array
    free : (n_experiments, n_outputs, q_c, q) array
    """

    rows: Array
    free: Array

    def spread(self, states: slice, order: int) -> FilteredResponse:
        """The same for a part of the outputs, on all ``order`` states of the bank."""
        return FilteredResponse(spread(self.rows, states, order), spread(self.free, states, order))

    @classmethod
    def joined(cls, parts: Sequence[FilteredResponse]) -> FilteredResponse:
        """The states of several filters, one after the other."""
        if len(parts) == 1:
            return parts[0]
        return cls(
            np.concatenate([part.rows for part in parts], axis=2),
            np.concatenate([part.free for part in parts], axis=2),
        )

    def signals(self, regression: Regression, experiment: int, output: int) -> Array:
        """(r, q_c): one column a state of the filter."""
        total = np.zeros((regression.signals[output].shape[0], self.rows.shape[2]))
        for j in range(self.rows.shape[1]):
            total = total + regression.input_signal(output, j, self.rows[output, j].T)
        if regression.layout.free:
            total = total + regression.impulse_signal(output, self.free[experiment, output].T)
        return total


@dataclass(eq=False)
class ColumnBlocks:
    """Builds one least-squares problem over outputs and experiments from named blocks of columns.

    Blocks with the same key in several experiments or outputs share their unknowns; the others
    are local.
    """

    width: dict[object, slice] = field(default_factory=dict)
    rows: list[tuple[dict[object, Array], Array]] = field(default_factory=list)

    def add(self, blocks: dict[object, Array], target: Array) -> None:
        """Add the rows of one output of one experiment."""
        for key, block in blocks.items():
            if key not in self.width:
                start = self.n_unknowns
                self.width[key] = slice(start, start + block.shape[1])
        self.rows.append((blocks, target))

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns so far."""
        return max((s.stop for s in self.width.values()), default=0)

    def assemble(self) -> tuple[Array, Array]:
        """The matrix (rows, n_unknowns) and the target (rows,)."""
        n = self.n_unknowns
        if len(self.rows) == 1:
            blocks, target = self.rows[0]
            return np.hstack(list(blocks.values())), target
        parts = []
        for blocks, target in self.rows:
            part = np.zeros((target.size, n))
            for key, block in blocks.items():
                part[:, self.width[key]] = block
            parts.append(part)
        return np.vstack(parts), np.concatenate([target for _, target in self.rows])

    def pick(self, x: Array, key: object) -> Array:
        """The unknowns of one block (empty when the block does not exist)."""
        return x[self.width[key]] if key in self.width else np.zeros(0)


def nuisance_blocks(regression: Regression, experiment: int, output: int) -> dict[object, Array]:
    """Constant and drift of one output of one experiment as a block of columns."""
    block = regression.nuisance_signals(output)
    return {("nuisance", experiment, output): block} if block.shape[1] else {}


def outputs_of(regressions: Sequence[Regression]) -> int:
    """Number of outputs."""
    return len(regressions[0].targets)
