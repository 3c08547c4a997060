"""Records and hand-made estimates for the tests of what comes after an estimation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import expm

from tridentify.estimation.answer.estimate import (
    Estimate,
    Nuisance,
    Pass,
    Start,
    Status,
    Step,
    Trace,
)
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

DT = 0.02
N = 600


def exact_response(num, den, u, dt, free=None):
    """Zero-order-hold response of num/den to ``u`` plus free(p)/den(p) delta, state by state."""
    n = len(den) - 1
    num = np.pad(np.asarray(num, float), (n + 1 - len(num), 0))
    companion = np.zeros((n, n))
    companion[0] = -np.asarray(den[1:])
    companion[1:, :-1] += np.eye(n - 1)
    column = np.eye(n)[:, :1]
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n:] = companion, column
    transition = expm(block * dt)
    row, direct = num[1:] - num[0] * np.asarray(den[1:]), num[0]
    state, loose = np.zeros(n), column[:, 0]
    y = np.empty(len(u))
    for k, value in enumerate(u):
        y[k] = row @ state + direct * value
        if free is not None:
            y[k] += np.asarray(free) @ loose
            loose = transition[:n, :n] @ loose
        state = transition[:n, :n] @ state + transition[:n, n] * value
    return y


def doublet(t):
    """3-2-1-1 manoeuvre, held between samples."""
    edges, signs = (1.0, 2.5, 3.5, 4.0, 4.5), (1.0, -1.0, 1.0, -1.0)
    u = np.zeros_like(t)
    for start, stop, sign in zip(edges[:-1], edges[1:], signs, strict=True):
        u[(t >= start) & (t < stop)] = 0.05 * sign
    return u


@dataclass(frozen=True)
class Case:
    """An estimate with the record it stands for, and the truth."""

    estimate: Estimate
    record: Record
    truth: np.ndarray
    clean: np.ndarray


def _trace(theta, names, n_channels):
    rng = np.random.default_rng(5)
    passes = []
    for k in range(1, 5):
        now = theta * (1 + 0.3 * 10.0**-k * rng.standard_normal(theta.size))
        steps = (
            Step(
                "parallel",
                np.tile([0.4, 0.2, -0.1], n_channels),
                2e-5,
                12.0,
                "8 Laguerre functions",
            ),
            Step("series-parallel", now, 2.2e-5, 85.0),
            Step("series", np.array([1.0 + 10.0**-k, 10.0**-k]), 1.9e-5, 31.0),
        )
        cost = 1.8e-5 * (1 + 10.0 ** (-2 * k))
        passes.append(Pass(k, steps, now, cost, 10.0**-k, 10.0 ** (-2 * k)))
    last = Step("output error", theta, 1.8e-5, 44.0)
    passes.append(Pass(5, (last,), theta, 1.8e-5, math.nan, 3e-11, "finish"))
    starts = (
        Start("Laguerre functions", theta * 1.01, 1.81e-5),
        Start("filtered record", theta * 0.8, 5.4e-5),
    )
    decisions = ("offset: estimated (AICc lower by 312.4)", "initial state: at rest (AICc +3.1)")
    return Trace(tuple(passes), starts, decisions, "relative gradient 3e-11 below 1e-8")


def _estimate(model, structure, theta, names, cov, noise, nuisance, **channels):
    return Estimate(
        model=model,
        structure=structure,
        theta=theta,
        names=names,
        cov=cov,
        noise_variance=noise**2,
        fit=np.full(len(channels["output_names"]), 93.21),
        status=Status.CONVERGED,
        trace=_trace(theta, names, len(channels["output_names"]) * len(channels["input_names"])),
        method="ThreeModel",
        n_samples=N,
        nuisance=(nuisance,),
        degrees_of_freedom=N - theta.size,
        cost=1.8e-5,
        aicc=-6543.2,
        condition=44.0,
        gradient=3e-11,
        intersample="zoh",
        dt=DT,
        record_fingerprint="0f" * 32,
        **channels,
    )


def _covariance(response, theta, noise):
    """Inverse information of white noise of standard deviation ``noise`` on each output."""
    columns = []
    for k in range(theta.size):
        step = np.zeros(theta.size)
        step[k] = 1e-5 * abs(theta[k])
        columns.append(((response(theta + step) - response(theta - step)) / noise).ravel())
    scores = np.array(columns).T / (2e-5 * np.abs(theta))
    return np.linalg.inv(scores.T @ scores)


@pytest.fixture(scope="session")
def single() -> Case:
    """``q / elevator = 0.5 / (s^2 + s + 3)`` with white noise, at rest, no nuisance terms."""
    t = np.arange(N) * DT
    u = doublet(t)
    truth, noise = np.array([1.0, 3.0, 0.5]), np.array([3e-4])

    def response(theta):
        return exact_response([theta[2]], [1.0, *theta[:2]], u, DT)[:, None]

    cov = _covariance(response, truth, noise)
    rng = np.random.default_rng(1)
    theta = truth + np.linalg.cholesky(cov) @ rng.standard_normal(3)
    channels = {"input_names": ("elevator",), "output_names": ("q",)}
    units = {"elevator": "rad", "q": "rad/s"}
    clean = response(truth)
    y = clean + noise * rng.standard_normal(clean.shape)
    record = Record(u, y, dt=DT, units=units, name="doublet", **channels)
    model = TransferFunction([theta[2]], [1.0, *theta[:2]], **channels)
    zero = np.zeros(1)
    nuisance = Nuisance(zero, zero, zero, np.zeros((1, 2)), zero, zero, "rest", 0.0)
    names = ("a1", "a0", "b0")
    structure = Structure(2, 0, offset=False, drift=False, initial_state="rest")
    estimate = _estimate(
        model, structure, theta, names, cov, noise, nuisance, units=units, **channels
    )
    return Case(estimate, record, truth, clean)


@pytest.fixture(scope="session")
def double() -> Case:
    """Short period, one input and two outputs; offset, drift, trim and a free initial state."""
    t = 10.0 + np.arange(N) * DT
    trim, offset, drift = 0.02, np.array([0.01, 0.05]), np.array([1e-3, -5e-4])
    free = np.array([[0.02, 0.05], [0.03, -0.04]])
    u = trim + doublet(t - 10.0)
    truth = np.array([2.1, 5.5, -6.2, -5.1, -0.08, -6.0])
    noise = np.array([2e-3, 1e-3])

    def response(theta):
        den = [1.0, *theta[:2]]
        nums = (theta[2:4], theta[4:6])
        rows = [exact_response(nums[i], den, u - trim, DT, free[i]) for i in range(2)]
        return np.array(rows).T + offset + np.outer(t - 10.0, drift)

    cov = _covariance(response, truth, noise)
    rng = np.random.default_rng(2)
    theta = truth + np.linalg.cholesky(cov) @ rng.standard_normal(6)
    clean = response(truth)
    y = clean + noise * rng.standard_normal(clean.shape)
    channels = {"input_names": ("elevator",), "output_names": ("q", "alpha")}
    units = {"elevator": "rad", "q": "rad/s", "alpha": "rad"}
    record = Record(u, y, t=t, units=units, name="short period", **channels)
    den = [1.0, *theta[:2]]
    model = TransferFunction([[theta[2:4]], [theta[4:6]]], [[den], [den]], **channels)
    names = ("a1", "a0", "b1[q,elevator]", "b0[q,elevator]")
    names += ("b1[alpha,elevator]", "b0[alpha,elevator]")
    nuisance = Nuisance(
        np.array([trim]), offset, drift, free, 0.1 * offset, 0.1 * np.abs(drift), "free", 10.0
    )
    structure = Structure(2, 1, offset=True, drift=True, initial_state="free")
    estimate = _estimate(
        model, structure, theta, names, cov, noise, nuisance, units=units, **channels
    )
    return Case(estimate, record, truth, clean)


def _responses(a, b, t, u, delay=0.0, intersample="zoh"):
    """(n, q) states at ``t - delay`` and the delayed input, one ``expm`` from the last knot."""
    q = b.size

    def cross(x, length, value, slope):
        whole = np.zeros((q + 2, q + 2))
        whole[:q, :q], whole[:q, q], whole[q, q + 1] = a * length, b * length, length
        return expm(whole)[:q] @ np.concatenate([x, [value, slope]])

    slopes = np.append(np.diff(u) / np.diff(t), 0.0) * (intersample == "foh")
    at_knots = [np.zeros(q)]
    for k in range(t.size - 1):
        at_knots.append(cross(at_knots[-1], t[k + 1] - t[k], u[k], slopes[k]))
    states, late = np.zeros((t.size, q)), np.zeros(t.size)
    slack = 1e-9 * np.median(np.diff(t))
    for k, now in enumerate(t - delay):
        m = np.searchsorted(t, now + slack, side="right") - 1
        if m >= 0:
            since = max(now - t[m], 0.0)
            states[k] = cross(at_knots[m], since, u[m], slopes[m])
            late[k] = u[m] + slopes[m] * since
    return states, late


@pytest.fixture(scope="session")
def responses():
    """Dense propagation on any instants, late by a delay: one ``expm`` from the last knot."""
    return _responses
