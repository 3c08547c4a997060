r"""Which row is recommended, and why.

Two questions, since simulated records have a true order and measured ones have none.

*Does the likelihood speak?* A candidate with more unknowns always fits better. The lowest AICc asks
whether it predicts better, on average; asked of many candidates at once, it often says yes to one
of them by luck. A superfluous pole can be put anywhere in the band with a zero on top of it, and
the best place fits the noise: the fall of ``-2 log L`` is the largest of many nearly independent
chi-squares, not one of them (Davies 1977, 1987). So a candidate is *adequate* if no usable
candidate with more unknowns lowers ``-2 log L`` by more than

    N log(1 + d log N / (N - k)),

for ``d`` more unknowns, ``k`` in all: the price of BIC (Schwarz 1978) with the factor of an F test
where ``N`` is small. Of the adequate candidates the one with the fewest unknowns is the
*likeliest*; where the record hardly determines its coefficients, another one with as many poles, or
as many unknowns and fewer poles, stands in for it: that something is hardly determined is no
argument for more poles. It is to be believed if it
*explains* the record: it is sound and its residual does not follow the input. That a pole and a
zero cancel within their errors is no objection where the likelihood refutes it (`refuted`), and
that coefficients are badly known is none where larger candidates explain no more (`levels_off`).

*What does a measured record support?* There every candidate is wrong, and enough samples refute all
but the largest. Wanted is the smallest *sound* candidate (`soundness`: not at a limit, its
coefficients determined, no slow swing that only follows a disturbance) that predicts what it has
not seen as well as the best sound one, within the scatter of their difference (`paired`: over few
groups of equal evidence; as it is, or on fair terms). Where a candidate that is not sound predicts
as well as the best sound one and has fewer coefficients, more of them are not wanted either: then
the smaller sound candidates are compared with each other, as far as they are of use.

Hardly any difference is significant where a record has a few edges only. So a candidate with fewer
poles than rise above the noise of a parallel model on its own poles (`hankel`) is not as good as
the best one where it leaves twice as much and more.

*Both together.* Where the likeliest candidate explains the record and predicts held-out samples no
worse than the one that the second question names (compared on errors whitened by its noise model),
it is recommended; else the latter is. Where no candidate explains the record, or only one that is
itself not sharply known, a difference of less than one percent of the output's size (and its
standard error) buys no poles either: the wrong structure alone leaves more than that. Where the
likeliest one is among the largest and has no delay, while one with a delay is there, poles of it
may stand for the dead time: none of them is the true order then, and what it predicts besides has
to be of some size (`SLIGHT`). The record can refute that: where a delay beside these poles explains
nothing more they are lags of the plant, and a candidate with a delay whose residual still follows
the input is none of it.

*Measured*: on random systems in `benchmarks/trust.py` and `tests/statistical/test_selection.py`; on
random plants with drifts, gusts, surroundings that warm up, springs that stiffen, friction and
saturation in `tests/statistical/test_selection_wrong_worlds.py`; on measured records in
`benchmarks/real_records.py`.

References: R. Davies, Biometrika 64 (1977) 247-254 and 74 (1987) 33-43. G. Schwarz, Annals of
Statistics 6 (1978) 461-464. L. Ljung, *System Identification*, 2nd ed., chapter 16 (1999).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from tridentify.judgement.selection.criteria import Criteria
from tridentify.judgement.selection.paired import ONE_OF_TWO, Unseen, contrasts

POINT = 1.0
"""Held-out fit [percent of the output's size] that is no reason for more coefficients where no
candidate explains the record."""

SLIGHT = 0.02
"""Size of what a larger candidate without a delay predicts besides one with a delay, over the
output's size, that is no reason for it, where no candidate of still more poles says that the order
has ended: poles that stand for dead time are never enough, and follow whatever is small as well."""

USELESS = 0.05
"""Share of the outputs' variance that a smaller candidate may leave unexplained more than the best
and still be of use."""


TWICE, LARGE = 2.0, 0.05
"""Losses of a smaller candidate over the best one's, and their difference [share of the outputs'
variance], from which no scatter excuses what has fewer poles than rise above the noise: of a few
edges in a record hardly anything is significant."""

NOTHING = 1.0
"""Share of the outputs' variance that is left by the mean alone: what leaves as much is sound, and
says nothing."""

FAR_BETTER = 0.5
"""Share that a candidate may leave to be far better than one that leaves as much as the mean."""


@dataclass(frozen=True)
class Contender:
    """What the rule sees of a row; ``known`` says that the record determines its poles."""

    criteria: Criteria
    n_poles: int
    usable: bool
    known: bool = True


def needed(few: Contender, many: Contender) -> float:
    """Fall of ``-2 log L`` that a larger candidate has to bring.

    Parameters
    ----------
    few, many : Contender
        ``many`` has more unknowns.
    """
    d = many.criteria.n_unknowns - few.criteria.n_unknowns
    n = many.criteria.n_samples
    room = max(n - many.criteria.n_unknowns, 1)
    return n * math.log1p(d * math.log(n) / room)


def adequate(rows: Sequence[Contender]) -> list[bool]:
    """Whether nothing larger explains significantly more, row by row."""
    found = []
    for few in rows:
        ok = few.usable
        for many in rows if ok else ():
            if not many.usable or many.criteria.n_unknowns <= few.criteria.n_unknowns:
                continue
            fall = few.criteria.deviance - many.criteria.deviance
            ok = ok and fall <= needed(few, many)
        found.append(ok)
    return found


def choose(rows: Sequence[Contender]) -> int | None:
    """Position of the recommended row; None where no row is usable.

    Examples
    --------
    >>> rows = [Contender(Criteria(k, 500, d), n, True)
    ...         for k, d, n in ((3, 90.0, 1), (5, 10.0, 2), (7, 2.0, 3))]
    >>> choose(rows)
    1
    """
    alike = stand_ins(rows)
    return next((k for k in alike if rows[k].known), alike[0] if alike else None)


def stand_ins(rows: Sequence[Contender]) -> list[int]:
    """The adequate row of fewest unknowns, and after it those that may stand in for it.

    The first of them that is known is the likeliest, or the first where none is.
    """
    kept = [k for k, ok in enumerate(adequate(rows)) if ok]
    kept.sort(key=lambda k: (rows[k].criteria.n_unknowns, rows[k].criteria.deviance))
    return [k for k in kept if _is_alike(rows[k], rows[kept[0]])]


def _is_alike(one: Contender, first: Contender) -> bool:
    """Whether one has as many poles as the other, or as many unknowns and fewer poles."""
    as_many = one.criteria.n_unknowns == first.criteria.n_unknowns
    return one.n_poles == first.n_poles or (as_many and one.n_poles < first.n_poles)


def refuted(rows: Sequence[Contender], orders: Sequence[tuple[int, int] | None]) -> list[bool]:
    """Whether the likelihood refutes that a pole and a zero cancel, row by row.

    Errors of a pole near a zero are those of a straight line through a curved likelihood, and often
    too large. If the two did cancel, the candidate with one pole and one zero less would explain as
    much.

    Parameters
    ----------
    rows : sequence of Contender
    orders : sequence of (poles, zeros) or None
        None where there is more than one of either.

    Examples
    --------
    >>> rows = [Contender(Criteria(k, 500, d), 1, True) for k, d in ((3, 90.0), (5, 10.0))]
    >>> refuted(rows, [(1, 0), (2, 1)])
    [False, True]
    """
    found = []
    for own, order in zip(rows, orders, strict=True):
        less = None if order is None else (order[0] - 1, order[1] - 1)
        lesser = [
            row
            for row, other in zip(rows, orders, strict=True)
            if other is not None and other == less and row.usable and own.usable
        ]
        falls = [row.criteria.deviance - own.criteria.deviance > needed(row, own) for row in lesser]
        found.append(bool(falls) and all(falls))
    return found


def levels_off(rows: Sequence[Contender], likeliest: int | None) -> bool:
    """Whether there are candidates with more poles than the likeliest, which explain no more.

    Then the order is found, however badly the record determines the coefficients. In a world
    without a true order the likelihood goes on to the largest candidate.

    Examples
    --------
    >>> rows = [Contender(Criteria(k, 500, d), n, True)
    ...         for k, d, n in ((3, 90.0, 1), (5, 10.0, 2), (7, 2.0, 3))]
    >>> levels_off(rows, 1), levels_off(rows, 2), levels_off(rows, None)
    (True, False, False)
    """
    if likeliest is None:
        return False
    return any(row.usable and row.n_poles > rows[likeliest].n_poles for row in rows)


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate on samples that it has not seen.

    Attributes
    ----------
    size : int
        Coefficients that are not held, of the channel that has most.
    unseen : Unseen
        Its held-out errors; without any where it has none.
    whitened : Unseen
        The same, whitened by the noise model of the likeliest candidate.
    sound : bool
        Whether nothing speaks against recommending it.
    usable : bool
        Whether it could be recommended if nothing better is there.
    order : (int, int)
        Poles and zeros together, and poles: what is less of two that have as many coefficients and
        predict as well.
    vague : bool
        Whether all that speaks against it is that coefficients are badly known.
    late : bool
        Whether it has a delay of its own.
    misses : bool
        Whether its residual follows the input all the same.
    """

    size: int
    unseen: Unseen
    whitened: Unseen
    sound: bool
    usable: bool
    order: tuple[int, int] = (0, 0)
    vague: bool = False
    late: bool = False
    misses: bool = False


