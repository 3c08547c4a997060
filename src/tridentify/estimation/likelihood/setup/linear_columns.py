"""Columns of what is linear at fixed denominators, block by block."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.models.regression import Regression
from tridentify.models.response import Branch, nuisance_blocks
from tridentify.numerics.arrays import Array


def linear_blocks(
    problem: Problem,
    branches: Sequence[Branch],
    regression: Regression,
    experiment: int,
    output: int,
) -> dict[object, Array]:
    """Columns of ``b``, the free response, offset and drift at fixed denominators."""
    q = regression.layout.order
    blocks: dict[object, Array] = {}
    for j, m in enumerate(problem.n_zeros[output]):
        branch = next(one for one in branches if one.channels[output, j])
        n = branch.inner.order
        rows = np.zeros((q, min(m + 1, n)))
        rows[branch.own] = branch.basis.rows[: min(m + 1, n)].T
        block = regression.input_signal(output, j, rows)
        if m == n:
            direct = regression.signals[output][:, regression.layout.direct(j)]
            block = np.column_stack([block, direct])
        blocks["b", j] = block
    if regression.layout.free:
        blocks["free", experiment] = regression.signals[output][:, free_states(branches, output)]
    return blocks | nuisance_blocks(regression, experiment, output)


def free_states(branches: Sequence[Branch], output: int) -> NDArray[np.intp]:
    """States of the bank that span the free response of one output."""
    used = [one.own for one in branches if one.channels[output].any()]
    return np.concatenate([np.arange(own.start, own.stop) for own in used])
