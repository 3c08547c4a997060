"""A direct part of the response: outputs that follow an input at the very sample at which it moves.

A strictly proper system answers a jump of its input by a slope. One with as many zeros as poles (a
resistance beside its cells, a force measured as an acceleration, a signal path around a filter)
follows it in the same sample and in proportion, and no number of poles without that part stands for
it. Two signs of it are looked for.

*Jumps* of an input that stand alone, and an output that jumps with them, need no model at all.

*The response at once*, where the input moves at every sample: of the regression

    y(k) = h_0 u(k) + h_1 u(k-1) + ... + later inputs, operators of the input before these, offset

whitened by an autoregression (`attempts.parallel`). Of an input that is held, ``h_0`` is the direct
part. One that moves between its samples makes a response at once in any system: half of that one
sample later where it begins with a slope, less where it begins with a curvature. So ``h_0`` counts
by what it is larger than ``h_1``, which takes a lag shorter than a sampling interval without a
direct part; such a lag is one, at that sampling.

*The likelihood*, where the inputs are not held and their past foretells them (multisines, sweeps).
Such an input hardly changes from one sample to the next, and ``h_0`` and ``h_1`` are not told
apart; but a response as a whole is: operators with the inputs beside them against operators alone,
each on their best poles, with the input held or joined by lines, whichever is likelier. Operators
miss most of a resonance, which a direct part would make up for, so they are tried where the
measured response is largest as well. A mode above the band of a smooth input is a direct part as
far as such a record goes.

A controller makes a response at once too: it moves the input by what the noise at the sensor is
worth. It does so in small moves alone (`signals.surprises`); the jumps of its reference, which the
plant has to follow later, tell it from a direct part.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import TridentifyError
from tridentify.judgement.causes.attempts.first_samples import beginning
from tridentify.judgement.causes.attempts.intersample import is_staircase
from tridentify.judgement.causes.attempts.parallel import Parallel, WhitenedFit, with_noise_model
from tridentify.judgement.causes.signals.surprises import moved, small_surprises
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import Whitener
from tridentify.numerics.interpolation import FEWEST
from tridentify.numerics.least_squares import column_norms
from tridentify.numerics.robust import median_scale
from tridentify.record.checks.samples import Behaviour
from tridentify.record.record import Record

FEWEST_JUMPS = 4
"""Jumps of an input that have to agree: two or three do so by chance too often."""

IN_PROPORTION = 0.9
"""Share of the outputs' jumps that those of the inputs explain."""

STANDS_OUT = 10.0
"""Step in usual ones from which it is no noise: Gaussian noise makes none."""

ALONE = 3.0
"""Step over those before and after it from which it is a jump and not a part of a slope."""

DENSE = 3
"""Past inputs that have a column each [samples]; the operators begin after these."""

BEFORE = (4, 5, 6, 8, 12, 16, 24, 32)
"""Further past inputs, for what the operators miss of a resonance [samples]."""

LONGEST = 4_000
"""Samples of each record that are looked at: more would not change a clear answer."""

PER_COLUMN = 4
"""Samples for each column at least."""

AT_ONCE = 5.0
"""Standard errors from which a response at once is one: a structure more is tried for it, and it is
asked of every output and input."""

CONTRADICTED = 3.5
"""Standard errors by which small moves may say something else than all others."""

ANSWERED = 8.0
"""Standard errors from which an output goes along with small moves of a smooth input: what a sensor
adds to an input moves no output, little else of a sweep is unforeseen, and the noise that a
controller passes on at once shows in tens and hundreds."""

SHARED = 0.5
"""Share of the response to small moves that the others have to show: behind a controller they have
next to none, but a misfit of the plant is significant in a long record."""

LIKELIER = 50.0
"""Fall of AICc, for a direct part beside operators, from which a smooth input tells it: operators
are never quite the plant. Of 210 strictly proper plants, 80 of them with a second mode, it was
above 25 for six, and above 50 for one, whose second mode lay above the band of the input."""

FORESEEN = 0.01
"""Size of what the past of an input does not tell, over its spread, up to which no controller made
it: noise at a sensor is not foreseen. Of multisines it was 0.001, of loops 0.03 and more."""

