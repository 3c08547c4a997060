"""Rows that were lost, without a trace or in gaps of the time stamps: where the state jumps.

Where rows are missing between two samples that seem to follow each other, all that comes after is
the response to the recorded input plus a free response ``c(t) x`` of the model from there on. For
``n`` poles that is ``n`` known columns, the same at every instant but for a shift, so that what all
instants would explain of a residual is a correlation (a matched filter). A single bad sample is
another such column, an impulse, and so is a shock to coloured noise, an impulse of what drives it;
the three are told apart by which of them explains more, largest first, as additive and innovative
outliers are (Tsay 1988; Chen & Liu 1993). The noise jumps too where rows were lost: shocks right
behind a jump are part of it.

References: R. Tsay, J. Forecasting 7 (1988) 1-20. C. Chen & L.-M. Liu, J. American Statistical
Association 88 (1993) 284-297.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import chdtri

from tridentify.errors import TridentifyError
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import Rival, one
from tridentify.numerics.arrays import Array, filled
from tridentify.numerics.autoregression import whiten
from tridentify.numerics.realization import Cascade
from tridentify.numerics.robust import median_scale
from tridentify.record.record import Record

FALSE_ALARM = 1e-4
"""Chance that noise alone shows a jump somewhere in a record."""

MOST = 8
"""Jumps of one record; more are no rows that were lost."""

CLEAR = 0.75
"""Share of the limit that all that is left must stay below: a disturbance that shakes the state now
and then has jumps of every size."""

MOST_SPIKES = 40
"""Single samples that are set aside beside them."""

LEAST_PIECE = 12
"""Samples of a piece: what comes earlier after a cut, or a start, is left in the piece before."""

ROUNDING = 1e-12
"""Over the largest value of an input: what a line between two samples may be off."""

FORGOTTEN = 0.01
"""Share of a free response below which it is over."""


WITHOUT_A_TRACE = (
    "rows that were lost, or what struck from outside there and rang off as the system does,",
    "mend the time stamps from a counter of the recorder; where no rows are missing, record what "
    "struck (a door, a blow) as an input: a cut bends the poles where it rings off otherwise",
    "",
)
"""What it explains, what to do but for a cut, and what it is called beside its code."""

IN_GAPS = (
    "moves of an input within gaps of the time stamps, at instants that were not recorded,",
    "put a row without outputs where the input moved, if that is known from elsewhere",
    "an input moved in a gap of the time stamps",
)
"""The same where the time stamps tell that rows are missing."""


class Place(NamedTuple):
    """Where a state jumps.

    Attributes
    ----------
    experiment : int
    sample : int
        The first one after it.
    """

    experiment: int
    sample: int


def lost_rivals(present: Present, places: Sequence[Place]) -> Iterator[Rival]:
    """The records cut at some places, every piece from an initial state of its own.

    Where all places are gaps of the time stamps, also at those alone over which an input differs.

    Parameters
    ----------
    present : Present
    places : sequence of Place
        From `jumps` or `after_gaps`.
    """
    count = sum(record.n_samples for record in present.records)
    looked_for = 2.0 * float(np.log(count))
    if not set(places) <= set(after_gaps(present.records)):
        yield from _cut(present, places, WITHOUT_A_TRACE, looked_for * len(places))
        return
    moved = []
    for place in places:
        record = present.records[place.experiment]
        if np.any(record.u[place.sample] != record.u[_last_seen(record, place.sample)]):
            moved.append(place)
    if moved:
        yield from _cut(present, moved, IN_GAPS, 0.0)
    others = len(places) - len(moved)
    if 0 < others <= MOST * len(present.records):
        # an input may have moved there and back
        yield from _cut(present, places, IN_GAPS, looked_for * others)


def _cut(
    present: Present, places: Sequence[Place], words: tuple[str, str, str], price: float
) -> Iterator[Rival]:
    pieces: list[Record] = []
    times: list[float] = []
    # a gap is there: a piece beside it needs more samples than state, offset and drift take
    least = present.poles.size + 3 if words is IN_GAPS else LEAST_PIECE
    for e, record in enumerate(present.records):
        own, left = [place.sample for place in places if place.experiment == e], record
        for k in _apart(own, record, least):
            at = float(record.t[k])
            try:
                first, left = left.split(at)
            except TridentifyError:
                # a band-limited input takes longer pieces
                return
            pieces.append(first)
            times.append(at)
        pieces.append(left)
    if not times:
        return
    freed = replace(present.nuisances, initial_state="free")
    cut = replace(present, records=tuple(pieces), nuisances=freed)
    what, otherwise, headline = words
    advice = (
        "Cut the record there (record.split, or a --range for each part) and identify the parts "
        f"together, or {otherwise}."
    )
    found = one("lost-rows", cut, what, advice)
    yield replace(found, price=price, times=tuple(times), headline=headline)


def after_gaps(records: Sequence[Record]) -> list[Place]:
    """First samples after gaps of the time stamps.

    Parameters
    ----------
    records : sequence of Record
        With the rows that are missing put back, without outputs and with the input that lay there.
    """
    found = []
    for e, record in enumerate(records):
        gone = np.isnan(record.y).all(axis=1).astype(int)
        ends = np.flatnonzero(np.diff(gone) < 0) + 1
        found += [Place(e, int(k)) for k in ends if _is_filled(record, int(k))]
    return found


def _is_filled(record: Record, after: int) -> bool:
    """Whether the input before a sample is made up: it was recorded where it lies elsewhere."""
    first = _last_seen(record, after)
    part = np.arange(1, after - first)[:, None] / (after - first)
    before, then = record.u[first], record.u[after]
    line = before + part * (then - before) * (record.behaviour != "zoh")
    rounding = ROUNDING * float(np.max(np.abs(record.u)))
    return bool(np.allclose(record.u[first + 1 : after], line, rtol=0.0, atol=rounding))


def _last_seen(record: Record, after: int) -> int:
    """The sample before a gap; the first one of the record where none was seen."""
    seen = np.isfinite(record.y[:after]).any(axis=1)
    return int(np.flatnonzero(seen)[-1]) if seen.any() else 0


def _apart(places: Sequence[int], record: Record, least: int) -> list[int]:
    """Those that leave pieces that are long enough, of samples that were recorded."""
    kept: list[int] = []
    so_far = np.append(0, np.cumsum(np.isfinite(record.y).any(axis=1)))
    for k in sorted(places):
        before = so_far[kept[-1]] if kept else 0
        if min(so_far[k] - before, so_far[-1] - so_far[k]) >= least:
            kept.append(k)
    return kept


class _Template(NamedTuple):
    """Of one output, whitened: free responses from a sample on, an impulse, a shock."""

    free: Array
    spike: Array
    shock: Array


def jumps(
    residuals: Sequence[Array], banks: Sequence[Cascade], noise: Sequence[Array], step: float
) -> list[Place]:
    """Instants at which a free response begins that noise does not explain.

    Parameters
    ----------
    residuals : sequence of (n_samples, n_outputs) arrays
        Per experiment, not whitened; ``nan`` where a sample is missing.
    banks : sequence of Cascade
        Poles of every denominator once.
    noise : sequence of (p,) arrays
        Of every output, what whitens it.
    step : float
        Sampling interval [s].

    Returns
    -------
    list of Place
        In time; empty where there are more than noise and lost rows would make.
    """
    most = max(one.shape[0] for one in residuals)
    free = _free_responses(banks, step, most)
    templates = [_template(free, a) for a in noise]
    found: list[Place] = []
    for e, residual in enumerate(residuals):
        white, size = [], []
        for i, a in enumerate(noise):
            own = whiten(np.ascontiguousarray(residual[:, i]), a)[0]
            seen = own[np.isfinite(own)]
            scale = median_scale(seen) if seen.size else 0.0
            white.append(filled(own) / scale if scale > 0 else np.zeros(own.size))
            size.append(scale)
        if max(size) > 0:
            found += [Place(e, k) for k in _places(np.stack(white, axis=1), templates)]
    return found if len(found) <= MOST * len(residuals) else []


def _free_responses(banks: Sequence[Cascade], step: float, most: int) -> Array:
    """(length, n) the responses of every state to an impulse, until they are over."""
    from tridentify.numerics.kernels.exponentials import discrete

    columns = []
    slowest = min(float(np.min(-bank.poles.real)) for bank in banks)
    length = most
    if slowest > 0:
        length = min(most, int(np.ceil(-np.log(FORGOTTEN) / (slowest * step))) + 2)
    for bank in banks:
        move = discrete(bank.a, bank.b, step, False)[0]
        states = np.empty((length, bank.order))
        states[0] = bank.b
        known = 1
        while known < length:
            # as many again, all at once
            more = min(known, length - known)
            states[known : known + more] = states[:more] @ move.T
            known, move = known + more, move @ move
        columns.append(states)
    return np.hstack(columns)


def _template(free: Array, a: Array) -> _Template:
    taps = np.concatenate([[1.0], a])
    columns = free
    if a.size:
        columns = np.array([np.convolve(taps, one)[: one.size] for one in free.T]).T
    u, s, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    return _Template(u[:, s > 1e-6 * s[0]], taps / np.linalg.norm(taps), np.ones(1))


def _places(white: Array, templates: Sequence[_Template]) -> list[int]:
    """Samples of one experiment at which jumps begin, the largest taken out first.

    None where single samples are more, or where what is left has others nearly as large.
    """
    left, n = white.copy(), white.shape[0]
    dimension = sum(one.free.shape[1] for one in templates)
    memory = max(one.spike.size for one in templates)
    far = float(chdtri(dimension, FALSE_ALARM / n))
    far_alone = float(chdtri(1, FALSE_ALARM / n))
    found: list[int] = []
    singles: list[int] = []
    matched = [_Matched.of(own, n) for own in templates]
    for _ in range(MOST + MOST_SPIKES):
        jump, alone = np.zeros(n), []
        for i, spectra in enumerate(matched):
            squares = spectra.along(left[:, i]) ** 2
            jump += squares[:-2].sum(axis=0)
            alone += [squares[-2], squares[-1]]
        jump[:1] = 0.0
        which = int(np.argmax([one.max() for one in alone]))
        over_jump, over_alone = jump.max() - far, alone[which].max() - far_alone
        if max(over_jump, over_alone) <= 0:
            others = [k for k in singles if not any(0 <= k - one < memory for one in found)]
            apart = jump.max() < CLEAR * far
            return sorted(found) if apart and len(found) >= len(others) else []
        if over_jump >= over_alone:
            found.append(int(np.argmax(jump)))
            for i, own in enumerate(templates):
                _take_out(left[:, i], own.free, found[-1])
        else:
            i, kind = divmod(which, 2)
            singles.append(int(np.argmax(alone[which])))
            column = templates[i].shock if kind else templates[i].spike
            _take_out(left[:, i], column[:, None], singles[-1])
    return []


class _Matched(NamedTuple):
    """Spectra of the columns of a template: its free responses, the impulse and the shock."""

    length: int
    spectra: NDArray[np.complex128]

    @classmethod
    def of(cls, template: _Template, n: int) -> _Matched:
        """For series of ``n`` samples."""
        alone = (template.spike, template.shock)
        longest = max(template.free.shape[0], template.spike.size)
        columns = np.zeros((template.free.shape[1] + len(alone), longest))
        columns[: -len(alone), : template.free.shape[0]] = template.free.T
        for row, column in zip(columns[-len(alone) :], alone, strict=True):
            row[: column.size] = column
        # not from scipy.signal, whose import takes longer than the whole look
        length = next_fast_len(n + longest - 1, real=True)
        return cls(length, rfft(columns, length).conj())

    def along(self, series: Array) -> Array:
        """Products of every column with a series, for each sample that it may begin at."""
        product = irfft(rfft(series, self.length) * self.spectra, self.length)
        return np.asarray(product[:, : series.size])


def _take_out(series: Array, columns: Array, at: int) -> None:
    """Leave nothing of a series along columns that begin at a sample."""
    length = min(columns.shape[0], series.size - at)
    own = series[at : at + length]
    q = np.linalg.qr(columns[:length])[0]
    own -= q @ (q.T @ own)
