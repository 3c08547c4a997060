"""What the peers' scripts share: records in, continuous-time coefficients out, one JSON line each.

A peer's ``fit.py`` runs in an environment of its own and imports this file and its package,
nothing else of the repository. It calls `serve` with its ways of estimating; `serve` answers on the
standard output as soon as a record is done, so that a time limit loses only what was not finished.
Whatever the package prints goes to the standard error.

Times are those of the processor, user and system, so that what else runs on the machine hardly
matters: ``seconds`` for one record, from its arrays to the coefficients, and ``at`` since the
process began, imports included.

Conversion of a discrete-time model that holds its input: with ``x_{k+1} = A x_k + B u_k``,

    expm([[F, G], [0, 0]] dt) = [[A, B], [0, I]],

so that ``F`` and ``G`` are the matrix logarithm over ``dt``. It is real only where no eigenvalue
of ``A`` is zero or negative; a model that has one has no continuous-time counterpart of the same
order, which counts as a failure (`NoContinuousModel`).
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import os
import resource
import sys
import time
import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np


class NoContinuousModel(ArithmeticError):
    """A discrete-time model without a real continuous-time counterpart."""


class WrongOrder(ArithmeticError):
    """A model of another order than was asked for."""


@dataclass(frozen=True, eq=False)
class Task:
    """One record and what the user of every package knows about the system.

    The input is held between the samples (zero-order hold); ``u`` and ``y`` have one axis.
    """

    u: np.ndarray
    y: np.ndarray
    dt: float
    poles: int
    zeros: int


def read(path: Path, poles: int, zeros: int) -> Task:
    """A record file: header ``t,u,y``, evenly sampled."""
    t, u, y = np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)
    return Task(u, y, float((t[-1] - t[0]) / (t.size - 1)), poles, zeros)


def continuous(a: Any, b: Any, c: Any, d: Any, task: Task) -> np.ndarray:
    """Coefficients of a discrete-time state-space model that holds its input.

    Returns
    -------
    (poles + zeros + 1,) array
        As `coefficients`.
    """
    from scipy.linalg import logm

    a, b, c = np.atleast_2d(a), np.asarray(b).reshape(-1, 1), np.asarray(c).reshape(1, -1)
    n = a.shape[0]
    if n != task.poles:
        raise WrongOrder(f"{n} states")
    eigenvalues = np.linalg.eigvals(a)
    if not np.all(np.isfinite(eigenvalues)):
        raise NoContinuousModel("pole not finite")
    real = np.abs(eigenvalues.imag) <= 1e-12 * np.abs(eigenvalues)
    if np.any(real & (eigenvalues.real <= 0.0)):
        raise NoContinuousModel("discrete-time pole on the negative real axis")
    both = np.vstack([np.hstack([a, b]), np.eye(n + 1)[-1:]])
    logarithm = logm(both)
    if np.max(np.abs(np.imag(logarithm))) > 1e-6 * np.max(np.abs(logarithm)):
        raise NoContinuousModel("complex logarithm")
    rates = np.real(logarithm)[:n] / task.dt
    return coefficients(rates[:, :n], rates[:, n:], c, float(np.ravel(d)[0]), task)


def coefficients(f: Any, g: Any, c: Any, d: float, task: Task) -> np.ndarray:
    """``a_{n-1} .. a_0, b_m .. b_0`` of ``c (s I - f)^{-1} g + d``.

    The numerator of such a model has as many coefficients as it has states, one more with ``d``.
    Those above ``b_m``, zero in truth, are left out of the comparison.
    """
    f, g, c = np.asarray(f), np.asarray(g).reshape(-1, 1), np.asarray(c).reshape(1, -1)
    den = np.real(np.poly(f))
    num = np.real(np.poly(f - g @ c)) + (d - 1.0) * den
    return np.concatenate([den[1:], num[den.size - 1 - task.zeros :]])


def rest_before(task: Task, count: int = 40) -> Task:
    """The same record with ``count`` samples of rest put before it.

    For methods that fix the first outputs at what was measured, or that need a change of the input:
    a user who knows that the system was at rest before the record may say so in this way.
    """
    nothing = np.zeros(count)
    return replace(task, u=np.append(nothing, task.u), y=np.append(nothing, task.y))


def misfit(theta: np.ndarray, task: Task) -> float:
    """Residual mean square of a model that starts at rest; inf where it diverges."""
    from scipy.linalg import expm
    from scipy.signal import lfilter, ss2tf

    n = task.poles
    companion, b = np.eye(n, k=1), np.zeros((n, 1))
    companion[-1], b[-1] = -theta[n - 1 :: -1], 1.0
    c = np.zeros(n)
    c[: task.zeros + 1] = theta[: n - 1 : -1]
    both = np.zeros((n + 1, n + 1))
    both[:n] = np.hstack([companion, b]) * task.dt
    both = expm(both)
    num, den = ss2tf(both[:n, :n], both[:n, n:], c[None, :], np.zeros((1, 1)))
    with np.errstate(all="ignore"):
        cost = float(np.mean((lfilter(num[0], den, task.u) - task.y) ** 2))
    return cost if np.isfinite(cost) else np.inf


def best_fit(candidates: Iterable[Callable[[], np.ndarray]], task: Task) -> np.ndarray:
    """The candidate whose simulated output is nearest to the record: what a careful user keeps.

    Raises
    ------
    Exception
        That of the last candidate, if none gives a model.
    """
    best: tuple[float, np.ndarray] | None = None
    problem: Exception = WrongOrder("no candidate fits the record")
    for candidate in candidates:
        try:
            theta = np.asarray(candidate(), dtype=float)
        except Exception as error:  # a horizon too long, a negative pole: the next may do
            problem = error
            continue
        cost = misfit(theta, task)
        if best is None or cost < best[0]:
            best = cost, theta
    if best is None:
        raise problem
    return best[1]


def from_forward_shift(num: Any, den: Any, task: Task) -> np.ndarray:
    """Coefficients of ``num(q) / den(q)``, powers of the forward shift, descending."""
    from scipy.signal import tf2ss

    num, den = np.trim_zeros(np.ravel(num), "f"), np.trim_zeros(np.ravel(den), "f")
    cut = min(_trailing_zeros(num), _trailing_zeros(den))
    a, b, c, d = tf2ss(num[: num.size - cut], den[: den.size - cut])
    return continuous(a, b, c, d, task)


def _trailing_zeros(values: np.ndarray) -> int:
    return int(values.size - np.trim_zeros(values, "b").size)


def peak() -> float:
    """Largest resident memory of this process so far [MB].

    The kernel's own count of this program; `getrusage` also holds what the parent had when it
    started the process.
    """
    try:
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) * 1024.0 / 1e6
    except OSError:
        pass
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def serve(ways: dict[str, Callable[[Task], Any]], packages: tuple[str, ...]) -> None:
    """Answer for all record files of the command line.

    Parameters
    ----------
    ways : dict
        Name of a way to estimate -> function of a `Task` that returns the coefficients.
    packages : tuple of str
        Whose versions belong to the answer.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("way", choices=ways)
    parser.add_argument("poles", type=int)
    parser.add_argument("zeros", type=int)
    parser.add_argument("files", type=Path, nargs="+")
    options = parser.parse_args()
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # so that a package that prints does not garble the answers

    def say(**facts: Any) -> None:
        answers.write(json.dumps(facts) + "\n")
        answers.flush()

    say(versions={name: importlib.metadata.version(name) for name in packages})
    for path in options.files:
        task = read(path, options.poles, options.zeros)
        before = time.process_time()
        try:
            theta = np.asarray(ways[options.way](task), dtype=float)
            if theta.shape != (task.poles + task.zeros + 1,):
                raise WrongOrder(f"{theta.size} coefficients")
            if not np.all(np.isfinite(theta)):
                raise NoContinuousModel("coefficients not finite")
            facts: dict[str, Any] = {"theta": theta.tolist()}
        except (Exception, SystemExit) as error:  # whatever it is, it is this peer's answer
            traceback.print_exc()
            facts = {"error": type(error).__name__, "message": str(error)[:200]}
        facts |= {"seconds": time.process_time() - before, "at": time.process_time()}
        say(file=path.name, peak=peak(), **facts)
