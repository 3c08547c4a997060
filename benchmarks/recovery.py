"""Noise-free recovery: largest relative error of a coefficient. Aim: 1e-8.

Truth and data come by a route that shares nothing with the package: the modal form. With distinct
poles, ``y = sum_i r_i x_i`` and ``x_i' = p_i x_i + u``, whose held (ZOH) and ramp (FOH) equivalents
are scalars; all of it in extended precision and rounded once, at the end. `identify` gets the
default structure: offset and initial state are its own decision.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from machine import keep
from numpy.typing import NDArray

from tridentify import Record, Structure, identify

Array = NDArray[np.float64]
Long = NDArray[np.clongdouble]
AIM = 1e-8


class Case(NamedTuple):
    """A family of systems: poles for each order [rad/s], sampling, and the lowest order."""

    poles: Callable[[int], list[complex]]
    dt: float
    n_samples: int
    hold: int
    lowest: int


def damped(order: int) -> list[complex]:
    """Pairs of damping 0.7, and a real pole for odd orders; 1 to 5 rad/s."""
    pairs = [w * complex(-0.7, np.sqrt(1 - 0.49)) for w in (1.5, 3.0, 5.0)[: order // 2]]
    return _conjugates(pairs) + [-1.0 + 0j] * (order % 2)


def stiff(order: int) -> list[complex]:
    """Real poles, the fastest 1e4 times the slowest."""
    return [-complex(p) for p in np.geomspace(0.01, 100.0, order)]


def resonant(order: int) -> list[complex]:
    """Pairs of damping 0.01, and a real pole for odd orders."""
    pairs = [w * complex(-0.01, np.sqrt(1 - 1e-4)) for w in (2.0, 5.0, 11.0)[: order // 2]]
    return _conjugates(pairs) + [-1.0 + 0j] * (order % 2)


def _conjugates(pairs: list[complex]) -> list[complex]:
    return [z for pole in pairs for z in (pole, pole.conjugate())]


CASES = {
    "damped": Case(damped, 0.05, 2000, 6, 1),
    "stiff": Case(stiff, 0.02, 5000, 10, 2),
    "resonant": Case(resonant, 0.05, 3000, 4, 2),
}


def polynomial(roots: Long) -> Long:
    """Coefficients, descending powers."""
    found = np.ones(1, dtype=np.clongdouble)
    for root in roots:
        found = np.append(found, 0) - root * np.append(0, found)
    return found


def truth(case: Case, order: int, zeros: int) -> tuple[Long, Long, Array]:
    """Poles, residues and coefficients ``a_{n-1} .. a_0, b_m .. b_0`` (gain 2 at rest)."""
    poles = np.array(case.poles(order), dtype=np.clongdouble)
    sizes = np.sort(np.abs(poles))
    between = np.sqrt(sizes[1:] * sizes[:-1])[:zeros] * np.longdouble(1.1)
    a, b = polynomial(poles), polynomial(-between.astype(np.clongdouble))
    b = b * (2 * a[-1] / b[-1])
    residues = np.array(
        [
            np.polyval(b, p) / np.prod(p - np.delete(poles, i))
            for i, p in enumerate(poles)
        ]
    )  # fmt: skip
    return poles, residues, np.concatenate([a[1:].real, b.real]).astype(np.float64)


def modal(poles: Long, residues: Long, u: Array, dt: float, intersample: str) -> Array:
    """Output from rest, mode by mode."""
    h = np.longdouble(dt)
    z = poles * h
    decay = np.exp(z)
    whole = _phi(z, 1) * h
    ramp = _phi(z, 2) * h if intersample == "foh" else np.zeros_like(z)
    state = np.zeros_like(poles)
    y = np.zeros(u.size, dtype=np.longdouble)
    for k in range(u.size - 1):
        state = decay * state + (whole - ramp) * u[k] + ramp * u[k + 1]
        y[k + 1] = (residues @ state).real
    return y.astype(np.float64)


def _phi(z: Long, order: int) -> Long:
    """``sum_k z^k / (k + order)!``; the series where the closed form would cancel."""
    term = np.ones_like(z) / (1 if order == 1 else 2)
    series = term.copy()
    for k in range(1, 40):
        term = term * z / (k + order)
        series += term
    closed = (np.exp(z) - 1) / z if order == 1 else (np.exp(z) - 1 - z) / z**2
    return np.where(np.abs(z) < 1, series, closed)


def recover(case: Case, order: int, zeros: int, intersample: str) -> dict[str, object]:
    """Worst relative error, time and verdict of one identification."""
    poles, residues, theta = truth(case, order, zeros)
    rng = np.random.default_rng(order)
    values = rng.choice([-1.0, 1.0], size=case.n_samples // case.hold + 1)
    u = np.repeat(values * rng.uniform(0.5, 1.5, values.size), case.hold)[: case.n_samples]
    u[0] = 0.0
    y = modal(poles, residues, u, case.dt, intersample)
    record = Record(u, y, dt=case.dt, intersample=intersample)
    before = time.perf_counter()
    try:
        estimate = identify(record, Structure(order, zeros), throw=False)
    except Exception as error:
        return {"error": None, "seconds": None, "status": type(error).__name__}
    seconds = time.perf_counter() - before
    worst = float(np.max(np.abs(estimate.theta / theta - 1.0)))
    chosen = f"{estimate.structure.initial_state}, offset {estimate.structure.offset}"
    expected = float(np.max(np.abs(estimate.std / estimate.theta)))
    return {
        "error": worst,
        "expected": expected,
        "seconds": seconds,
        "status": estimate.status.name,
        "chosen": chosen,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--save", action="store_true", help="store the result and fill README.md")
    options = parser.parse_args()
    results: dict[str, dict[str, object]] = {}
    lines, worst, bad = [], 0.0, []
    head = "".join(f"{name + ' ' + hold:>14s}" for name in CASES for hold in ("zoh", "foh"))
    for title in ("zeros = poles - 1", "no zeros"):
        lines += [f"{title:20s}" + head] if not lines else ["", f"{title:20s}" + head]
        for order in range(1, 7):
            zeros = order - 1 if title.startswith("zeros") else 0
            row = f"{order} pole{'s' if order > 1 else ' '}".ljust(20)
            for name, case in CASES.items():
                for intersample in ("zoh", "foh"):
                    if order < case.lowest:
                        row += f"{'-':>14s}"
                        continue
                    found = recover(case, order, zeros, intersample)
                    results[f"{name} {intersample} {order},{zeros}"] = found
                    error = found["error"]
                    if isinstance(error, float) and error == error:
                        worst = max(worst, error)
                        row += f"{error:14.1e}"
                    else:
                        row += f"{found['status']:>14.13s}"
                    if not (isinstance(error, float) and error <= AIM):
                        told = f"{found.get('expected', np.nan):.0e}, {found['status']}"
                        bad.append(f"  {name} {intersample} {order},{zeros}: {told}")
            lines.append(row)
            print(row, flush=True)
    lines += ["", f"largest {worst:.1e}; aim {AIM:.0e}: {'missed' if bad else 'met'}"]
    if bad:
        lines += ["missed by (poles,zeros: relative standard error that it reports, status)", *bad]
    report = "\n".join(lines)
    print("\n" + report)
    if options.save:
        keep("recovery", report, results)


if __name__ == "__main__":
    main()
