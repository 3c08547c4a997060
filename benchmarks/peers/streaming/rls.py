"""Plain recursive least squares of three libraries on given regressors; prints JSON.

    python rls.py FILE

The file (npz) holds ``phi`` (n_samples, n_parameters) and ``target`` (n_samples,): the filters have
run already, and their time is not counted. Without forgetting all must end at the least-squares
solution; how far from it they are is printed along.

* padasip: ``FilterRLS(n, mu=1, eps=1e-6)``, its ``run`` over arrays, its ``adapt`` for a sample.
* river: ``BayesianLinearRegression(beta=1e8)``, the prior of which is negligible then; it has no
  run over a record, its ``learn_one`` takes dictionaries, which are made beforehand.
* statsmodels: ``RecursiveLS``, its compiled filter over the whole record, once with everything
  that its results offer, once without what nobody asked for (``set_conserve_memory``); it cannot
  take one sample.
"""

from __future__ import annotations

import importlib.metadata
import json
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

SLOW = 100_000
STEPS = 20_000
NOT_KEPT = ("PREDICTED", "SMOOTHING", "GAIN", "STD_FORECAST")


def spent(run: Callable[[], Any]) -> tuple[float, Any]:
    """Processor time [s] and the result."""
    before = time.process_time()
    found = run()
    return time.process_time() - before, found


def latency(step: Callable[[Any, Any], Any], xs: list[Any], ys: list[Any]) -> dict[str, float]:
    """Median, 99th percentile and largest time of a step [us]."""
    times = np.empty(len(xs))
    for k, (x, y) in enumerate(zip(xs, ys, strict=True)):
        before = time.perf_counter_ns()
        step(x, y)
        times[k] = time.perf_counter_ns() - before
    kept = times[len(times) // 10 :] / 1e3
    return {
        "median": float(np.median(kept)), "p99": float(np.quantile(kept, 0.99)),
        "worst": float(kept.max()),
    }  # fmt: skip


def padasip(phi: Any, target: Any) -> dict[str, Any]:
    from padasip.filters import FilterRLS

    def fresh() -> Any:
        return FilterRLS(phi.shape[1], mu=1.0, eps=1e-6, w="zeros")

    filter_ = fresh()
    seconds, _ = spent(lambda: filter_.run(target[:SLOW], phi[:SLOW]))
    single = fresh()
    steps = latency(lambda x, y: single.adapt(y, x), list(phi[:STEPS]), target[:STEPS].tolist())
    n = min(SLOW, target.size)
    return {"rate": n / seconds, "n": n, "theta": filter_.w.tolist(), "step": steps}


def river(phi: Any, target: Any) -> dict[str, Any]:
    from river.linear_model import BayesianLinearRegression

    rows = [dict(enumerate(row)) for row in phi[:SLOW].tolist()]
    values = target[:SLOW].tolist()

    def run(model: Any) -> None:
        for row, value in zip(rows, values, strict=True):
            model.learn_one(row, value)

    model = BayesianLinearRegression(beta=1e8)
    seconds, _ = spent(lambda: run(model))
    unit = np.eye(phi.shape[1]).tolist()
    theta = [model.predict_one(dict(enumerate(row))) for row in unit]
    single = BayesianLinearRegression(beta=1e8)
    steps = latency(single.learn_one, rows[:STEPS], values[:STEPS])
    return {"rate": len(rows) / seconds, "n": len(rows), "theta": theta, "step": steps}


def statsmodels(phi: Any, target: Any, conserve: bool) -> dict[str, Any]:
    from statsmodels.regression.recursive_ls import RecursiveLS
    from statsmodels.tsa.statespace import kalman_filter

    model = RecursiveLS(target, phi)
    if conserve:
        left_out = (getattr(kalman_filter, f"MEMORY_NO_{name}") for name in NOT_KEPT)
        model.ssm.set_conserve_memory(sum(left_out))
    seconds, found = spent(model.ssm.filter)
    theta = np.asarray(found.filtered_state)[:, -1].tolist()
    return {"rate": target.size / seconds, "n": target.size, "theta": theta, "step": None}


def main() -> None:
    data = np.load(sys.argv[1])
    phi, target = data["phi"], data["target"]
    found = {
        "padasip FilterRLS": padasip(phi, target),
        "river BayesianLinearRegression": river(phi, target),
        "statsmodels RecursiveLS": statsmodels(phi, target, False),
        "statsmodels, less memory": statsmodels(phi, target, True),
    }
    for entry in found.values():
        exact = np.linalg.lstsq(phi[: entry["n"]], target[: entry["n"]], rcond=None)[0]
        entry["distance"] = float(np.max(np.abs(entry.pop("theta") / exact - 1.0)))
    versions = {n: importlib.metadata.version(n) for n in ("padasip", "river", "statsmodels")}
    print(json.dumps({"rivals": found, "versions": versions}))


if __name__ == "__main__":
    main()
