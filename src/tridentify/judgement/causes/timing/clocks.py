"""Channels whose clocks run apart: outputs that come ever later, or ever earlier, than their input.

What acted is the recorded input moved in time by a straight line, ``u(t - d - r t)``. The response
to it is the fitted output moved likewise, so that ``r`` is read off what the output leaves against
its own derivative times time, which hardly any other coefficient resembles; the input is moved and
the model fitted, and so on from there. Where the line passes through the middle of the record is a
delay, or an advance, that is tried at some values.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tridentify.judgement.causes.attempts.attempt import Attempt
from tridentify.judgement.causes.attempts.intersample import is_staircase
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import LONG_ENOUGH, Rival, one
from tridentify.judgement.causes.timing.shifts import moved_input, quickly_fitted
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import whiten

FURTHEST = 5.0
"""Samples by which an output may come early; more is seen in a plot."""

ROUNDS = 3
"""Fits and lines in turn: the first model has taken part of the line for its own."""

NEAR = 0.25
"""Samples to either side of where the line passes the middle of the record, then half of that."""

PRICE = 2.0 * 2.0
"""Two unknowns, as in AIC."""

TOGETHER = 0.15
"""Samples by which the clocks may differ at the start to count as started together."""


def clock_rivals(present: Present) -> Iterator[Rival]:
    """Outputs on a clock that runs faster or slower than that of the inputs.

    Parameters
    ----------
    present : Present
    """
    if len(present.records) > 1 or present.records[0].dt is None:
        return
    # where every sample moves, what is late by a time of its own follows any other misfit too
    if not is_staircase(present.records) or present.records[0].n_samples < 2 * LONG_ENOUGH:
        return
    end = quickly_fitted(present, present.poles)
    if end is None:
        return
    line = _Line(present)
    rate = _more(end, present)
    middle = 0.5 * rate
    for k in range(ROUNDS):
        if not abs(rate) <= 2.0 * FURTHEST:
            return
        width = NEAR * 0.5**k
        middle, best = line.nearby(middle, rate, width, end)
        if best is None:
            return
        end = best
        rate += _more(end, line.part(middle, rate))
    best = line.at(middle, rate, end)
    if best is None or not abs(rate) <= 2.0 * FURTHEST:
        return
    yield line.rival(middle, rate, best)


class _Line:
    """The present explanation with its inputs moved along lines."""

    def __init__(self, present: Present) -> None:
        self.present = present
        (self.record,) = present.records

    def late(self, middle: float, rate: float) -> Array:
        """[samples] at every sample; ``rate`` is over the whole record."""
        n = self.record.n_samples
        return np.asarray(middle + rate * (np.arange(n) / n - 0.5))

    def part(self, middle: float, rate: float) -> Present:
        late = self.late(middle, rate)
        y = np.array(self.record.y)
        y[: max(int(np.ceil(late.max())), 0)] = np.nan
        y[self.record.n_samples - max(int(np.ceil(-late.min())), 0) :] = np.nan
        moved = moved_input(self.record, late)._derive(y=y)
        return replace(self.present, records=(moved,))

    def at(self, middle: float, rate: float, near: Attempt) -> Attempt | None:
        return quickly_fitted(self.part(middle, rate), near.point.poles)

    def nearby(
        self, middle: float, rate: float, width: float, near: Attempt
    ) -> tuple[float, Attempt | None]:
        """The top of a parabola through the likelihoods of three middles, and the fit there."""
        places = [middle - width, middle, middle + width]
        ends = [self.at(place, rate, near) for place in places]
        if any(end is None for end in ends):
            return middle, None
        low, here, high = (end.deviance / end.count for end in ends if end is not None)
        bend = low - 2.0 * here + high
        step = 0.5 * width * (low - high) / bend if bend > 0.0 else 0.0
        best = middle + float(np.clip(step, -4.0 * width, 4.0 * width))
        return best, self.at(best, rate, near)

    def rival(self, middle: float, rate: float, end: Attempt) -> Rival:
        late = self.late(middle, rate)
        n, dt = late.size, self.present.step
        faster = 1e6 * rate / n
        first, last = (f"{abs(d) * dt:.3g} s {'late' if d > 0 else 'early'}" for d in late[[0, -1]])
        what = (
            f"clocks of inputs and outputs that differ by about {_two_digits(faster)} ppm (outputs "
            f"{first} at the start and {last} at the end of the record)"
        )
        step = dt * (1.0 - rate / n)
        start = -float(late[0])
        begun = max(int(np.ceil(-start - TOGETHER)), 0)
        start = (start + begun) * dt if abs(start) > TOGETHER else 0.0
        # an output after the last input is none that from_rates takes
        last_one = begun + int(((n - 1) * dt - start) / step) + 1
        ends = f"{last_one}" if last_one < n else ""
        own = f"y[{begun or ''}:{ends}]" if begun or ends else "y"
        when = f", y_start={start:.4g}" if start > 0.0 else ""
        advice = (
            "Give the outputs times of their own, those of the inputs' clock (Record.from_rates(u, "
            f"{own}, u_dt={dt:.6g}, y_dt={step:.9g}{when})); "
            "the difference is known to about a tenth, so keep of the steps near it the one that "
            "fits best. Record all channels on one clock."
        )
        found = one("varying", self.part(middle, rate), what, advice)
        return replace(
            found,
            starts=((end.point.poles,),),
            price=PRICE,
            exact=True,
            headline="the clocks of the channels run apart",
            kind="clocks",
        )


def _more(end: Attempt, part: Present) -> float:
    """How much later the inputs act at the end than at the start, by what the outputs leave."""
    (record,) = part.records
    noise = end.point.problem.noise
    n = record.n_samples
    time = np.arange(n) / n - 0.5
    top, below = 0.0, 0.0
    for i, f in enumerate(end.point.outputs()[0].T):
        a = noise[i] if noise else np.zeros(0)
        whole = np.nan_to_num(f, nan=float(np.nanmean(f)))
        later = -np.gradient(whole)
        series = [end.residuals()[0][:, i], later, later * time]
        left, once, slope = (np.nan_to_num(_whitened(one, a)) for one in series)
        matrix = np.column_stack([once, slope])
        size = max(float(np.mean(left**2)), np.finfo(float).tiny)
        own = matrix.T @ matrix / size
        known = own[1, 1] - own[0, 1] ** 2 / own[0, 0] if own[0, 0] > 0.0 else 0.0
        if known > 0.0:
            top += known * float(np.linalg.lstsq(matrix, left)[0][1])
            below += known
    return top / below if below > 0.0 else 0.0


def _two_digits(value: float) -> str:
    """The size of a number, to two digits and without an exponent.

    Examples
    --------
    >>> _two_digits(-512.3), _two_digits(0.0123)
    ('510', '0.012')
    """
    return f"{float(f'{abs(value):.2g}'):.10g}"


def _whitened(series: Array, a: Array) -> Array:
    return whiten(np.ascontiguousarray(series), a)[0] if a.size else series
