"""Steps in machine code are those of Python: same ends, same trace, whatever the structure."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify.estimation.answer.estimate import Step
from tridentify.estimation.likelihood.cost import evaluate, evaluate_variant
from tridentify.estimation.likelihood.fitted_point import ROUNDING_SQUARED
from tridentify.estimation.likelihood.minimum.descent import Descent
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import (
    Recorder,
    finish,
    finishing,
)
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.models.flat_charts import FlatCharts
from tridentify.models.regression import Experiment
from tridentify.numerics.realization import sort_poles
from tridentify.numerics.slices import drain

DT = 0.1
POLES = {1: [-0.4], 2: [-0.5, -3.0], 3: [-0.5 + 3j, -0.5 - 3j, -1.0], 4: [-0.3, -1.0, -4.0, -9.0]}


def experiment(seed=0, n=300, outputs=1, inputs=1, **terms) -> Experiment:
    """A resonance behind random steps, one for each output, in white noise."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], (n // 6 + 1, inputs)), 6, axis=0)[:n]
    each = [lfilter([0.3 + k, 0.1], [1.0, -1.7, 0.8], u.sum(axis=1)) for k in range(outputs)]
    y = np.column_stack(each) * (1.0 + 0.2 * rng.standard_normal((n, outputs))) + 0.5
    chosen = {"intersample": "zoh", "free": False, "offset": True, "drift": False} | terms
    return Experiment(np.ascontiguousarray(u), np.ascontiguousarray(y), DT, **chosen)


def gappy() -> Experiment:
    one = experiment(outputs=2)
    one.y[::7, 0] = np.nan
    return one


PROBLEMS = {
    **{f"order {n}": Problem.of([experiment()], n, ((max(n - 2, 0),),)) for n in POLES},
    "direct part": Problem.of([experiment()], 2, ((2,),)),
    "free start and drift": Problem.of([experiment(free=True, drift=True)], 2, ((1,),)),
    "ramps": Problem.of([experiment(intersample="foh")], 2, ((1,),)),
    "band-limited": Problem.of([experiment(intersample="band-limited")], 2, ((1,),)),
    "two of each": Problem.of([experiment(outputs=2, inputs=2)], 2, ((1, 0), (0, 1))),
    "own denominators": Problem.of([experiment(inputs=2)], ((2, 1),), ((0, 0),)),
    "missing samples": Problem.of([gappy()], 2, ((1,), (1,))),
    "known delay": Problem.of([experiment(delays=np.array([[0.13]]))], 2, ((1,),)),
    "two experiments": Problem.of([experiment(), experiment(1, 200)], 2, ((1,),)),
    "coloured noise": Problem.of(
        [experiment(outputs=2, noise=(np.array([-0.6, 0.1]), np.zeros(0)))], 2, ((1,), (0,))
    ),
}


def start_of(problem):
    return sort_poles(np.array([z for g in problem.groups for z in POLES[g.order]], dtype=complex))


def compared(at, start) -> None:
    """Steps by a cost that machine code knows, and by the same one that it cannot know."""
    told, plain = Recorder(), Recorder()
    point, status, _ = finish(at, start, told)
    other, ended, _ = finish(lambda *given, **more: at(*given, **more), start, plain)
    _, taken = drain(Descent(at, 1e-7).running(start, 60, ROUNDING_SQUARED))
    assert len(taken) > 2
    assert status is ended
    np.testing.assert_allclose(point.poles, other.poles, rtol=1e-6)
    assert point.objective == pytest.approx(other.objective, abs=1e-6)
    assert abs(len(told.passes) - len(plain.passes)) <= 1  # rounding may settle the last one
    for one, same in zip(told.passes[:4], plain.passes, strict=False):
        np.testing.assert_allclose(one.theta, same.theta, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(one.steps[0].coefficients, same.steps[0].coefficients, rtol=1e-6)
        assert one.cost == pytest.approx(same.cost, rel=1e-8)
        assert one.gradient == pytest.approx(same.gradient, rel=1e-3, abs=1e-9)
        assert one.steps[0].condition == pytest.approx(same.steps[0].condition, rel=1e-5)
        assert (one.note, one.steps[0].note) == (same.note, same.steps[0].note)


@pytest.mark.parametrize("name", PROBLEMS)
def test_steps_in_machine_code_are_those_of_python(name):
    problem = PROBLEMS[name]
    at = partial(evaluate, problem)
    compared(at, at(start_of(problem)))


@pytest.mark.parametrize("constant", [None, 0.7])
def test_a_choice_of_nuisance_terms_is_kept(constant):
    base = Problem.of([experiment(free=True, drift=True)], 2, ((1,),))
    constants = None if constant is None else np.array([constant])
    at = partial(evaluate_variant, base, Variant(False, True, False, (constants,)))
    compared(at, at(np.array([-0.5, -3.0], dtype=complex)))


def test_a_long_record_pauses_between_its_steps():
    problem = Problem.of([experiment(n=3_000)], 4, ((1,),))
    at = partial(evaluate, problem)
    steps = finishing(at, at(np.array(POLES[4], dtype=complex)), Recorder())
    assert sum(1 for _ in steps) > 3


def test_what_machine_code_does_not_serve_is_left_to_python():
    uneven = experiment(n=50, t=np.arange(50) * DT)
    assert FlatCharts.of([uneven]) is None
    assert FlatCharts.of([experiment(), experiment(free=True)]) is None


def test_passes_are_worked_out_when_they_are_asked_for_and_numbered_on():
    problem = Problem.of([experiment()], 2, ((1,),))
    point = evaluate(problem, np.array([-0.5, -3.0], dtype=complex))
    made: list[str] = []

    def steps():
        made.append("now")
        return (Step("parallel", np.zeros(1), 0.0, 1.0),)

    first, second = Recorder(), Recorder()
    second.add(point, steps, np.nan, "second")
    first.add(point, steps, np.nan, "first")
    first.extend(second)
    first.add(point, steps, np.nan, "third")
    assert not made
    assert [(one.number, one.note) for one in first.passes] == [
        (1, "first"), (2, "second"), (3, "third"),
    ]  # fmt: skip
    first.extend(Recorder(first.passes[:1]))
    assert [one.number for one in first.passes] == [1, 2, 3, 4]
    assert len(made) == 3