@dataclass(frozen=True)
class Verdict:
    """The recommended row, and what decided.

    Attributes
    ----------
    place : int or None
    best : int or None
        The eligible candidate that predicts held-out samples best.
    by : {"likelihood", "held-out", "size", "slight", "useful", "bent", "none"}
        "size": a further percent would buy the larger ones. "slight": the same of `SLIGHT`, of one
        with a delay. "useful": nothing larger predicts better than a smaller one
        that is not sound. "bent": a non-linearity explains more than further coefficients do.
    sound : bool
        Whether it is sound.
    fair : bool
        Whether it takes fair terms to predict as well as the best: as they are, the best one is
        clearly better.
    instead : (int, str), optional
        The larger one that stood for a non-linearity, and what that is.
    """

    place: int | None
    best: int | None
    by: str
    sound: bool
    fair: bool = False
    instead: tuple[int, str] | None = None


def recommend(
    trials: Sequence[Trial],
    likeliest: int | None,
    *,
    explains: bool,
    sharp: bool,
    ends: bool = True,
    least: int = 0,
    lags: bool = False,
) -> Verdict:
    """Combine likelihood and held-out prediction.

    Parameters
    ----------
    trials : sequence of Trial
    likeliest : int or None
        `choose` of them.
    explains : bool
        Whether it is sound and its residual does not follow the input.
    sharp : bool
        Whether its coefficients are known to where the likelihood is as good as Gaussian.
    ends : bool
        Whether there are larger ones that explain no more (`levels_off`). Where there are none, it
        may be the largest alone that made it the likeliest: it is then believed only if it predicts
        no worse without its noise model as well.
    least : int
        Poles that rise above the noise (`hankel`): candidates with fewer are not as good as the
        best where they leave far more than that (`TWICE`, `LARGE`).
    lags : bool
        Whether a delay beside the poles of the likeliest one explains nothing more.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> e, wave = rng.standard_normal((200, 1)), np.sin(0.3 * np.arange(200))[:, None]
    >>> unseen = [Unseen((one,), ((np.ones((200, 1)),),))
    ...           for one in (0.2 * wave, 0.004 * e, 0.0039 * e)]
    >>> trials = [Trial(2 * k + 2, one, one, True, True) for k, one in enumerate(unseen)]
    >>> recommend(trials, 2, explains=False, sharp=True).place
    1
    """
    judged = _of_any_use(trials)
    eligible = [k for k in judged if trials[k].sound and trials[k].unseen.loss < NOTHING] or judged
    if not eligible:
        by = "none" if likeliest is None else "likelihood"
        return Verdict(likeliest, None, by, likeliest is not None and trials[likeliest].sound)
    best = min(eligible, key=lambda k: trials[k].unseen.loss)
    place, by = _of_held_out(trials, judged, eligible, best, least)
    if likeliest is not None and explains and likeliest in judged:
        one, other = trials[likeliest], trials[place]
        larger = one.size > other.size
        if _is_believed(one, other) and (ends or not larger or _no_worse(one.unseen, other.unseen)):
            place, by = likeliest, "likelihood"
    near, why = [place], by
    if not (explains and sharp):
        near, why = [k for k in judged if _is_near(trials, k, best)], "size"
    elif not ends and not trials[place].late:
        late = [k for k in eligible if trials[k].late and trials[k].size < trials[place].size]
        near = [k for k in late if _apart(trials[k], trials[best]) <= SLIGHT]
        near = [k for k in near if not (lags and _is_refuted(trials[k], trials[best]))]
        why = "slight"
    small = _smallest(trials, [*near, place])
    if _price(trials[small]) < _price(trials[place]):
        place, by = small, why
    fair = not contrasts(trials[place].unseen, trials[best].unseen)[0].as_good
    return Verdict(place, best, by, trials[place].sound, fair)