BESIDE = (1.0, 0.4, 2.5)
"""Resonances that are tried, over the frequency at which the response is largest."""

SMOOTHED = 5
"""Neighbouring frequencies whose spectra are averaged to find where a response is largest."""

SEEN = 1e-3
"""Power of an input over its largest, below which a frequency says nothing of the response."""

CUTOFF = 1e-9
"""Singular value over the largest below which a column tells nothing new."""


def has_direct_part(records: Sequence[Record]) -> bool:
    """Whether some output follows an input in the same sample and in proportion to it.

    Parameters
    ----------
    records : sequence of Record

    Returns
    -------
    bool
        False too where the inputs are so smooth that they cannot tell.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> u = np.repeat(rng.choice([-1.0, 0.0, 2.0], 20), 10)
    >>> y = 0.5 * u + 0.01 * rng.standard_normal(200)
    >>> has_direct_part([Record(u, y, dt=1.0)])
    True
    >>> has_direct_part([Record(u, 0.01 * np.cumsum(u) + 0.5 * y, dt=1.0).slice(0.0, 30.0)])
    False

    An accelerometer on what is shaken:

    >>> from tridentify import TransferFunction, simulate
    >>> u = rng.standard_normal(400)
    >>> shaken = Record(u, u, dt=0.05)
    >>> at_rest = simulate(TransferFunction([1.0, 0.0, 0.0], [1.0, 0.4, 9.0]), shaken)[:, 0]
    >>> has_direct_part([Record(u, at_rest + 0.1 * rng.standard_normal(400), dt=0.05)])
    True
    """
    jumps = any(
        follows_at_once(record.u[:, j], record.y[:, i])
        for record in records
        for j in range(record.n_inputs)
        for i in range(record.n_outputs)
    )
    return jumps or _responds_at_once(records)


def _responds_at_once(records: Sequence[Record]) -> bool:
    """Whether some output has a response at once that no controller makes."""
    if any(record.dt is None for record in records):
        return False
    parts = [beginning(record, LONGEST) for record in records]
    return any(_output_responds(parts, i) for i in range(records[0].n_outputs))


def _moves_alone(records: Sequence[Record]) -> bool:
    """Whether inputs are stated as held, or move in single samples: a slope is joined by lines."""
    if all(record.intersample == "zoh" for record in records):
        return True
    moves = [np.any(np.diff(record.u, axis=0) != 0.0, axis=1) for record in records]
    alone = sum(int(np.sum(one[1:-1] & ~one[:-2] & ~one[2:])) for one in moves)
    return 2 * alone > sum(int(np.sum(one[1:-1])) for one in moves)


def _output_responds(records: Sequence[Record], output: int) -> bool:
    held = is_staircase(records) and _moves_alone(records)
    try:
        parallel, fit = _bank(records, output, held)
        surprises = small_surprises(records)
        matrix, target = _columns(parallel, fit, surprises)
    except (TridentifyError, np.linalg.LinAlgError, ValueError):
        return False
    if target.size < PER_COLUMN * matrix.shape[1]:
        return False
    n = records[0].n_inputs
    moves = slice((DENSE + 1) * n, (DENSE + 2) * n)
    whole, errors = _solved(matrix, target)
    rest = np.delete(matrix, np.arange(matrix.shape[1])[moves], axis=1)
    plain, covariance = _solved(rest, target)
    for j in range(n):
        at_once, later = plain[j], plain[n + j]
        if not np.isfinite(at_once) or at_once == 0.0:
            continue
        weights = np.zeros(plain.size)
        weights[j] = np.sign(at_once)
        if not held and at_once * later > 0:
            weights[n + j] = -weights[j]
        if weights @ plain < AT_ONCE * _size(weights, covariance):
            continue
        if not _is_a_controller(whole, errors, j, moves.start + j):
            return True
    known = any(record.behaviour == "zoh" for record in records)
    if known or _is_answered(matrix, target, surprises, records):
        return False
    return _is_likelier(records, output)


