"""Noise that is of another size in one of several experiments, and what their weights are worth.

A linear system answers in proportion: with input and output of an experiment divided by the size of
its noise, least squares gives every sample the weight that its noise calls for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.likelihood.curvature import Curvature
from tridentify.judgement.causes.attempts.attempt import attempt
from tridentify.judgement.causes.system.slow import HALVES, MOSTLY_SLOW, slow_share
from tridentify.judgement.validation.explained import most_moved, present_of
from tridentify.judgement.validation.phrases import one_finding
from tridentify.judgement.validation.residuals import View
from tridentify.judgement.validation.statistics.evidence import Evidence
from tridentify.judgement.validation.statistics.likelihood_ratio import CALLED
from tridentify.numerics.arrays import Array
from tridentify.numerics.local_size import sizes_of

OTHER = 1.5
"""Size of the noise of one experiment over that of another from which it is another one."""
WORTH = 1.25
"""Standard errors over those with weights from which the weights are worth a warning."""


def of_each(
    view: View, one: Evidence, name: str, estimate: Estimate, noises: Sequence[Array]
) -> Finding | None:
    """What is to be said where the noise differs between experiments, and not within them.

    Parameters
    ----------
    view : View
    one : Evidence
        Of the output.
    name : str
        Of the output.
    estimate : Estimate
    noises : sequence of (p,) arrays
        Model of each output's noise.
    """
    if len(view.records) < 2 or one.scale_within < CALLED:
        return None
    sizes = np.array(sizes_of(one.innovations))
    if not np.all(sizes > 0) or sizes.max() < OTHER * sizes.min():
        return None
    odd, said = _in_words(sizes)
    weighed = _weighed(view, estimate, noises, sizes) if view.own else None
    text = f"the noise of {name} is not of one size: {said}"
    slow = 0.0 if odd is None else _slow(view, odd, name)
    code = "drift" if slow > MOSTLY_SLOW else "noise-changes"
    if odd is not None and code == "drift":
        text = (
            f"a slow disturbance moves {name} in experiment {odd + 1}: of the residual there "
            f"{100 * slow:.0f} % is slower than {HALVES // 2} periods a record, and {said}"
        )
    if weighed is None:
        return one_finding(code, name, text, "", "note", experiment=odd)
    ratio, moves = weighed
    text += "; all count alike, so that the noisy spoil what the others tell"
    worth = ratio > WORTH
    do = (
        "divide input and output of each experiment by the size of its noise, which a linear "
        "system allows, and identify again: that weights them"
    )
    effect = f"weighted like that, {moves or 'no coefficient moves by more than its error'}"
    effect += f", and standard errors are {ratio:.1f} times smaller"
    return one_finding(
        code,
        name,
        text,
        do if worth else "",
        "warning" if worth else "note",
        effect=effect if worth else "",
        experiment=odd,
    )


def _slow(view: View, experiment: int, name: str) -> float:
    """Share of what is left of an output in one experiment that is slow."""
    (own,) = (output for output in view.outputs if output.name == name)
    return slow_share(own.residual[experiment])


def _in_words(sizes: Array) -> tuple[int | None, str]:
    """Which experiment is of another size than all others, and by how much.

    Examples
    --------
    >>> _in_words(np.array([1.0, 1.1, 7.5]))
    (2, 'that of experiment 3 is 7.1 times that of the others')
    >>> _in_words(np.array([1.0, 3.0]))
    (1, 'that of experiment 2 is 3.0 times that of experiment 1')
    >>> _in_words(np.array([1.0, 3.0, 9.0]))
    (None, 'that of experiments 1, 2, 3 is as 1 to 3 to 9')
    """
    if sizes.size == 2:
        e = int(np.argmax(sizes))
        times = f"{sizes[e] / sizes[1 - e]:.1f}"
        return e, f"that of experiment {e + 1} is {times} times that of experiment {2 - e}"
    e = int(np.argmax(np.abs(np.log(sizes / np.median(sizes)))))
    others = np.delete(sizes, e)
    if others.max() < OTHER * others.min():
        times = f"{sizes[e] / np.median(others):.2g}"
        return e, f"that of experiment {e + 1} is {times} times that of the others"
    numbers = ", ".join(str(k + 1) for k in range(sizes.size))
    as_to = " to ".join(f"{one:.2g}" for one in sizes / sizes.min())
    return None, f"that of experiments {numbers} is as {as_to}"


def _weighed(
    view: View, estimate: Estimate, noises: Sequence[Array], sizes: Array
) -> tuple[float, str] | None:
    """By how much standard errors fall with weights, and which coefficient moves most.

    None for a structure with constraints, and where it cannot be fitted.
    """
    if estimate.structure.constrained or not np.isfinite(estimate.std).all():
        return None
    present = present_of(view, estimate, noises)
    usual = float(np.median(sizes))
    records = [
        record._derive(u=record.u * (usual / size), y=record.y * (usual / size))
        for record, size in zip(present.records, sizes.tolist(), strict=True)
    ]
    part = replace(present, records=tuple(records))
    try:
        end = attempt(part.problem(), [part.poles], part.orders)
        if end is None:
            return None
        std = Curvature.at(end.point).std
    except (TridentifyError, np.linalg.LinAlgError, FloatingPointError):
        return None
    moves = most_moved(estimate, end)
    if moves is None or std.size != estimate.std.size or not np.all(std > 0):
        return None
    moves = moves.replace(" from ", " goes from ", 1)
    return float(np.median(estimate.std / std)), moves
