"""The population of a fleet: its mean and spread, its members in its light, and who deviates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import fleets
from tridentify import Record, Structure, fleet
from tridentify.errors import TooFewSamplesError
from tridentify.fleet.local import Piece, local_pieces
from tridentify.fleet.pool import pooled
from tridentify.numerics.least_squares import triangle

pytestmark = pytest.mark.unjudged

REST = Structure(2, 0, offset=False, initial_state="rest")
NAMES = ("a1", "a0", "b0")
FIVE_DB = 10.0 ** (-5.0 / 20.0)
SPREAD = 0.05
DEVIATES = 1.5


def gaussian(
    random: np.random.Generator, count: int, spread: np.ndarray
) -> tuple[Mapping[str, np.ndarray], Mapping[str, tuple[np.ndarray, np.ndarray]]]:
    """Truth by key, and linear records of the logarithms, of very different length."""
    truth, said = {}, {}
    root = np.linalg.cholesky(spread)
    for k in range(count):
        phi = np.array([0.5, -0.2]) + root @ random.standard_normal(2)
        n = int(random.integers(12, 60))
        design = random.standard_normal((n, 2))
        truth[str(k)] = np.array([1.0, -1.0]) * np.exp(phi)
        said[str(k)] = design, design @ phi + 0.5 * random.standard_normal(n)
    return truth, said


def linear(said: Mapping[str, tuple[np.ndarray, np.ndarray]]):
    """A pass over such units."""

    def look(at: Mapping[str, Sequence[float]]) -> dict[str, Piece]:
        found = {}
        for key, theta in at.items():
            design, y = said[key]
            phi = np.log(np.abs(theta))
            rows = np.column_stack([design / np.asarray(theta), y - design @ phi])
            count = np.array([float(len(y))])
            found[key] = Piece(triangle(rows)[None], count, 0 * count, 2 + 0 * count, count)
        return found

    return look


@pytest.mark.slow
def test_a_population_that_is_known_exactly() -> None:
    spread = np.array([[0.09, 0.03], [0.03, 0.04]])
    truth, said = gaussian(np.random.default_rng(0), 800, spread)
    own = {
        key: (np.array([1.0, -1.0]) * np.exp(np.linalg.lstsq(a, y, rcond=None)[0])).tolist()
        for key, (a, y) in said.items()
    }
    own["799"] = []
    pool = pooled(linear(said), ("a", "b"), own)
    assert pool.logarithmic.all()
    np.testing.assert_allclose(pool.mean, [np.exp(0.5), -np.exp(-0.2)], rtol=0.03)
    np.testing.assert_allclose(pool.covariance, spread, rtol=0.15, atol=0.005)
    true = np.array([truth[key] for key in pool.keys])
    inside = (pool.low <= true) & (true <= pool.high)
    assert 0.93 < inside.mean() < 0.97
    assert np.mean(pool.deviating) < 0.005
    # what one could do who knows mean, spread and noise
    prior, known = np.linalg.inv(spread), []
    for key in pool.keys:
        design, y = said[key]
        precision = design.T @ design / 0.25 + prior
        known.append(np.linalg.solve(precision, design.T @ y / 0.25 + prior @ [0.5, -0.2]))
    best = np.mean((np.array(known) - np.log(np.abs(true))) ** 2)
    assert np.mean(np.log(pool.shrunk / true) ** 2) < 1.05 * best
    assert np.isnan(pool.own[pool.keys.index("799")]).all()
    assert np.isfinite(pool.shrunk).all()


@pytest.mark.slow
def test_units_that_deviate_are_found_and_left_alone() -> None:
    _, said = gaussian(np.random.default_rng(1), 150, np.diag([0.01, 0.01]))
    for k in range(6):
        design, y = said[str(k)]
        said[str(k)] = design, y + design @ np.array([1.5, -1.0])
    own = {
        key: (np.array([1.0, -1.0]) * np.exp(np.linalg.lstsq(a, y, rcond=None)[0])).tolist()
        for key, (a, y) in said.items()
    }
    pool = pooled(linear(said), ("a", "b"), own)
    assert set(pool.outliers[:6]) == {str(k) for k in range(6)}
    assert len(pool.outliers) <= 8
    for k in range(6):
        at = pool.keys.index(str(k))
        np.testing.assert_allclose(pool.shrunk[at], own[str(k)])
    np.testing.assert_allclose(pool.spread, 0.1, rtol=0.25)
    assert "6 of 150 units deviate" in pool.summary() or len(pool.outliers) > 6


def test_too_few_units_are_refused() -> None:
    _, said = gaussian(np.random.default_rng(2), 19, np.eye(2))
    own = {key: [1.0, -1.0] for key in said}
    with pytest.raises(TooFewSamplesError, match="found 19 units"):
        pooled(linear(said), ("a", "b"), own)


def test_a_fleet_too_small_for_a_population_keeps_its_rows_and_says_why(tmp_path: Path) -> None:
    random = np.random.default_rng(3)
    units = {str(k): fleets.unit(random, fleets.TRUTH, n=80, noise=0.2) for k in range(3)}
    found = fleet.fit(units, REST, out=tmp_path, together=True, pool=True, judge=False)
    assert found.common is not None
    assert found.population is None
    assert found.rows().height == 3
    assert "found 3 units" in found.notes[-1]
    with pytest.raises(TooFewSamplesError, match="found 3 units"):
        found.pool()


@pytest.mark.slow
def test_a_fleet_is_pooled_and_the_members_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    truth = fleets.TRUTH * np.exp(SPREAD * rng.standard_normal((40, 3)))
    truth[7, 1] *= 1.6
    records: dict[str, object] = {
        f"u{k:02d}": fleets.unit(rng, theta, n=80, noise=0.2) for k, theta in enumerate(truth)
    }
    records["absent"] = "no/such.csv"
    run = fleet.fit(records, (2, 0), out=tmp_path, judge=False, progress=False, pool=True)
    pool = run.population
    assert pool is not None
    assert pool.outliers[0] == "u07"
    assert "absent" not in pool.keys
    np.testing.assert_allclose(pool.mean, fleets.TRUTH, rtol=0.05)
    frame = pl.read_parquet(tmp_path / "pool.parquet")
    assert frame["key"].to_list() == list(pool.keys)
    assert frame.columns[1:5] == ["a1", "a1_low", "a1_high", "a1_own"]
    np.testing.assert_array_equal(frame["a0"].to_numpy(), pool.shrunk[:, 1])
    assert "of 40 units deviate: u07" in run.summary()


# ------------------------------------------------------------------------- as the issue has it
@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_thousand_short_noisy_records(seed: int, tmp_path: Path) -> None:
    """100 samples at 5 dB, 5 % spread, 2 % of the units with half as much stiffness again."""
    rng = np.random.default_rng(seed)
    truth = fleets.TRUTH * np.exp(SPREAD * rng.standard_normal((1000, 3)))
    truth[:20, 1] *= DEVIATES
    records: dict[str, Record] = {
        f"u{k:04d}": fleets.unit(rng, theta, n=100, noise=FIVE_DB) for k, theta in enumerate(truth)
    }
    run = fleet.fit(records, REST, out=tmp_path, workers=2, judge=False, progress=False, pool=True)
    pool = run.population
    assert pool is not None
    true = np.array([truth[int(key[1:])] for key in pool.keys])
    good = np.array([int(key[1:]) >= 20 for key in pool.keys])
    single = np.sqrt(np.nanmean((pool.own[good] / true[good] - 1.0) ** 2))
    shrunk = np.sqrt(np.mean((pool.shrunk[good] / true[good] - 1.0) ** 2))
    assert shrunk < 0.5 * single
    inside = (pool.low[good] <= true[good]) & (true[good] <= pool.high[good])
    assert 0.93 <= inside.mean() <= 0.97
    assert pool.deviating[~good].mean() > 0.9
    assert pool.deviating[good].mean() <= 0.005


def test_pieces_do_not_depend_on_where_a_record_came_from() -> None:
    record = fleets.units(1)["u0000"]
    again = Record(record.u, record.y, t=record.t, intersample="zoh")
    one, other = (
        next(iter(local_pieces([r], REST, fleets.TRUTH).values())) for r in (record, again)
    )
    np.testing.assert_allclose(one.rss, other.rss, rtol=1e-9)