def _of_any_use(trials: Sequence[Trial]) -> list[int]:
    """Usable candidates with held-out errors, those worse than the mean only where none is good.

    Whitened by a noise model that takes all for noise, the worst of them may look as good as any.
    """
    found = [k for k, one in enumerate(trials) if one.usable and math.isfinite(one.unseen.loss)]
    if min((trials[k].unseen.loss for k in found), default=NOTHING) > FAR_BETTER:
        return found
    return [k for k in found if trials[k].unseen.loss < NOTHING]


def _of_held_out(
    trials: Sequence[Trial], judged: Sequence[int], eligible: Sequence[int], best: int, least: int
) -> tuple[int, str]:
    """The smallest eligible candidate that predicts as well as the best one, and why that one."""
    as_good = [
        k
        for k in judged
        if _as_good(trials[k], trials[best])
        and not (trials[k].order[1] < least and _is_far(trials[k], trials[best]))
    ]
    place = _smallest(trials, [k for k in as_good if k in eligible])
    fewest = trials[_smallest(trials, as_good)].size
    lesser = [
        k for k in eligible if trials[k].size <= fewest and _is_of_use(trials[k], trials[best])
    ]
    if trials[place].size <= fewest:
        return place, "held-out"
    if not lesser:
        # that coefficients are badly known is no reason for more of them
        smaller = (k for k in as_good if trials[k].size < trials[place].size)
        vague = [k for k in smaller if trials[k].vague and _is_of_use(trials[k], trials[best])]
        return _smallest(trials, vague or [place]), "held-out"
    first = min(lesser, key=lambda k: trials[k].unseen.loss)
    return _smallest(trials, [k for k in lesser if _as_good(trials[k], trials[first])]), "useful"


