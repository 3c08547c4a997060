"""Times, sentences and findings as they are worded."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.estimation.answer.finding import Finding, Severity
from tridentify.numerics.arrays import Array


def seconds(low: float, high: float) -> str:
    """A stretch of lags.

    Examples
    --------
    >>> seconds(0.1, 0.4), seconds(0.2, 0.2)
    ('lags 0.1-0.4 s', 'lag 0.2 s')
    """
    alike = span(low, high) == span(low, low)
    return f"{'lag' if alike else 'lags'} {span(low, high)} s"


def span(low: float, high: float) -> str:
    """Two numbers that are not negative, or one where they look alike.

    Examples
    --------
    >>> span(0.1, 0.4), span(0.25, 0.25)
    ('0.1-0.4', '0.25')
    """
    a, b = f"{low:.3g}", f"{high:.3g}"
    return a if a == b else f"{a}-{b}"


def around_top(ratio: Array, limit: float) -> tuple[int, int]:
    """First and last of the places beside the largest that are above a limit too.

    Examples
    --------
    >>> around_top(np.array([2.0, 0.5, 3.0, 1.5, 0.1]), 1.0)
    (2, 3)
    """
    low = high = int(np.argmax(ratio))
    while low > 0 and ratio[low - 1] > limit:
        low -= 1
    while high + 1 < ratio.size and ratio[high + 1] > limit:
        high += 1
    return low, high


AT_MOVES = (
    "where an input moves: what happens there is too fast for the model, or the times of the moves "
    "are not those of the samples, unless switching disturbs the sensor"
)
"""Of far samples that all lie there."""

LOOK_THERE = (
    "Look at these moves; mark the samples as missing (nan) only where switching disturbs the "
    "sensor."
)
"""What to do about them."""


def one_finding(
    code: str,
    output: str,
    text: str,
    advice: str,
    severity: Severity = "warning",
    *,
    effect: str = "",
    times: Sequence[float] = (),
    experiment: int | None = None,
) -> Finding:
    """A finding whose words become sentences."""
    outputs = () if output == "all" else (output,)
    said, do, much = (sentence(part) for part in (text, advice, effect))
    return Finding(code, severity, said, do, outputs, experiment, tuple(times), much)


def sentence(text: str) -> str:
    """Words as a sentence."""
    return f"{text[0].upper()}{text[1:]}." if text else ""


def decapitalised(message: str) -> str:
    """A sentence as the second half of another."""
    return message[0].lower() + message[1:]


def when(rows: Array, n_experiments: int) -> str:
    """Times of samples in words, each with its experiment where there are several.

    Examples
    --------
    >>> when(np.array([[0.0, 2.5, 6.0], [0.0, 0.5, 7.0]]), 1)
    '0.5, 2.5 s'
    >>> when(np.array([[1.0, 0.04, 9.0], [0.0, 24.9, 8.0], [1.0, 0.08, 7.0]]), 2)
    '24.9 s of experiment 1, 0.04, 0.08 s of experiment 2'
    """
    said = []
    for e in np.unique(rows[:, 0]):
        times = ", ".join(f"{t:.4g}" for t in np.sort(rows[rows[:, 0] == e, 1]))
        said.append(f"{times} s" + (f" of experiment {int(e) + 1}" if n_experiments > 1 else ""))
    return ", ".join(said)
