"""Standard errors where the disturbance is not what the noise model says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import (
    Estimate,
    OutputError,
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    identify,
    simulate,
)
from tridentify.estimation.answer.estimate import Status
from tridentify.estimation.likelihood import curvature
from tridentify.estimation.likelihood.scores import BLOCKS, FALSE_ALARMS, judged_scatter

pytestmark = pytest.mark.unjudged

MODEL = TransferFunction([2.0], [1.0, 2.0, 4.0])
TRUTH = np.array([2.0, 4.0, 2.0])
DT, N = 0.05, 800
# from the truth, as where the search ends is not the point here
WHITE = OutputError(MODEL)


def binary(seed):
    rng = np.random.default_rng(seed)
    return np.repeat(rng.choice([-1.0, 1.0], N // 10), 10)


def gusts(rng):
    """Coloured, and a few times as strong in some stretches as in others."""
    v = lfilter([1.0], [1.0, -1.9, 0.905], rng.standard_normal(N + 500))[500:]
    size = np.exp(4.0 * lfilter([0.05], [1.0, -0.99], rng.standard_normal(N + 500))[500:])
    return v / v.std() * size / np.sqrt(np.mean(size**2))


def record(seed, disturb, share=0.3):
    u = binary(seed)
    clean = simulate(MODEL, Record(u, u, dt=DT))[:, 0]
    v = disturb(np.random.default_rng([seed, 1]))
    return Record(u, clean + share * clean.std() * v, dt=DT)


def white(rng):
    return rng.standard_normal(N)


def drift(rng):
    walk = np.cumsum(rng.standard_normal(N))
    return (walk - walk.mean()) / walk.std()


@pytest.mark.parametrize("disturb", [gusts, drift])
@pytest.mark.slow
def test_errors_grow_with_a_slow_disturbance(disturb, monkeypatch):
    seeds = range(6)
    found = [identify(record(k, disturb), Structure(2, 0), WHITE) for k in seeds]
    monkeypatch.setattr(curvature, "scatter_of_scores", lambda *_: None)
    plain = [identify(record(k, disturb), Structure(2, 0), WHITE) for k in seeds]
    off, before = (np.array([np.abs(e.theta - TRUTH) / e.std for e in es]) for es in (found, plain))
    assert sum(e.errors == "scores" for e in found) >= 5
    assert np.mean(before > 1.96) > 0.25
    assert np.mean(off > 1.96) < 0.15
    for one, other in zip(found, plain, strict=True):
        assert np.array_equal(one.theta, other.theta)
        # nowhere below the likelihood's
        assert np.linalg.eigvalsh(one.cov - other.cov).min() > -1e-9 * np.trace(one.cov)


def test_white_noise_keeps_the_likelihood():
    found = [identify(record(k, white), Structure(2, 0), WHITE) for k in range(5)]
    assert all(e.errors == "likelihood" for e in found)
    assert not any("scatter" in told for e in found for told in e.trace.decisions)


@pytest.mark.slow
@pytest.mark.judged
def test_it_is_said_and_kept(tmp_path):
    estimate = identify(record(0, gusts), Structure(2, 0), WHITE)
    assert estimate.errors == "scores"
    said = [told for told in estimate.trace.decisions if "scatter of the scores" in told]
    assert len(said) == 1
    assert "scatter of the scores" in " ".join(estimate.summary().split())
    loaded = Estimate.load(estimate.save(tmp_path / "estimate.json"))
    assert loaded.errors == "scores"
    assert np.array_equal(loaded.cov, estimate.cov)


def test_the_default_method_has_it_too():
    method = ThreeModel(noise="white", finish="likelihood")
    estimate = identify(record(0, gusts), Structure(2, 0), method)
    assert estimate.errors == "scores"


@pytest.mark.slow
def test_a_posterior_mean_has_wider_intervals(monkeypatch):
    seen = record(2, gusts, 1.0)
    method = ThreeModel(noise="white", finish="posterior")
    estimate = identify(seen, Structure(2, 0), method)
    assert estimate.status is Status.POSTERIOR_MEAN
    assert estimate.errors == "scores"
    monkeypatch.setattr(
        "tridentify.estimation.likelihood.curvature.scatter_of_scores", lambda *_: None
    )
    plain = identify(seen, Structure(2, 0), method)
    assert plain.errors == "likelihood"
    assert np.all(estimate.std > 1.3 * plain.std)


def test_the_mixture_over_delays_has_wider_errors(monkeypatch):
    structure = Structure(2, 0, delay="free")
    seen = record(0, gusts)
    estimate = identify(seen, structure, WHITE)
    assert estimate.errors == "scores"
    monkeypatch.setattr(
        "tridentify.estimation.likelihood.curvature.scatter_of_scores", lambda *_: None
    )
    plain = identify(seen, structure, WHITE)
    assert plain.errors == "likelihood"
    assert np.all(estimate.std > 1.3 * plain.std)
    assert estimate.theta == pytest.approx(plain.theta, rel=1e-12)


def test_an_unknown_source_of_errors_is_refused():
    estimate = identify(record(0, white), Structure(2, 0), WHITE)
    with pytest.raises(ValueError, match="errors='guessed'"):
        type(estimate)(**{**vars(estimate), "errors": "guessed"})


# ------------------------------------------------------------------------------- scores alone
def drawn(rng, k, outputs=1):
    """Smooth directions, orthonormal over all samples and outputs."""
    raw = lfilter([1.0], [1.0, -0.8], rng.standard_normal((N, outputs, k)), axis=0)
    return np.linalg.qr(raw.reshape(-1, k))[0].reshape(N, outputs, k)


def left_over(g, e):
    flat, seen = g.reshape(-1, g.shape[2]), e.ravel()
    return (seen - flat @ (flat.T @ seen)).reshape(e.shape)


@pytest.mark.parametrize("k", [1, 3, 8])
@pytest.mark.fast("3")
def test_white_scores_pass_as_often_as_stated(k):
    rng = np.random.default_rng(k)
    fired = 0
    for _ in range(150):
        g, e = drawn(rng, k, 2), rng.standard_normal((N, 2))
        fired += judged_scatter([g], [left_over(g, e)]) is not None
    assert fired <= 150 * FALSE_ALARMS + 2


def test_scatter_is_that_of_blocks_that_agree_in_sign():
    """Noise that repeats over 20 samples: 20 times the variance for a slow direction."""
    rng = np.random.default_rng(0)
    g = np.repeat(np.linalg.qr(rng.standard_normal((N // 100, 1)))[0], 100)[:, None] / 10.0
    ratios = []
    for _ in range(20):
        e = np.repeat(rng.standard_normal(N // 20), 20)
        found = judged_scatter([g[:, None]], [left_over(g[:, None], e[:, None])])
        assert found is not None
        if found.over == "time":
            assert found.blocks in BLOCKS
        else:
            # a slow direction has few lines of frequency, some of which hold several blocks' share
            assert 2 <= found.blocks <= max(BLOCKS)
        ratios.append(found.ratio)
    assert 10.0 < np.median(ratios) < 30.0


def test_several_experiments_count_as_one_after_the_other():
    rng = np.random.default_rng(1)
    g = drawn(rng, 2)
    # louder in some stretches, which no band of frequency sees
    loud = np.repeat(np.where(rng.random(N // 40) < 0.2, 6.0, 0.1), 40)
    e = left_over(g, np.repeat(rng.standard_normal(N // 5), 5)[:, None] * loud[:, None])
    whole = judged_scatter([g], [e])
    parts = judged_scatter([g[:300], g[300:]], [e[:300], e[300:]])
    assert whole is not None
    assert parts is not None
    assert parts.covariance == pytest.approx(whole.covariance)


@pytest.mark.parametrize("seed", range(3))
def test_what_contradicts_the_free_response_alone_is_not_lent_to_the_coefficients(seed):
    """Wild samples at the beginning, where two directions that move no coefficient live."""
    rng = np.random.default_rng(seed)
    smooth = lfilter([1.0], [1.0, -0.8], rng.standard_normal((N, 2)), axis=0)
    fading = np.exp(-np.arange(N) / 6.0)[:, None] * np.cos(np.outer(np.arange(N), [0.3, 0.9]))
    g = np.linalg.qr(np.hstack([smooth, fading]))[0][:, None]
    wild = rng.standard_normal((N, 1))
    wild[:4] += 40.0 * rng.choice([-1.0, 1.0], (4, 1))
    e = left_over(g, wild)
    along = np.array([[1e-6, 0.0, 0.0, 0.0], [300.0, 1e3, 0.0, 0.0]])
    alike, told_apart = judged_scatter([g], [e]), judged_scatter([g], [e], along=along)
    assert alike is not None
    assert told_apart is not None
    k = slice(2)
    assert np.max(np.diag(told_apart.covariance)[k]) < 0.3 * np.min(np.diag(alike.covariance)[k])
    # what does contradict the coefficients is seen as before
    assert np.all(np.diag(told_apart.covariance)[2:] > 5.0)
    slow = left_over(g, rng.standard_normal((N, 1)) + drift(rng)[:, None] * 5.0)
    seen = judged_scatter([g], [slow], along=along)
    assert seen is not None
    assert np.all(np.diag(seen.covariance)[k] > 5.0)


def test_units_of_the_coefficients_are_of_no_account_to_their_scatter():
    rng = np.random.default_rng(4)
    g = drawn(rng, 5)
    e = left_over(g, np.repeat(rng.standard_normal(N // 20), 20)[:, None])
    along = rng.standard_normal((3, 5))
    one = judged_scatter([g], [e], along=along)
    other = judged_scatter([g], [e], along=along * np.array([[1e-30], [1.0], [1e30]]))
    assert one is not None
    assert other is not None
    assert other.covariance == pytest.approx(one.covariance, rel=1e-9)
    # and so are the coordinates of the directions
    turn = np.linalg.qr(rng.standard_normal((5, 5)))[0]
    turned = judged_scatter([g @ turn], [e], along=along @ turn)
    assert turned is not None
    assert turned.covariance == pytest.approx(turn.T @ one.covariance @ turn, rel=1e-9)


def test_a_misfit_that_repeats_is_seen_over_bands_of_frequency():
    """The same in every stretch, too large below some frequency and too small above it."""
    rng = np.random.default_rng(3)
    period = np.fft.rfft(rng.standard_normal(25))
    wrong = period * np.where(np.arange(13) < 6, 1.0, -1.0)
    one, misfit = (np.fft.irfft(x, 25) for x in (period, wrong))
    g = np.tile(one, N // 25)[:, None, None]
    g /= np.linalg.norm(g)
    e = left_over(g, (0.3 * np.tile(misfit, N // 25) + rng.standard_normal(N))[:, None])
    found = judged_scatter([g], [e])
    assert found is not None
    assert found.over == "frequency"
    assert "bands of frequency" in found.in_words()


def with_unmodelled_mode(seed):
    """A multisine on a plant that has one resonance more than the structure."""
    rng = np.random.default_rng(seed)
    t = np.arange(N) * DT
    lines = np.arange(1, 31)
    phase = rng.uniform(0, 2 * np.pi, lines.size)
    size = rng.uniform(0.2, 1.0, lines.size)
    u = np.cos(2 * np.pi * np.outer(t, lines) / 20.0 + phase) @ size
    far = TransferFunction([1.0], [1.0, 0.6, 36.0])
    asked = Record(u, u, dt=DT, intersample="foh")
    y = simulate(MODEL, asked)[:, 0] + simulate(far, asked)[:, 0]
    return Record(u, y + 0.02 * y.std() * rng.standard_normal(N), dt=DT, intersample="foh")


def test_errors_allow_for_a_mode_that_is_not_modelled(monkeypatch):
    """The missing mode pulls the coefficients; stretches of the record are all pulled alike."""
    truth = np.array([2.0, 4.0, 0.0, 2.0])

    def off():
        found = WHITE.estimate([with_unmodelled_mode(1)], Structure(2, 1))
        return float(np.max(np.abs(found.theta - truth) / found.std))

    allowed = off()
    monkeypatch.setattr(curvature, "scatter_of_scores", lambda *_: None)
    assert allowed < 3.0
    assert off() > 5.0


def test_too_few_samples_say_nothing():
    rng = np.random.default_rng(2)
    g = np.linalg.qr(rng.standard_normal((40, 2)))[0][:, None]
    assert judged_scatter([g], [10.0 * rng.standard_normal((40, 1))]) is None