def _is_answered(
    matrix: Array, target: Array, surprises: Sequence[Array], records: Sequence[Record]
) -> bool:
    """Whether an output goes along with small moves of a smooth input, as behind a controller."""
    sizes = np.std(np.vstack(surprises), axis=0)
    usual = np.std(np.vstack([record.u for record in records]), axis=0)
    for j in np.flatnonzero(sizes > FORESEEN * usual):
        # without the whole moves, which the past of a smooth input tells, the small ones answer
        found, root = _solved(np.delete(matrix, j, axis=1), target)
        if _stands_out(found, root, (DENSE + 1) * usual.size + int(j) - 1, ANSWERED):
            return True
    return False


def may_have_direct_part(records: Sequence[Record]) -> bool:
    """Whether the inputs are smooth and no controller made them, so that only models can tell.

    Parameters
    ----------
    records : sequence of Record
    """
    if any(record.dt is None or record.behaviour == "zoh" for record in records):
        return False
    parts = [beginning(record, LONGEST) for record in records]
    surprises = small_surprises(parts)
    try:
        return not any(
            _is_answered(*_columns(*_bank(parts, i, False), surprises), surprises, parts)
            for i in range(records[0].n_outputs)
        )
    except (TridentifyError, np.linalg.LinAlgError, ValueError):
        return False


def _is_likelier(records: Sequence[Record], output: int) -> bool:
    """Whether a direct part beside operators is clearly likelier than operators alone."""
    if not _falls(records, output, (0.0,), 0.0):
        return False
    top = _largest_response(records, output)
    # a second mode is missed as well, and a direct part would make up for it
    return _falls(records, output, [top * ratio for ratio in BESIDE], LIKELIER)


def _falls(
    records: Sequence[Record], output: int, resonances: Sequence[float], least: float
) -> bool:
    """Whether AICc falls by more with a direct part, whatever an input may do and resonates."""

    def criteria(options: Sequence[Behaviour], direct: bool) -> Iterator[float]:
        for one in options:
            between = [record.between(one) for record in records]
            for resonance in resonances:
                way = Parallel.of(between, output, resonance, direct=direct)
                yield with_noise_model(way)[1].criterion

    whole = all(record.n_samples >= FEWEST for record in records)
    smooth: tuple[Behaviour, ...] = ("band-limited",) if whole else ()
    lowest = min(criteria(("zoh", "foh"), True))
    return all(own - lowest > least for own in criteria(("foh", *smooth, "zoh"), False))


def _largest_response(records: Sequence[Record], output: int) -> float:
    """Frequency at which the response to the inputs is largest [rad/s], roughly."""
    record = max(records, key=lambda one: one.n_samples)
    window = np.hanning(record.n_samples)
    y = record.y[:, output]
    left = np.nan_to_num(y - np.nanmean(y)) * window
    moved_by = (record.u - record.u.mean(axis=0)) * window[:, None]
    answer, cause = np.fft.rfft(left), np.fft.rfft(moved_by, axis=0)
    mean = np.full(SMOOTHED, 1.0 / SMOOTHED)
    power = np.convolve(np.sum(np.abs(cause) ** 2, axis=1), mean, "same")
    crossed = [np.abs(np.convolve(answer * np.conj(one), mean, "same")) for one in cause.T]
    seen = power > SEEN * power.max()
    size = np.where(seen, np.sum(crossed, axis=0) / np.where(seen, power, 1.0), 0.0)
    k = int(np.argmax(size[1:])) + 1
    return float(2.0 * np.pi * k / (record.n_samples * float(record.dt or 1.0)))


def _stands_out(found: Array, root: Array, k: int, errors: float) -> bool:
    """Whether a coefficient is more than so many standard errors from zero."""
    return bool(abs(found[k]) > errors * _size(np.eye(found.size)[k], root))


def _is_a_controller(found: Array, root: Array, all_: int, small: int) -> bool:
    """Whether small moves say something that the others hardly share.

    Where an input was measured, noise and all, its small moves say less instead.
    """
    if not _stands_out(found, root, small, CONTRADICTED):
        return False
    if not _stands_out(found, root, all_, AT_ONCE):
        return True
    return bool(abs(found[all_]) < SHARED * abs(found[all_] + found[small]))


