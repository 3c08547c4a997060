"""Which of several experiments differs from the others, and in what.

Where coefficients of their own explain several experiments better, one of them may be the odd one:
each is taken out in turn, with coefficients of its own, and the others keep theirs in common. What
differs may be less than all coefficients: the sign of a channel, its gain, or its clock. These are
fitted with all coefficients in common; gain and delay where a parabola through the likelihood has
its top, whose bend gives their standard error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.likelihood.cost import evaluate
from tridentify.judgement.causes.attempts.attempt import Attempt, attempt
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import DISAGREEING, Rival
from tridentify.judgement.causes.timing.shifts import moved_input
from tridentify.models.response import Response
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record

MOST = 12
"""Experiments up to which the odd one is looked for: each costs a fit of all the others."""
STEPS = 10
"""Levenberg-Marquardt steps of every fit along a parabola."""
TURNS = 5
"""Parabolas, each about the top of the one before."""
SHARE = 0.02
"""Of a gain, to either side of it."""
PART = 0.2
"""Of a sample, to either side of a delay."""
SETTLED = 0.05
"""Of these, below which a top has settled."""
SAMPLES = (-8.0, -4.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Delays of one experiment that are tried first [samples]."""
CERTAIN = 4.0
"""Standard errors from which a gain is another one."""
WRONG = 1.5
"""Gain from which coefficients of all experiments together are those of none."""


def apart_rivals(present: Present, alone: Sequence[Attempt]) -> Iterator[Rival]:
    """Each experiment with coefficients of its own, and the others together.

    Parameters
    ----------
    present : Present
        Of three experiments or more.
    alone : sequence of Attempt
        Each experiment by itself.
    """
    for e, record in enumerate(present.records):
        others = tuple(one for k, one in enumerate(present.records) if k != e)
        starts = tuple(end.point.poles for k, end in enumerate(alone) if k != e)
        yield Rival(
            DISAGREEING,
            (replace(present, records=others), replace(present, records=(record,))),
            ((*starts, present.poles), (alone[e].point.poles,)),
            f"coefficients of its own in experiment {e + 1}",
            f"Look at what was another one in experiment {e + 1} (load, speed, set-up), and "
            "identify it on its own.",
            refits=False,
            headline=f"experiment {e + 1} is not of the system of the others",
            experiment=e,
        )


def single_rivals(present: Present, e: int, others: Attempt) -> Iterator[Rival]:
    """One experiment with another sign, another gain or another clock, all else in common.

    Parameters
    ----------
    present : Present
    e : int
        Which experiment.
    others : Attempt
        What the others say.
    """
    one = _One(present, e, others)
    first = present.records[0]
    n_inputs, n_outputs = first.n_inputs, first.n_outputs
    paths = [(True, j) for j in range(n_inputs)]
    paths += [(False, i) for i in range(n_outputs)] if n_outputs > 1 else []
    for path in paths:
        found = one.gain(*path)
        if found is not None:
            yield found
    late = one.delay()
    if late is not None:
        yield late


