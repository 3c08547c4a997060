"""The recommendation in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tridentify.judgement.selection.numbers import percent, share
from tridentify.judgement.selection.orders import is_integrator, order_label
from tridentify.judgement.selection.result import UNFINISHED, SelectionRow
from tridentify.judgement.selection.rule import POINT, SLIGHT, Contender, Verdict, needed
from tridentify.judgement.validation.explained import TRIED
from tridentify.numerics.arrays import Array
from tridentify.structure import Structure

POORLY = 0.5
"""Standard error over value from which a coefficient is said to be poorly known."""
CLOSE = 10.0
"""Difference of AICc up to which it is said to be small, as `thresholds.CLEARLY`."""


def in_words(
    rows: Sequence[SelectionRow],
    contenders: Sequence[Contender],
    verdict: Verdict,
    missed: bool,
    coloured: bool = False,
) -> str:
    """Say what decided.

    Parameters
    ----------
    rows : sequence of SelectionRow
    contenders : sequence of Contender
        What the likelihood says of them.
    verdict : Verdict
    missed : bool
        Whether the residual of the recommended one follows the input.
    coloured : bool
        Whether it is not white, and time not even, so that no noise model was fitted.
    """
    place = verdict.place
    if place is not None and verdict.instead is not None:
        larger, what = verdict.instead
        return (
            f"{_capital(named(rows[place].structure))} are recommended: with {what} they explain "
            f"the record clearly better than {named(rows[larger].structure)} do without, whose "
            "further coefficients stand for that."
        )
    if place is None or verdict.by == "likelihood" or verdict.best is None:
        return reason_of(rows, contenders, place, missed)
    own, name = rows[place], _capital(named(rows[place].structure))
    fit = percent(own.cross_fit)
    if verdict.best == place:
        text = f"{name} predict samples that were left out best ({fit} %)"
        if not verdict.sound:
            text += " of those that are usable"
        told = [text + "."]
    else:
        joint = "" if verdict.by == "held-out" and not verdict.fair else ","
        within = _within(rows, verdict)
        told = [f"{name} predict samples that were left out to {fit} %{joint} {within}."]
    told.append(_passed_over(rows, place))
    if not verdict.sound:
        told.append(f"It is not sound: {'; '.join(own.doubts) or own.held_out_reason}.")
    if missed:
        told += [MISSED, _likeliest_cause(own)]
    elif coloured:
        told.append(COLOURED)
    return " ".join(filter(None, told))


def notes(
    models: Sequence[tuple[Array, ...]], unseen: bool, finished: bool = True
) -> tuple[str, ...]:
    """How the rows were compared, with noise models of each, and whether on unseen records.

    ``finished`` says that every row is.
    """
    told = []
    noise = next((noise for noise in models if noise), ())
    if any(a.size for a in noise):
        sizes = ", ".join(str(a.size) for a in noise)
        told.append(
            "the noise is coloured: likelihoods are compared on samples whitened by "
            f"autoregressions, for every candidate of the same order ({sizes})"
        )
    if unseen:
        told.append("held-out: fit of the validation record, offset and initial state fitted to it")
    else:
        told.append(
            "held-out: fit of blocks of the record that were left out in turn, offset and initial "
            "state fitted to the whole record"
        )
    told.append("fit and coefficients of every row are those that identify gives for it alone")
    if not finished:
        told[-1] += f", but of those that are {UNFINISHED}, which cannot be recommended"
    return tuple(told)


def _within(rows: Sequence[SelectionRow], verdict: Verdict) -> str:
    """How the recommended candidate compares with the one of the best held-out fit."""
    assert verdict.place is not None
    assert verdict.best is not None
    own, other = rows[verdict.place], rows[verdict.best]
    best = f"{named(other.structure)} ({percent(other.cross_fit)} %)"
    if verdict.by == "held-out" and verdict.fair:
        # a number that is clearly lower needs its reason beside it
        return (
            f"less than the best, {best}, but as well as that where offset, drift and free "
            "responses are left aside: what moves slowly is not told from a response"
        )
    if verdict.by == "held-out":
        return f"as well as the best, {best}, within the scatter of the difference"
    if verdict.by == "useful":
        return (
            f"which is of use: of the larger ones up to {best} none predicts clearly better than a "
            "candidate that has no more coefficients and is not determined"
        )
    gap = float(other.cross_fit.min() - own.cross_fit.min())
    aside = " where offset and initial state are left aside or the scatter is taken off"
    fair = aside if gap > POINT else ""
    if verdict.by == "slight":
        return (
            f"near the best, {best}{fair}: what that predicts besides is less than "
            f"{100 * SLIGHT:g} % of the output's size, which is no reason for poles that may stand "
            "for the delay"
        )
    if gap <= 0.0:
        return (
            f"no worse than the best of those that are sound, {best}, which is no reason for more "
            "coefficients"
        )
    return (
        f"less than {POINT:g} % of the output's size below the best, {best}{fair}, which is no "
        "reason for more coefficients where no candidate explains the record"
    )


MISSED = (
    "Its residual still follows the input, so it does not explain the record: the smallest useful "
    "model is recommended."
)

COLOURED = (
    "Its residual is not white, and no noise model is fitted where time is not even: likelihoods "
    "would ask for too many poles, so what predicts decides."
)


def _likeliest_cause(row: SelectionRow) -> str:
    """What explains such a residual best, in the words of the first finding that is no note."""
    found = () if row.estimate is None else row.estimate.findings
    first = next((one for one in found if one.severity != "note"), None)
    if first is None or first.code == "order-low":
        return ""
    _, tried, said = first.message.partition(TRIED)
    return f"{tried}{said}"


def _passed_over(rows: Sequence[SelectionRow], place: int) -> str:
    """The candidate of the best held-out fit that something speaks against, and what."""
    own = rows[place].cross_fit.min(initial=float("inf"))
    better = [
        row
        for row in rows
        if row.doubts
        and row.cross_fit.size
        and row.cross_fit.min() > own
        and row is not rows[place]
    ]
    if not better:
        return ""
    best = max(better, key=lambda row: float(row.cross_fit.min()))
    return (
        f"{_capital(named(best.structure))} reach {percent(best.cross_fit)} %, but: "
        f"{'; '.join(best.doubts)}."
    )


def reason_of(
    rows: Sequence[SelectionRow], contenders: Sequence[Contender], place: int | None, missed: bool
) -> str:
    """Say why a row is recommended, in a few sentences.

    Parameters
    ----------
    rows : sequence of SelectionRow
    contenders : sequence of Contender
        What the rule saw of them.
    place : int or None
        Which one is recommended.
    missed : bool
        Whether its residual follows the input.
    """
    if place is None:
        if all(row.estimate is None for row in rows):
            return f"no candidate could be estimated; the first one: {rows[0].reason}"
        first = next(row for row in rows if row.estimate is not None)
        return f"no candidate has a usable end; the first one: {first.status}"
    told = [
        _against_larger(rows, contenders, place),
        _against_smaller(rows, contenders, place),
        _unusable(rows, contenders, place),
    ]
    own = rows[place]
    if own.relative_std > POORLY:
        told.append(
            f"Its {own.widest} is known to {share(own.relative_std)} only: a simpler model may do."
        )
    if missed:
        told.append("Its residual still follows the input, so no candidate explains the record.")
        told.append(_likeliest_cause(own))
    return " ".join(filter(None, told))


def reason_ahead(rows: Sequence[SelectionRow], contenders: Sequence[Contender], place: int) -> str:
    """Say why a row is recommended, of those that were compared one sample ahead.

    Parameters
    ----------
    rows, contenders, place
        As of `reason_of`.
    """
    own, name = contenders[place].criteria, _capital(named(rows[place].structure))
    usable = [k for k, one in enumerate(contenders) if one.usable]
    best = min(usable, key=lambda k: contenders[k].criteria.aicc)
    told = [f"{name} have the lowest AICc one sample ahead."]
    if best != place:
        other, gain = contenders[best].criteria, own.aicc - contenders[best].criteria.aicc
        fall, price = own.deviance - other.deviance, needed(contenders[place], contenders[best])
        smaller = 100.0 * -math.expm1(-max(fall, 0.0) / (2.0 * own.n_samples))
        because = (
            f"but: {'; '.join(rows[best].doubts)}"
            if rows[best].doubts
            else f"but -2 log L falls by {max(fall, 0.0):.1f}, less than the {price:.1f} that the "
            "further unknowns must bring"
            if fall <= price
            else f"but the error one sample ahead by {smaller:.2g} % only"
        )
        text = f"{_capital(named(rows[best].structure))} lower AICc by {gain:.1f}, {because}"
        told = [f"{text}: {name[0].lower()}{name[1:]} are recommended."]
    fewer = [k for k in usable if rows[k].n_coefficients < rows[place].n_coefficients]
    if fewer:
        near = min(fewer, key=lambda k: contenders[k].criteria.aicc)
        above = contenders[near].criteria.aicc - own.aicc
        best_of = f"The best of the smaller ones, {named(rows[near].structure)}, lie"
        told.append(f"{best_of} {above:.1f} above." if above > 0.0 else "")
    if rows[place].doubts:
        told.append(f"It is not sound: {'; '.join(rows[place].doubts)}.")
    return " ".join(filter(None, told))


def named(structure: Structure) -> str:
    """Orders in words.

    Examples
    --------
    >>> named(Structure(2, 1)), named(Structure(1, 0)), named(Structure(2, [[1], [0]]))
    ('2 poles and 1 zero', '1 pole and no zero', 'poles, zeros = 2, [[1], [0]]')
    >>> named(Structure(2, 1, fixed={"a0": 0}))
    '2 poles, one of them at zero, and 1 zero'
    """
    n, m = structure.poles, structure.zeros
    at_zero = is_integrator(structure)
    if not isinstance(n, int) or not isinstance(m, int) or (structure.constrained and not at_zero):
        return f"poles, zeros = {order_label(structure)}"
    zeros = "no zero" if m == 0 else "1 zero" if m == 1 else f"{m} zeros"
    delay = " and a free delay" if structure.delay == "free" else ""
    if at_zero:
        poles = "1 pole, at zero," if n == 1 else f"{n} poles, one of them at zero,"
    else:
        poles = f"{n} pole{'s' if n > 1 else ''}"
    drift = "" if structure.drift in (False, "auto") else " with a drift"
    return f"{poles} and {zeros}{delay}{drift}"


def _against_larger(
    rows: Sequence[SelectionRow], contenders: Sequence[Contender], place: int
) -> str:
    """Against the candidate of the lowest AICc, or the best of those with more unknowns."""
    own, name = contenders[place].criteria, named(rows[place].structure)
    usable = [k for k, c in enumerate(contenders) if c.usable]
    best = min(usable, key=lambda k: contenders[k].criteria.aicc)
    if best != place:
        other = contenders[best].criteria
        gain = own.aicc - other.aicc
        only = " only" if gain < CLOSE else ""
        text = f"{_capital(named(rows[best].structure))} lower AICc by {gain:.1f}{only}"
        if rows[best].relative_std > POORLY:
            text += f", while {rows[best].widest} is known to {share(rows[best].relative_std)}"
        if other.n_unknowns > own.n_unknowns:
            price = needed(contenders[place], contenders[best])
            fall = own.deviance - other.deviance
            text += (
                f"; -2 log L falls by {max(fall, 0.0):.1f}, less than the {price:.1f} that "
                "the further unknowns must bring"
            )
        else:
            text += ", but the record hardly determines its poles"
        return f"{text}: {name} are recommended."
    larger = [k for k in usable if contenders[k].criteria.n_unknowns > own.n_unknowns]
    if not larger:
        return f"{_capital(name)} have the lowest AICc, and no candidate is larger."
    near = min(larger, key=lambda k: contenders[k].criteria.aicc)
    above = contenders[near].criteria.aicc - own.aicc
    return (
        f"{_capital(name)} have the lowest AICc; the best of the larger candidates, "
        f"{named(rows[near].structure)}, lies {above:.1f} above."
    )


def _against_smaller(
    rows: Sequence[SelectionRow], contenders: Sequence[Contender], place: int
) -> str:
    own = contenders[place].criteria
    smaller = [
        k for k, c in enumerate(contenders) if c.usable and c.criteria.n_unknowns < own.n_unknowns
    ]
    if not smaller:
        return ""
    near = min(smaller, key=lambda k: contenders[k].criteria.aicc)
    fall = contenders[near].criteria.deviance - own.deviance
    price = needed(contenders[near], contenders[place])
    if fall <= price:
        return ""
    return (
        f"{_capital(named(rows[near].structure))} are too few: -2 log L is {fall:.1f} higher, "
        f"more than the {price:.1f} that needless unknowns may bring."
    )


def _unusable(rows: Sequence[SelectionRow], contenders: Sequence[Contender], place: int) -> str:
    """Candidates out of the race that explain more."""
    own = contenders[place].criteria
    better = [
        k
        for k, c in enumerate(contenders)
        if rows[k].estimate is not None and not c.usable and c.criteria.aicc < own.aicc - CLOSE
    ]
    if not better:
        return ""
    best = min(better, key=lambda k: contenders[k].criteria.aicc)
    gain = own.aicc - contenders[best].criteria.aicc
    return (
        f"{_capital(named(rows[best].structure))} would lower AICc by {gain:.1f}, but ended "
        f"{rows[best].status}: something fast is missing, perhaps a delay or a direct feedthrough."
    )


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