def _smallest(trials: Sequence[Trial], among: Sequence[int]) -> int:
    """The one with fewest coefficients; of as many, with fewest poles of those as good as the best.

    A sound one before one that is not.
    """
    least = min(_price(trials[k]) for k in among)
    alike = sorted(
        (k for k in among if _price(trials[k]) == least), key=lambda k: trials[k].unseen.loss
    )
    near = [k for k in alike if _as_good(trials[k], trials[alike[0]])] or alike[:1]
    return min(near, key=lambda k: trials[k].order)


def _price(trial: Trial) -> tuple[int, bool]:
    return trial.size, not trial.sound


def _as_good(one: Trial, best: Trial) -> bool:
    """Whether a candidate predicts as well as the best: as it is, or on fair terms."""
    return any(contrast.as_good for contrast in contrasts(one.unseen, best.unseen))


def _is_refuted(one: Trial, best: Trial) -> bool:
    """Whether residual and held-out samples both speak against one, however little it leaves."""
    return one.misses and not any(
        contrast.is_within(ONE_OF_TWO) for contrast in contrasts(one.unseen, best.unseen)
    )


def _is_far(one: Trial, best: Trial) -> bool:
    """Whether one leaves far more than another, as they are and on fair terms."""
    return all(
        contrast.own > TWICE * contrast.other and contrast.own - contrast.other > LARGE
        for contrast in contrasts(one.unseen, best.unseen)
    )


def _is_believed(likeliest: Trial, place: Trial) -> bool:
    """Whether what the likelihood says stands before what held-out samples say."""
    if likeliest.size > place.size:
        return _no_worse(likeliest.whitened, place.whitened)
    return _as_good(
        replace(likeliest, unseen=likeliest.whitened), replace(place, unseen=place.whitened)
    )


def _is_of_use(one: Trial, best: Trial) -> bool:
    return one.unseen.loss <= best.unseen.loss + USELESS


def _no_worse(one: Unseen, other: Unseen) -> bool:
    """Whether the losses of one are no larger, as they are and on fair terms."""
    return all(contrast.own <= contrast.other for contrast in contrasts(one, other))


def _is_near(trials: Sequence[Trial], k: int, best: int) -> bool:
    """Whether a candidate is little worse than the best; that it is vague is no reason for more."""
    vague = trials[k].vague and _is_of_use(trials[k], trials[best])
    able = trials[k].sound or vague or k == best
    return able and _points(trials[k], trials[best]) <= POINT


def _points(trial: Trial, best: Trial) -> float:
    """How far the held-out fit lies below the best [percent], less its standard error."""
    return min(contrast.points for contrast in contrasts(trial.unseen, best.unseen))


def _apart(trial: Trial, best: Trial) -> float:
    """Size of what the best predicts besides, over that of the outputs."""
    lost = min(one.own - one.other for one in contrasts(trial.unseen, best.unseen))
    return math.sqrt(max(lost, 0.0))