@dataclass(frozen=True, eq=False)
class _One:
    """One experiment beside what the others say."""

    present: Present
    e: int
    others: Attempt

    @property
    def _record(self) -> Record:
        return self.present.records[self.e]

    @property
    def _pair(self) -> bool:
        return len(self.present.records) == 2

    @property
    def _than(self) -> str:
        return f"experiment {2 - self.e}" if self._pair else "the others"

    def _with(self, record: Record) -> Present:
        records = list(self.present.records)
        records[self.e] = record
        return replace(self.present, records=tuple(records))

    def _end(self, part: Present) -> Attempt | None:
        starts = [self.others.point.poles, self.present.poles]
        try:
            return attempt(part.problem(), starts, part.orders, steps=STEPS, rounds=0)
        except TridentifyError:
            return None

    def gain(self, of_input: bool, channel: int) -> Rival | None:
        """Another gain of one channel, or its sign where that is all."""
        scaled = self._scaled_input if of_input else self._scaled_output
        count = float(np.sum(np.isfinite(self._record.y[:, channel]))) if not of_input else 0.0
        ends: dict[float, Attempt] = {}

        def at(gain: float) -> float:
            end = None if gain == 0.0 else self._end(self._with(scaled(channel, gain)))
            if end is None:
                return np.inf
            ends[gain] = end
            return end.deviance + 2.0 * count * float(np.log(abs(gain)))

        start = self._share(of_input, channel)
        top = _top(at, start, SHARE * abs(start))
        if top is None:
            return None
        gain, std = top
        plain = abs(abs(gain) - 1.0) < CERTAIN * std
        if plain and gain > 0:
            return None
        gain = -1.0 if plain else gain
        if gain not in ends and not np.isfinite(at(gain)):
            return None
        price = 2.0 * count * float(np.log(abs(gain))) + (0.0 if plain else 2.0)
        number, opposite = self.e + 1, gain < 0
        names = self._record.input_names if of_input else self._record.output_names
        alone = self._record.n_inputs == 1 if of_input else False
        of = "" if alone else f" of {names[channel]}"
        times = f"{rounded(gain, std)} times that of {self._than}"
        if plain:
            what = f"the opposite sign{of} in experiment {number}"
            do = f"Look which sensor was reversed in experiment {number}"
            do += ", or in the other one" if self._pair else ""
            do += ", change the sign of that channel there, and identify again."
        else:
            what = f"a gain{of} of {times} in experiment {number}"
            do = f"Look at the units and the gains of the sensors of experiment {number}, and of "
            do += "what was set up there; with the channel put right identify again."
        answers = f"experiment {number} answers with the opposite sign"
        return replace(
            self._rival(self._with(scaled(channel, gain)), ends[gain]),
            what=what,
            advice=do,
            price=price,
            headline=f"{answers}{of} to {self._than}"
            if opposite
            else f"experiment {number} answers with another gain{of} than {self._than}",
            kind="opposite" if opposite else "gain",
            spoils=opposite or not 1.0 / WRONG < gain < WRONG,
        )

    def delay(self) -> Rival | None:
        """All inputs later, or earlier."""
        if self._record.dt is None:
            return None
        ends: dict[float, Attempt] = {}

        def at(samples: float) -> float:
            if samples not in ends:
                end = self._end(self._with(self._late(samples)))
                if end is None:
                    return np.inf
                ends[samples] = end
            return ends[samples].deviance

        tried = [one for one in SAMPLES if abs(one) < self._record.n_samples / 4]
        start = min(tried, key=at, default=0.0)
        top = _top(at, start, PART) if np.isfinite(at(start)) else None
        if top is None or abs(top[0]) < CERTAIN * top[1]:
            return None
        samples, std = top
        if not np.isfinite(at(samples)):
            return None
        number, step = self.e + 1, self.present.step
        way = "later" if samples > 0 else "earlier"
        by = f"{rounded(abs(samples) * step, std * step)} s"
        return replace(
            self._rival(self._with(self._late(samples)), ends[samples]),
            what=f"an answer {way} by {by} in experiment {number}",
            advice=f"Look at the clocks of the channels of experiment {number}, and at what may be "
            "late there; with the times of that channel put right identify again.",
            price=2.0,
            headline=f"experiment {number} answers {way} than {self._than}",
            kind="late",
        )

    def _rival(self, part: Present, end: Attempt) -> Rival:
        return Rival(
            DISAGREEING,
            (part,),
            ((end.point.poles, self.present.poles),),
            "",
            "",
            experiment=None if self._pair else self.e,
        )

    def _late(self, samples: float) -> Record:
        return moved_input(self._record, np.full(self._record.n_samples, samples))

    def _scaled_input(self, j: int, gain: float) -> Record:
        u = np.array(self._record.u)
        u[:, j] *= gain
        return self._record._derive(u=u)

    def _scaled_output(self, i: int, gain: float) -> Record:
        y = np.array(self._record.y)
        y[:, i] /= gain
        return self._record._derive(y=y)

    def _share(self, of_input: bool, channel: int) -> float:
        """The gain of a channel by what the others' model makes of this experiment."""
        record = self._record
        try:
            whole = self._driven(record)
            part = whole
            if of_input and record.n_inputs > 1:
                u = np.array(record.u)
                u[:, channel] = 0.0
                part = whole - self._driven(record._derive(u=u))
        except (TridentifyError, np.linalg.LinAlgError, FloatingPointError):
            return 1.0
        outputs = range(record.n_outputs) if of_input else (channel,)
        over, under = 0.0, 0.0
        for i in outputs:
            seen = np.isfinite(record.y[:, i]) & np.isfinite(whole[:, i])
            moves = [part[seen, i], (whole - part)[seen, i], record.y[seen, i]]
            f, rest, y = (each - each.mean() for each in moves)
            size = float(y @ y) or 1.0
            over += float(f @ (y - rest)) / size
            under += float(f @ f) / size
        share = over / under if under > 0 else 1.0
        return share if np.isfinite(share) and share != 0.0 else 1.0

    def _driven(self, record: Record) -> Array:
        """(n_samples, n_outputs) what the model of the others makes of inputs."""
        own = replace(self.present, records=(record,), noise=())
        known = self.others.point
        point = evaluate(own.problem(), known.poles)
        free = np.zeros_like(point.response.free)
        rows = Response(known.response.rows, known.response.direct, free)
        return np.asarray(point.answering(rows).outputs()[0])


def rounded(value: float, std: float) -> str:
    """A number and its standard error, as far as that tells it.

    Examples
    --------
    >>> rounded(1.1, 0.0072), rounded(57.3, 12.0), rounded(0.05, 0.0)
    ('1.100 +- 0.007', '60 +- 10', '0.05 +- 0')
    """
    if not std > 0.0:
        return f"{value:.3g} +- 0"
    digits = -int(np.floor(np.log10(std)))
    if digits <= 0:
        return f"{round(value, digits):.0f} +- {round(std, digits):.0f}"
    return f"{value:.{digits}f} +- {std:.{digits}f}"


def _top(at: Callable[[float], float], start: float, width: float) -> tuple[float, float] | None:
    """Where ``-2 log L`` is least, and the standard error; None where it has no least value.

    Examples
    --------
    >>> top = _top(lambda x: 100.0 * (x - 1.3) ** 2, 1.0, 0.1)
    >>> [round(each, 3) for each in top]
    [1.3, 0.1]
    """
    x, bend = start, 0.0
    for _ in range(TURNS):
        below, here, above = at(x - width), at(x), at(x + width)
        if not np.all(np.isfinite([below, here, above])):
            return None
        bend = below - 2.0 * here + above
        if bend > 0.0:
            step = float(np.clip(0.5 * width * (below - above) / bend, -3.0 * width, 3.0 * width))
        else:
            step = 3.0 * width if above < below else -3.0 * width
        x += step
        if abs(step) < SETTLED * width:
            break
    return (x, width * float(np.sqrt(2.0 / bend))) if bend > 0.0 else None
