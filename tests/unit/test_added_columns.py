"""What machine code says of added columns and of blocks of scores, against dense computations."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify.estimation.likelihood import scores
from tridentify.estimation.likelihood.compiled.scatter import scatter_at
from tridentify.numerics.lagrange import added, added_each, span


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.mark.parametrize("p", [0, 3])
@pytest.mark.parametrize("near", [None, 0.0, 1e-9, 1e-5])
def test_each_group_is_tested_as_if_it_were_alone(rng, p, near):
    """Groups with zeros, with what was fitted and with (nearly) dependent columns among them."""
    n = 60
    basis = np.linalg.qr(rng.standard_normal((n, 3)))[0][:, :p]
    groups = [rng.standard_normal((n, k)) * 10.0 ** rng.integers(-8, 8) for k in (1, 4, 7)]
    groups[1][:, 0] = 0.0
    groups += [np.zeros((n, 2)), np.zeros((n, 0)), basis.copy()]
    if near is not None:
        groups[2][:, 6] = groups[2][:, :6] @ np.ones(6) + near * groups[2][:, 6]
    e = rng.standard_normal(n)
    for test, group in zip(added_each(e, basis, groups, n), groups, strict=True):
        alone = added(e, basis, span(group, basis), n)
        assert (test.dimension, test.freedom) == (alone.dimension, alone.freedom)
        assert np.allclose(test, alone, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("kind", ["even", "gaps", "ends", "heavy first", "heavy last"])
@pytest.mark.parametrize("outputs", [1, 2])
def test_blocks_scatter_as_sums_over_their_edges_say(rng, kind, outputs):
    n, k = 500, 3
    g = rng.standard_normal((n, outputs, k))
    if kind == "gaps":
        g[rng.integers(0, n, n // 2)] = 0.0
    if kind == "ends":
        g[:50] = g[-50:] = 0.0
    if kind.startswith("heavy"):
        g[0 if kind.endswith("first") else -1] *= 60.0
    g = np.linalg.qr(g.reshape(-1, k))[0].reshape(n, outputs, k)
    e = rng.standard_normal((n, outputs))
    weight = np.einsum("toi,toi->t", g, g)
    share = (np.cumsum(weight) - 0.5 * weight) / weight.sum()
    each = np.einsum("toi,to->ti", g, e)
    found = scatter_at(g, e, np.array(scores.BLOCKS, dtype=np.int64))
    for row, count in zip(found, scores.BLOCKS, strict=True):
        edges = scores._edges(share, count)
        _, sums, held = scores._Blocks.of(g, each, edges)
        square = float(np.sum(held**2))
        wanted = [np.sum(sums**2), np.einsum("bii->", held) - square, 2.0 * square, edges.size]
        assert np.allclose(row, wanted, rtol=1e-9, atol=1e-12)