def _bank(records: Sequence[Record], output: int, held: bool) -> tuple[Parallel, WhitenedFit]:
    """The likeliest operators beside a direct part, and the noise."""
    options: tuple[Behaviour, ...] = ("zoh",) if held else ("zoh", "foh")
    tried = [
        with_noise_model(Parallel.of([r.between(one) for r in records], output, direct=True))
        for one in options
    ]
    return min(tried, key=lambda pair: pair[1].criterion)


def _columns(
    parallel: Parallel, fit: WhitenedFit, surprises: Sequence[Array]
) -> tuple[Array, Array]:
    """Whitened columns and target: inputs now and before, small moves, operators, offset, state."""
    records = tuple(record.between("zoh") for record in parallel.records)
    delays = tuple(DENSE * float(records[0].dt or 0.0) for _ in parallel.delays)
    late = parallel.changed(records=records, delays=delays, direct=False)
    blocks = []
    for e, record in enumerate(records):
        own, operators = late.record_columns(e, fit.pole, fit.order)
        u = record.u - record.u[0]
        now, before = moved(u, range(DENSE + 1)), moved(u, BEFORE)
        past = [now, surprises[e], before, operators.reshape(record.n_samples, -1)]
        others = [np.zeros((record.n_samples, own.shape[1]))] * len(records)
        blocks.append(np.hstack([*past, *others[:e], own, *others[e + 1 :]]))
    rows, targets = [], []
    for e, block in enumerate(blocks):
        y, seen = parallel.target(e)
        joined = np.ascontiguousarray(np.column_stack([block, y]).T)
        white = Whitener(parallel.noise, joined.shape[0]).apply(joined, seen).T
        rows.append(white[seen, :-1])
        targets.append(white[seen, -1])
    return np.vstack(rows), np.concatenate(targets)


def _solved(matrix: Array, target: Array) -> tuple[Array, Array]:
    """Least squares, and a root of the covariance."""
    norms = column_norms(matrix)
    left, s, right = np.linalg.svd(matrix / norms, full_matrices=False)
    kept = s > CUTOFF * s[0]
    root = right[kept].T / s[kept] / norms[:, None]
    solution = root @ (left[:, kept].T @ target)
    rss = float(np.sum((target - matrix @ solution) ** 2))
    return solution, np.sqrt(rss / max(target.size - int(kept.sum()), 1)) * root


def _size(weights: Array, root: Array) -> float:
    """Standard error of a sum of coefficients."""
    return float(np.linalg.norm(weights @ root))


def follows_at_once(u: Array, y: Array) -> bool:
    """Whether one output jumps with one input.

    Parameters
    ----------
    u, y : (n_samples,) arrays
        ``nan`` where a sample of the output is missing.
    """
    if u.size < FEWEST_JUMPS * 2:
        return False
    at = jumps_alone(u) & np.isfinite(np.diff(y))
    if at.sum() < FEWEST_JUMPS:
        return False
    own, moved = np.diff(u)[at], np.diff(y)[at]
    both = at & jumps_alone(y)
    if 2 * both.sum() < at.sum() or not moved @ moved > 0:
        return False
    return bool((own @ moved) ** 2 > IN_PROPORTION * (own @ own) * (moved @ moved))


def jumps_alone(x: Array) -> NDArray[np.bool_]:
    """(n_samples - 1,) steps that stand out, with neither of their neighbours beside them.

    Examples
    --------
    >>> jumps_alone(np.repeat([0.0, 1.0, 1.5, 2.0], [4, 4, 1, 4])).nonzero()[0].tolist()
    [3]
    """
    step = np.diff(x)
    before, after = np.append(0.0, step[:-1]), np.append(step[1:], 0.0)
    beside = np.maximum(np.abs(before), np.abs(after))
    seen = step[np.isfinite(step)]
    usual = median_scale(seen) if seen.size else 0.0
    with np.errstate(invalid="ignore"):
        return np.asarray(
            (np.abs(step) > STANDS_OUT * usual) & (np.abs(step) > ALONE * beside), dtype=bool
        )
