"""pysindy's weak form for one measured output.

A state that is not measured cannot be in a SINDy library. For equations of higher order in one
output its authors advise the weak form with time derivatives: `WeakPDELibrary` with
``implicit_terms`` integrates ``p^k y`` and ``p^j u`` against test functions, by parts, so that no
record is differentiated. The regression of ``p^n y`` on the others is then linear, and as the
terms are known, the optimizer `STLSQ` gets no threshold and no ridge. 200 test functions instead of
100, since more are better by the documentation. Between the samples the library draws straight
lines; the held input is therefore given as the mean of its neighbouring values.

"weak form" takes the default half width of a test function, a twentieth of the record; "tuned" the
one of ten whose simulation is nearest to the record.
"""

import sys
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
import pysindy as ps
from protocol import Task, best_fit, serve

SHARES = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.45)
FUNCTIONS = 200


def weak(task: Task, share: float = 0.05) -> np.ndarray:
    np.random.seed(0)  # noqa: NPY002 - the library draws from the global generator
    n, m = task.poles, task.zeros
    grid = task.dt * np.arange(task.u.size)
    library = ps.WeakPDELibrary(
        ps.PolynomialLibrary(degree=1, include_bias=False),
        derivative_order=n,
        spatiotemporal_grid=grid,
        implicit_terms=True,
        include_interaction=False,
        K=FUNCTIONS,
        H_xt=share * grid[-1],
        p=max(4, n + 1),
    )
    middle = np.append(task.u[0], (task.u[1:] + task.u[:-1]) / 2.0)
    signals = ps.AxesArray(np.column_stack([task.y, middle]), {"ax_time": 0, "ax_coord": 1})
    integrals = np.asarray(library.fit_transform(signals))
    names = library.get_feature_names(["y", "u"])

    def column(signal: str, order: int) -> np.ndarray:
        return integrals[:, names.index(signal + "_" * (order > 0) + "t" * order)]

    terms = [-column("y", k) for k in reversed(range(n))]
    terms += [column("u", k) for k in reversed(range(m + 1))]
    regressors = np.column_stack(terms)
    size = np.linalg.norm(regressors, axis=0)
    size[size == 0.0] = 1.0
    optimizer = ps.STLSQ(threshold=0.0, alpha=0.0)
    optimizer.fit(regressors / size, column("y", n)[:, None])
    return np.asarray(optimizer.coef_).ravel() / size


def tuned(task: Task) -> np.ndarray:
    most = (task.u.size - 1) / 2.0
    wide = [share for share in SHARES if share * most > task.poles + 3]
    return best_fit((lambda share=share: weak(task, share) for share in wide), task)


warnings.simplefilter("ignore")
serve({"weak form": weak, "weak form, tuned": tuned}, ("pysindy", "numpy", "scipy"))
