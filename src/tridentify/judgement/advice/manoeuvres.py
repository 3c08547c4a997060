"""The pieces of a long log that tell something: an input moves after quiet, and is answered.

*Activity.* The level of an input is what it holds while nothing is done. A sample is active where
some input departs from its level, the median of a window around it, or changes, by more than its
own noise and a small share of its range. Active samples closer than two gaps belong to the same
manoeuvre, and so do those between which an input is held for a while off its usual level: the steps
of a doublet or a 3-2-1-1.

*Quiet before, answer after.* A piece begins one gap before its first active sample, where the plant
was at rest, and ends one gap after the last, so that the free response is in it. It is offered
where its outputs move by more than in quiet stretches of the same length.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from tridentify.errors import TridentifyError
from tridentify.judgement.advice.frequency import frequency_response
from tridentify.numerics.arrays import Array
from tridentify.record.checks.times import typical_step
from tridentify.record.listed import one_record
from tridentify.record.record import Record

SHARE_OF_RANGE = 0.1
"""Departure of an input, as a share of the range of all of it, that counts as a move: trims and
small corrections are below."""
ABOVE_NOISE = 8.0
"""Departure in standard deviations of the input's own noise that counts as a move: one in 10^15
Gaussian samples, so that only moves are left."""
ANSWERED = 3.0
"""Range of an output within a manoeuvre over the usual one in quiet from which it is an answer."""
SHORTEST_GAP, GAPS_IN_A_RECORD = 20, 100
"""Samples at least, and part of the record, that separate two manoeuvres."""
FINER = 4
"""By which the gap is shortened where so long a one finds no quiet: a log that is long holds
manoeuvres that are not."""
RESTING = 0.95
"""Share of the samples between pieces at which the inputs are at their usual level, from which a
shortened gap found rest: between the steps of a random sequence they are held anywhere."""
LONGEST_HOLD = 10
"""Gaps for which an input may be held off its usual level within a manoeuvre: what is held for
longer is another level, at which the plant is at rest."""
MOSTLY_HELD = 0.5
"""Part of the samples between two moves that are off that level, from which it is held: more of
them are than not."""
MOST_OFFERED = 50
"""The best ones."""
LONGEST_MEASURED = 20_000
"""Samples of its middle from which a response is known to be there or not."""
FOLLOWED = 0.25
"""Share of the excited frequencies at which an output follows an input, from which it answers: of
noise alone a few per cent do by chance."""
MOSTLY = 0.4
"""Share of a record that moves and the gaps around them cover, from which it has no quiet to
speak of and counts as one piece: random steps rest for longer than a gap here and there."""
NEVER_QUIET = 0.2
"""Standard deviation of what looks like noise of an input, over that of the input, from which it
is no noise: the input moves at every sample."""


class Manoeuvre(NamedTuple):
    """A piece of a record that is worth identifying.

    Attributes
    ----------
    start, stop : float
        On the record's own time [s].
    score : float
        Range of the output that answers best, over its range in quiet of the same length; of a
        record without quiet the share of the excited frequencies at which an output follows.
    why : str
        One sentence.
    """

    start: float
    stop: float
    score: float
    why: str


def find_manoeuvres(record: Record, gap: float | None = None) -> tuple[Manoeuvre, ...]:
    """Find the informative pieces of a long record.

    Parameters
    ----------
    record : Record
    gap : float, optional
        Quiet [s] that separates two manoeuvres and stands before and after each. A hundredth of
        the record where left out, shorter where a long log has no quiet of that length, and not
        less than 20 samples.

    Returns
    -------
    tuple of Manoeuvre
        In the order of time; empty where no input moves or none of the moves is answered. A
        record in which inputs move without a pause is one piece.

    Raises
    ------
    SampleTypeError
        Something else in place of a record.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import TransferFunction, simulate
    >>> u = np.zeros(4000)
    >>> u[1000:1040], u[1040:1080] = 1.0, -1.0
    >>> y = simulate(TransferFunction([1.0], [1.0, 2.0]), Record(u, u, dt=0.05))
    >>> y = y + 0.001 * np.random.default_rng(0).standard_normal(y.shape)
    >>> [(round(m.start), round(m.stop)) for m in find_manoeuvres(Record(u, y, dt=0.05))]
    [(48, 56)]
    """
    record = one_record(record)
    if any(_restless(u) for u in record.u.T):
        return _whole(record)
    away = np.column_stack([_away(record.u[:, j]) for j in range(record.n_inputs)])
    held = np.asarray(away.any(axis=1))
    widths = _widths(record, gap)
    for width in widths:
        moves = np.column_stack([_moves(record.u[:, j], width) for j in range(record.n_inputs)])
        pieces = _pieces(np.asarray(moves.any(axis=1)), held, width)
        covered = sum(last - first + 2 * width for first, last in pieces)
        if covered > MOSTLY * record.n_samples:
            continue
        if width < widths[0] and not _rests(held, pieces):
            continue
        found = [_judged(record, moves, piece, pieces, width) for piece in pieces]
        best = sorted((one for one in found if one is not None), key=lambda one: -one.score)
        return tuple(sorted(best[:MOST_OFFERED])) if best else _whole(record)
    return _whole(record)


def _widths(record: Record, gap: float | None) -> list[int]:
    """Gaps to try [samples], the longest first; the one that is given alone."""
    if gap is not None:
        return [max(round(gap / typical_step(record.t)), 1)]
    width = max(SHORTEST_GAP, record.n_samples // GAPS_IN_A_RECORD)
    found = [width]
    while width > SHORTEST_GAP:
        width = max(width // FINER, SHORTEST_GAP)
        found.append(width)
    return found


def _rests(held: NDArray[np.bool_], pieces: list[tuple[int, int]]) -> bool:
    """Whether the inputs are at their usual level between the pieces."""
    between = np.ones(held.size, dtype=bool)
    for first, last in pieces:
        between[first : last + 1] = False
    return bool(np.mean(~held[between]) >= RESTING)


def _moves(u: Array, width: int) -> NDArray[np.bool_]:
    """Where an input changes within a window of a few samples by more than noise and trim do."""
    span = float(np.ptp(u))
    if not span > 0.0:
        return np.zeros(u.size, dtype=bool)
    noise = _noise(u)
    size = 2 * (width // 2) + 1
    window = maximum_filter1d(u, size, mode="nearest") - minimum_filter1d(u, size, mode="nearest")
    # the window sees a move half its width early and late
    active = window > max(SHARE_OF_RANGE * span, ABOVE_NOISE * noise)
    # and a single step in all windows but one that hold both its sides
    return np.asarray(minimum_filter1d(active.astype(np.int8), size - 2, mode="nearest") > 0)


def _away(u: Array) -> NDArray[np.bool_]:
    """Where an input is off the level that it has most of the time."""
    seen = np.nan_to_num(u, nan=float(np.nanmedian(u)))
    least = max(SHARE_OF_RANGE * float(np.ptp(seen)), ABOVE_NOISE * _noise(u))
    return np.asarray(np.abs(seen - np.median(seen)) > least)


def _noise(u: Array) -> float:
    """Standard deviation of white noise whose second differences have this median size."""
    second = np.diff(u, 2)
    return float(np.median(np.abs(second))) / 0.6745 / np.sqrt(6.0) if second.size else 0.0


def _restless(u: Array) -> bool:
    return _noise(u) > NEVER_QUIET * float(np.std(u)) > 0.0


def _whole(record: Record) -> tuple[Manoeuvre, ...]:
    """All of a record without quiet, where its outputs follow the inputs at some frequency."""
    ends = float(record.t[0]), float(record.t[-1])
    first = (record.n_samples - LONGEST_MEASURED) // 2
    if first > 0:
        record = record.slice(record.t[first], record.t[first + LONGEST_MEASURED - 1])
    try:
        measured = frequency_response(record)
    except TridentifyError:
        return ()
    excited = np.broadcast_to(measured.excited[:, None, :], measured.good.shape)
    count = np.maximum(excited.sum(axis=0), 1)
    share = float(np.max(measured.good.sum(axis=0) / count))
    if not share > FOLLOWED:
        return ()
    names = ", ".join(record.input_names)
    why = f"{names} moves without a pause, and the outputs follow at {100 * share:.0f} % of the"
    return (Manoeuvre(*ends, share, f"{why} frequencies it holds"),)


def _pieces(
    active: NDArray[np.bool_], held: NDArray[np.bool_], width: int
) -> list[tuple[int, int]]:
    """First and last active sample of runs with quiet between them."""
    at = np.flatnonzero(active)
    if not at.size:
        return []
    apart = np.flatnonzero(np.diff(at) > 2 * width)
    cuts = np.array(
        [
            k
            for k in apart
            if at[k + 1] - at[k] > LONGEST_HOLD * width
            or np.mean(held[at[k] : at[k + 1]]) < MOSTLY_HELD
        ],
        dtype=np.intp,
    )
    firsts, lasts = at[np.append(0, cuts + 1)], at[np.append(cuts, at.size - 1)]
    return [(int(a), int(b)) for a, b in zip(firsts, lasts, strict=True)]


def _judged(
    record: Record,
    moves: NDArray[np.bool_],
    piece: tuple[int, int],
    pieces: list[tuple[int, int]],
    width: int,
) -> Manoeuvre | None:
    """A piece with the quiet around it, where an output answers."""
    first, last = max(piece[0] - width, 0), min(piece[1] + width, record.n_samples - 1)
    quiet = _quiet(pieces, record.n_samples, width)
    scores = [_answer(record.y[:, i], first, last, quiet) for i in range(record.n_outputs)]
    best = int(np.argmax(scores))
    if not scores[best] > ANSWERED:
        return None
    moved = [
        name
        for name, own in zip(record.input_names, moves[piece[0] : piece[1] + 1].T, strict=True)
        if own.any()
    ]
    before = record.t[piece[0]] - record.t[first]
    rest = f" after {before:.3g} s of quiet" if piece[0] > first else ""
    answer = record.output_names[best]
    times = "far more than" if not np.isfinite(scores[best]) else f"{scores[best]:.3g} times"
    why = f"{', '.join(moved)} moves{rest}, and {answer} moves {times} what it does in quiet"
    return Manoeuvre(float(record.t[first]), float(record.t[last]), float(scores[best]), why)


def _quiet(pieces: list[tuple[int, int]], n_samples: int, width: int) -> list[tuple[int, int]]:
    """Stretches between the pieces, once their free responses are over."""
    starts = [0, *(last + 2 * width for _, last in pieces)]
    ends = [*(first for first, _ in pieces), n_samples]
    return [(a, b) for a, b in zip(starts, ends, strict=True) if b - a > width]


def _answer(y: Array, first: int, last: int, quiet: list[tuple[int, int]]) -> float:
    """Range of an output within a piece over that in quiet; one over its noise where none is."""
    own = _range(y[first : last + 1])
    if not np.isfinite(own):
        return 0.0
    usual = [_usual(y[a:b], last + 1 - first) for a, b in quiet]
    usual = [one for one in usual if np.isfinite(one)]
    if not usual:
        difference = np.diff(y[np.isfinite(y)])
        noise = float(np.median(np.abs(difference))) if difference.size else 0.0
        usual = [6.0 * noise]
    least = float(np.median(usual))
    if not least > 0.0:
        return np.inf if own > 0.0 else 0.0
    return own / least


def _usual(y: Array, length: int) -> float:
    """Median range of the stretches of a length."""
    count = max(y.size // max(length, 1), 1)
    return float(np.nanmedian([_range(part) for part in np.array_split(y, count)]))


def _range(y: Array) -> float:
    seen = y[np.isfinite(y)]
    return float(np.ptp(seen)) if seen.size > 1 else float("nan")
