"""Whether a record from inside a loop tells the plant at all, where no reference is given.

With a constant set point a linear controller makes the input an exact function of past inputs and
of outputs. Where that function is short, the record holds to a relation of its own: a model with as
many terms cannot tell the plant from the controller's inverse, whatever the method and however long
the record. It can where something from outside moves the loop (a reference, a dither, a controller
that switches), or where the controller remembers at least as many samples as the plant has poles,
its delay counted (the condition of Soderstrom, Gustavsson & Ljung; then it rests on the noise being
of low order). So the input is regressed on outputs and on its past, with ever more lags: what is
left comes from outside.

References: T. Soderstrom, I. Gustavsson & L. Ljung, Int. J. Control 21 (1975) 243-255.
I. Gustavsson, L. Ljung & T. Soderstrom, Automatica 13 (1977) 59-75. M. Gevers, A. Bazanella,
X. Bombois & L. Miskovic, IEEE Trans. Automatic Control 54 (2009) 2828-2840.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple
from weakref import ReferenceType, WeakKeyDictionary, ref

import numpy as np
from scipy.special import fdtrc

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.judgement.causes.attempts.first_samples import beginning
from tridentify.judgement.causes.attempts.intersample import moves_between
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record

MOST_LAGS = 8
"""Samples that a controller is taken to remember at most."""

BLOCK = 4096
"""Samples that are folded into a triangle at a time."""

FEW = 1024
"""Samples that are folded at first: mostly they show that an input moves by itself."""

PER_COLUMN = 5
"""Samples for each column of a regression, at least."""

LITTLE = 10.0
"""Outside movement below which it tells nothing, as the sum of its squares in mean squares of what
the noise makes of the input at a sample: coefficients are then known to a third at best."""

ROUNDING = 1e-10
"""Surprises over the spread of the input, below which its own past tells it and nothing is asked:
it was commanded."""


RESTING = 0.5
"""Share of the samples at which an output moves and an input does not, from which no linear law of
outputs moves that: it was set, whatever an output that answers at once tells of it."""

NEARLY = 1e-4
"""Share of an input's surprises that a law may leave, which then is a controller's whatever the
input remembers: converters of eight bits leave 1e-5, noise of an output that answers at once 1e-2.
"""

CHANCE = 1e-3
"""p-value from which the past of an input tells nothing of it."""

FREE = 1e-5
"""Share of a column that those before it must leave for it to be one of its own without a doubt."""


class Law(NamedTuple):
    """What moves one input.

    Attributes
    ----------
    input : int
    lags : int or None
        Samples of inputs and outputs that the controller remembers, where these tell the input but
        for little; None where no such law was found.
    outside : float
        Movement from outside, as the sum of its squares in mean squares of what outputs make of
        the input at a sample; infinite for an input that outputs do not tell.
    share : float
        Of the input's surprises (what its own past does not tell) that comes from outside, 0 to 1.
    """

    input: int
    lags: int | None
    outside: float
    share: float


def laws(records: Sequence[Record], most: int = MOST_LAGS) -> tuple[Law, ...]:
    """What moves each input, as far as short linear laws tell.

    Parameters
    ----------
    records : sequence of Record
        Each with a constant of its own: the set point.
    most : int
        Lags that are tried.

    Returns
    -------
    tuple of Law
        One per input.

    Examples
    --------
    A proportional controller at a constant set point, and the same with a dither:

    >>> rng = np.random.default_rng(0)
    >>> y, dither = rng.standard_normal((2, 200))
    >>> laws([Record(1.0 - 2.0 * y, y, dt=0.1)])[0].lags
    0
    >>> laws([Record(1.0 - 2.0 * y + dither, y, dt=0.1)])[0].lags is None
    True
    """
    known = _LAWS.get(records[0])
    if known is None or not known.are_of(records, most):
        found = tuple(_law(records, j, most) for j in range(records[0].n_inputs))
        others = tuple(ref(one) for one in records[1:])
        known = _LAWS[records[0]] = _Known(others, most, found)
    return known.laws


class _Known(NamedTuple):
    """Laws of some records, the first of which lies elsewhere."""

    others: tuple[ReferenceType[Record], ...]
    most: int
    laws: tuple[Law, ...]

    def are_of(self, records: Sequence[Record], most: int) -> bool:
        """Whether these are the records, and so many lags were tried."""
        alike = self.most == most and len(self.others) == len(records) - 1
        pairs = zip(self.others, records[1:], strict=False)
        return alike and all(one() is other for one, other in pairs)


_LAWS: WeakKeyDictionary[Record, _Known] = WeakKeyDictionary()
"""Of records that are still in use: the choice of the route and the judgement ask for the same."""


def told_apart(law: Law, poles: int) -> bool:
    """Whether the plant can be told from the controller.

    Parameters
    ----------
    law : Law
    poles : int
        Of the plant.

    Examples
    --------
    >>> told_apart(Law(0, 1, 0.0, 0.0), 2), told_apart(Law(0, 2, 0.0, 0.0), 2)
    (False, True)
    """
    return law.lags is None or law.lags >= poles


def rests(records: Sequence[Record], j: int) -> bool:
    """Whether an input rests at most samples while outputs, and their noise, move.

    Parameters
    ----------
    records : sequence of Record
    j : int
        Of the input.

    Examples
    --------
    >>> y = np.random.default_rng(0).standard_normal(40)
    >>> held = Record(np.repeat([0.0, 1.0, -1.0, 1.0], 10), y, dt=0.1)
    >>> rests([held], 0), rests([Record(-y, y, dt=0.1)], 0)
    (True, False)
    """
    still_there = count = 0
    for record in records:
        still = np.diff(record.u[:, j]) == 0.0
        with_outputs = np.any(np.abs(np.diff(record.y, axis=0)) > 0.0, axis=1)
        still_there += int(np.count_nonzero(still & with_outputs))
        count += int(np.count_nonzero(with_outputs))
    return still_there > RESTING * max(count, 1)


def answers_at_once(estimate: Estimate) -> bool:
    """Whether an output has as many zeros as poles, as a resistance beside its cells.

    It then tells what a sensor adds to its input as well.

    Parameters
    ----------
    estimate : Estimate
    """
    shape = len(estimate.output_names), len(estimate.input_names)
    poles = np.array(estimate.structure.poles_matrix(*shape))
    return bool(np.any(poles == np.array(estimate.structure.zeros_matrix(*shape))))


def about_loop(
    estimate: Estimate, records: Sequence[Record], tested: Sequence[Finding]
) -> list[Finding]:
    """Whether a controller alone moves the inputs, where no reference says what else did.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
    tested : sequence of Finding
        Of the same records, with feedback where that was found.
    """
    if estimate.route == "reference" or any(record.dt is None for record in records):
        return []
    reacts = any(one.code == "feedback" for one in tested)
    names = estimate.input_names
    poles = int(np.max(estimate.structure.poles_matrix(len(estimate.output_names), len(names))))
    found = loop_findings(records, poles, names, reacts, answers_at_once(estimate))
    return [] if found and not reacts and moves_between(estimate, records) else found


def loop_findings(
    records: Sequence[Record], poles: int, names: Sequence[str], reacts: bool, at_once: bool = False
) -> list[Finding]:
    """A word where the controller alone moves an input.

    Parameters
    ----------
    records : sequence of Record
        Without references.
    poles : int
        Most of any channel.
    names : sequence of str
        Of the inputs.
    reacts : bool
        Whether an input was found to react to an output; where it is not held, or the outputs
        answer at once, nothing is said without that: an output then shows what moves it.
    at_once : bool
        Whether the model has as many zeros as poles: a resistance beside its cells.
    """
    held = all(record.behaviour == "zoh" for record in records)
    if not reacts and (at_once or not held):
        return []
    return [
        _in_words(law, poles, names[law.input])
        for law in laws(records)
        if law.lags is not None and (reacts or not rests(records, law.input))
    ]


def _in_words(law: Law, poles: int, name: str) -> Finding:
    memory = f"the last {law.lags + 1} samples" if law.lags else "the present sample"
    what = (
        f"{name} follows from {memory} of outputs and its own past, but for "
        f"{100.0 * law.share:.3g} % of its unforeseen movement: a linear controller alone moves "
        "it, the set point hardly does"
    )
    remedy = (
        "Move the set point (steps, PRBS) and record it as reference, or add a test signal to the "
        "input."
    )
    if told_apart(law, poles or 1):
        return Finding(
            "loop-not-excited",
            "warning",
            f"{what}; the plant is told from it by the controller's memory alone.",
            remedy,
        )
    return Finding(
        "loop-not-excited",
        "error",
        f"{what}. Such a record cannot tell a plant of {_count(poles, 'pole')} from the "
        f"controller's inverse, by no method.",
        remedy,
    )


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _law(records: Sequence[Record], j: int, most: int) -> Law:
    channels = records[0].n_inputs + records[0].n_outputs
    rows = sum(max(record.n_samples - most, 0) for record in records)
    most = min(most, rows // (PER_COLUMN * channels) - 1)
    none = Law(j, None, np.inf, 1.0)
    if most < 0:
        return none
    rows = sum(max(record.n_samples - most, 0) for record in records)
    spread = max(float(np.std(record.u[:, j])) for record in records)
    # without a gap the shorter regressions are columns of the longest one
    gaps = any(bool(np.isnan(record.y).any()) for record in records)
    if not gaps and rows > 2 * FEW and _by_itself(records, j, most, rows):
        return none
    longest = None if gaps else _regression(records, j, most, most)
    own = longest or _regression(records, j, most, most, outputs=False)
    alone, _ = own.left(most, -1)
    if not alone > (ROUNDING * spread) ** 2 * rows:
        return none
    if longest is not None:
        # with more lags less is left, and less comes from outside
        left, freedom = longest.left(most, most)
        if freedom >= 1 and left * freedom >= LITTLE * max(alone - left, 0.0):
            return none._replace(share=min(left / alone, 1.0))
    lowest, (whole, freedom) = 1.0, own.left(0, -1)
    remembers = _remembers(whole, alone, most, freedom - most)
    for lags in range(most + 1):
        left, freedom = (longest or _regression(records, j, lags, most)).left(lags, lags)
        if freedom < 1:
            break
        mean = left / freedom
        told = max(alone / freedom - mean, 1e-300)
        outside, share = mean / told * freedom, min(mean * freedom / alone, 1.0)
        lowest = min(lowest, share)
        if outside < LITTLE and (remembers or share < NEARLY):
            return Law(j, lags, outside, share)
    return none._replace(share=lowest)


def _remembers(whole: float, alone: float, lags: int, freedom: int) -> bool:
    """Whether the past of an input tells more of it than chance does (F test).

    The noise of a loop goes round it. An input that its own past does not tell was not made of
    that, and where outputs tell it they answer at once: the law is the plant's inverse. A loop
    whose noise is white and whose gain is small is like that too, but its law has no remainder.
    """
    if lags < 1 or freedom < 1:
        return True
    told = max(whole - alone, 0.0) / lags
    return bool(fdtrc(lags, freedom, told / max(alone / freedom, 1e-300)) < CHANCE)


def _by_itself(records: Sequence[Record], j: int, most: int, rows: int) -> bool:
    """Whether a few samples alone leave more than outputs could tell of the input in all of them.

    All samples leave no less than some, and of an input there is no more to be told than moves.
    """
    longest = max(records, key=lambda one: one.n_samples)
    some = _regression([beginning(longest, FEW)], j, most, most)
    left, _ = some.left(most, most)
    moves = sum(float(np.var(one.u[:, j])) * one.n_samples for one in records)
    freedom = rows - len(some.lags) - len(records) + 1
    return left * freedom >= LITTLE * max(moves - left, 0.0)


class _Regression(NamedTuple):
    """An input on its past and on outputs, as the triangle of what stands side by side.

    Attributes
    ----------
    triangle : (q, q) array
        Of a constant for each record, the inputs and the outputs with ever more lags, and what is
        regressed.
    rows : int
        Samples.
    lags : (q - 1,) array of int
        Of each column, none of constants.
    is_output : (q - 1,) array of bool
    apart : int
        First columns none of which follows from those before.
    """

    triangle: Array
    rows: int
    lags: Array
    is_output: Array
    apart: int

    def left(self, inputs: int, outputs: int) -> tuple[float, int]:
        """Sum of squares that so many lags of each leave, and its degrees of freedom."""
        if not self.rows:
            return 0.0, 0
        taken = self.lags <= np.where(self.is_output, outputs, inputs)
        k, wanted = int(np.count_nonzero(taken)), self.triangle[:, -1]
        if k <= self.apart and taken[:k].all():
            return float(wanted[k:] @ wanted[k:]), self.rows - k
        known = self.triangle[:, :-1][:, taken]
        scale = np.maximum(np.linalg.norm(known, axis=0), 1e-300)
        fitted, _, rank, _ = np.linalg.lstsq(known / scale, wanted, rcond=1e-12)
        left = wanted - (known / scale) @ fitted
        return float(left @ left), self.rows - int(rank)


def _regression(
    records: Sequence[Record], j: int, lags: int, first: int, *, outputs: bool = True
) -> _Regression:
    """Triangle of the samples from one on, of an input beside what may tell it."""
    from tridentify.numerics.kernels.triangles import triangularise

    sources = [(False, lag) for lag in range(1, lags + 1)]
    sources += [(True, lag) for lag in range(lags + 1)] if outputs else []
    widths = [records[0].n_outputs if output else records[0].n_inputs for output, _ in sources]
    levels, rows, top = len(records), 0, 0
    size = levels + sum(widths) + 1
    longest = max(record.n_samples for record in records)
    # the triangle of the samples before stands on top of a block
    every, r = np.empty((size, size + max(min(BLOCK, longest - first), 0))), np.zeros((size, size))
    for e, record in enumerate(records):
        gaps = bool(np.isnan(record.y).any())
        u = (record.u - record.u.mean(axis=0)).T
        y = (record.y - (np.nanmean if gaps else np.mean)(record.y, axis=0)).T
        for start in range(first, record.n_samples, BLOCK):
            stop = min(start + BLOCK, record.n_samples)
            block, at = every[:, top : top + stop - start], levels
            block[:levels] = 0.0
            block[e] = 1.0
            for (output, lag), width in zip(sources, widths, strict=True):
                block[at : at + width] = (y if output else u)[:, start - lag : stop - lag]
                at += width
            block[at] = record.u[start:stop, j]
            count = stop - start
            if gaps:
                seen = np.isfinite(block).all(axis=0)
                count = int(seen.sum())
                block[:, :count] = block[:, seen]
            if count:
                triangularise(every, top + count, 0, 0, r)
                every[:, :size] = r.T
                rows, top = rows + count, size
    of = [one for one, width in zip(sources, widths, strict=True) for _ in range(width)]
    own = np.array([(False, 0)] * levels + of, dtype=int)
    known = r[:, :-1]
    scale = np.maximum(np.sqrt(np.einsum("ij,ij->j", known, known)), 1e-300)
    is_own = np.abs(known.diagonal()) > FREE * scale
    apart = is_own.size if is_own.all() else int(np.argmin(is_own))
    return _Regression(r, rows, own[:, 1], own[:, 0] == 1, apart)
