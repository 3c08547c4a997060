"""A channel whose unit, gain or level changes at one instant: a sensor, not the system.

What the output of a model leaves of a record is looked at before and after every instant: another
level, or another share of the model's output, where the instant that leaves least is the one. A
model that was fitted across a change has taken both parts for one, so that models of the first and
of the second part alone are asked as well. The channel is then mended, the model fitted to that,
and so on from there. An output whose scale changes is compared as it was recorded: what a change of
unit takes from its residual explains nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.judgement.causes.attempts.attempt import Attempt, Limited, attempt, promise
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import LONG_ENOUGH, Rival, one
from tridentify.judgement.causes.timing.delay import FEW_STEPS
from tridentify.numerics.arrays import Array, Complex
from tridentify.record.record import Record

CODE = "channel-changes"

ROUNDS = 3
"""Fits and factors in turn: a model of both parts has a gain between theirs."""

BESIDE = (-16, -8, -4, -2, -1, 0, 1)
"""Samples about the instant that the output shows: it follows an input later."""

SAME = 0.05
"""Change of a factor below which it is none."""

MOST_OF_IT = 0.6
"""Share of the sum of squares that a step leaves where it is worth a closer look."""

SILENT = 0.5
"""Share of the sum of squares that a model leaves which follows neither part of a record."""

STARTS = 6
"""Frequencies from which the parts are then searched."""

DEGREES = 180.0 / np.pi


def break_rivals(present: Present, fitted: Sequence[Array]) -> Iterator[Rival]:
    """Every output and every input with another scale or another level from some instant on.

    Parameters
    ----------
    present : Present
    fitted : sequence of (n_samples, n_outputs) arrays
        Outputs of the present model.
    """
    if len(present.records) > 1 or present.records[0].n_samples < 2 * LONG_ENOUGH:
        return
    (record,) = present.records
    outputs = [(fitted[0], present.poles), *_of_parts(present, fitted[0])]
    channels = [(True, i) for i in range(record.n_outputs)]
    channels += [(False, j) for j in range(record.n_inputs)]
    for is_output, k in channels:
        for scaled in (True, False):
            found = _broken(present, outputs, is_output, k, scaled)
            if found is not None:
                yield found


def _of_parts(present: Present, fitted: Array) -> list[tuple[Array, Complex]]:
    """Outputs over the whole record, and poles, of models of its first and of its second half."""
    (record,) = present.records
    middle, found = record.n_samples // 2, list[tuple[Array, Complex]]()
    searched = _spread(present, fitted)
    starts = [present.poles, *searched]
    for part in (slice(None, middle), slice(middle, None)):
        y = np.array(record.y)
        y[part] = np.nan
        half = replace(present, records=(record._derive(y=y),), noise=())
        end = _ended(half, present, starts)
        if end is not None:
            found.append((end.point.outputs()[0], end.point.poles if searched else present.poles))
    return found


def _spread(present: Present, fitted: Array) -> list[Complex]:
    """Poles over all that a half can show, where the whole record seems to show none.

    A sign that changes near the middle leaves a model that follows neither part.
    """
    (record,) = present.records
    left = np.nansum((record.y - fitted) ** 2, axis=0)
    whole = np.nansum((record.y - np.nanmean(record.y, axis=0)) ** 2, axis=0)
    order = present.order
    if np.any(left < SILENT * whole) or not isinstance(order, int):
        return []
    pair = np.exp(1j * np.pi * np.array([0.75, 1.25]))  # damped by 0.7
    shape = np.concatenate([np.full(order % 2, -1.0 + 0.0j), *[pair] * (order // 2)])
    shape = shape * 1.3 ** (np.arange(order) // 2)
    slowest, fastest = 4.0 * np.pi / record.duration, 0.25 * np.pi / present.step
    return [w * shape for w in np.geomspace(slowest, fastest, STARTS)]


def _ended(
    part: Present, present: Present, starts: Sequence[Complex] | None = None
) -> Attempt | None:
    try:
        own = replace(part, noise=()).problem()
        starts = starts or [present.poles]
        return attempt(own, starts, present.orders, steps=FEW_STEPS, rounds=0)
    except TridentifyError:
        return None


def _broken(
    present: Present,
    outputs: Sequence[tuple[Array, Complex]],
    is_output: bool,
    k: int,
    scaled: bool,
) -> Rival | None:
    """One channel with another scale, or another level, from the instant that leaves least."""
    (record,) = present.records
    i = k if is_output else 0
    every = [(*_instant(record.y[:, i], f[:, i], scaled), own) for f, own in outputs]
    _, at, size, poles = min(every, key=lambda found: found[0])
    if not _is_change(size, scaled):
        return None
    if is_output or not scaled:
        ats = [at]
    else:
        ats = [m for m in (at + b for b in BESIDE) if 0 < m < record.n_samples]
    if not is_output and not scaled:
        return _input_level(present, k, at)
    plain = replace(present, noise=())
    for _ in range(ROUNDS):
        made = [_mended(plain, m, size, is_output, k, scaled) for m in ats]
        best = min(range(len(ats)), key=lambda m: promise(made[m], poles)) if len(ats) > 1 else 0
        end = _ended(made[best], replace(present, poles=poles))
        if end is None:
            return None
        at, poles = ats[best], end.point.poles
        ats = [at] if is_output else [at + b for b in (-1, 0, 1)]
        f = end.point.outputs()[0][:, i]
        if is_output:
            _, at, size = _instant(record.y[:, i], f, scaled)
            ats = [at]
        else:
            size *= _ratio(record.y[:, i], f, at)
        if not _is_change(size, scaled):
            return None
    part = _mended(present, at, size, is_output, k, scaled)
    return _rival(part, present, at, size, is_output, k, scaled, poles)


def _is_change(size: float, scaled: bool) -> bool:
    if not scaled:
        return bool(np.isfinite(size))
    inverted = abs(size + 1.0) < SAME
    return bool(np.isfinite(size)) and (inverted or (size > 0.0 and abs(size - 1.0) > SAME))


def _mended(
    present: Present, at: int, size: float, is_output: bool, k: int, scaled: bool
) -> Present:
    """The record with one channel as if nothing had changed."""
    (record,) = present.records
    values = np.array(record.y if is_output else record.u)
    if scaled:
        values[at:, k] *= 1.0 / size if is_output else size
    else:
        values[at:, k] -= size
    changed = record._derive(y=values) if is_output else record._derive(u=values)
    return replace(present, records=(changed,))


def _input_level(present: Present, k: int, at: int) -> Rival:
    """An input with another level from an instant on: a step of its own size, as late as it."""
    (record,) = present.records
    zeros = max(row[k] for row in present.zeros)

    def made(whole: Present, m: int) -> Present:
        step = (np.arange(record.n_samples) >= m).astype(np.float64)
        other = whole.with_inputs([step], "level", zeros)
        late = np.array(other.delay)
        late[:, -1] = present.delay[:, k]
        return replace(other, delay=late)

    ats = [m for m in (at + b for b in BESIDE) if 0 < m < record.n_samples]
    plain = replace(present, noise=())
    at = min(ats, key=lambda m: promise(made(plain, m), present.poles))
    return _told(made(present, at), present, at, record.input_names[k], "level", present.poles)


def steps(left: Array) -> bool:
    """Whether most of what is left of an output is another level from some instant on.

    Parameters
    ----------
    left : (n,) array
        ``nan`` where a sample is missing.

    Examples
    --------
    >>> noise = np.random.default_rng(1).standard_normal(300)
    >>> steps(noise), steps(noise + 3.0 * (np.arange(300) > 100))
    (False, True)
    """
    whole = float(np.nansum(left**2))
    if left.size < 2 * LONG_ENOUGH or not whole > 0.0:
        return False
    return _instant(left, np.zeros(left.size), False)[0] < MOST_OF_IT * whole


def _rival(
    part: Present,
    present: Present,
    at: int,
    size: float,
    is_output: bool,
    k: int,
    scaled: bool,
    poles: Complex,
) -> Rival:
    (record,) = present.records
    name = (record.output_names if is_output else record.input_names)[k]
    if not scaled:
        return _told(part, present, at, name, f"level, by {size:.4g}", poles)
    factor = size if is_output else 1.0 / size
    found = _told(part, present, at, name, f"scale, to {factor:.4g} times what it was", poles)
    found = replace(found, kind="scale")
    for unit, whole in ((DEGREES, "radians to degrees"), (1.0 / DEGREES, "degrees to radians")):
        if abs(factor / unit - 1.0) < SAME:
            found = replace(found, what=f"{found.what} (as from {whole})")
    return replace(found, behind=partial(_as_recorded, record, at, size, k)) if is_output else found


def _told(part: Present, present: Present, at: int, name: str, how: str, poles: Complex) -> Rival:
    (record,) = present.records
    when = float(record.t[at])
    found = one(
        CODE,
        part,
        f"a channel {name} that changes its {how}, at {when:.4g} s,",
        f"Look at {name} about {when:.4g} s (a unit, a range or a zero of the sensor that was "
        f"changed): mend the column from there on, or cut the record there (record.split).",
    )
    price = 2.0 * (2.0 + float(np.log(record.n_samples)))
    return replace(
        found, starts=((poles, present.poles),), price=price, times=(when,), exact=True,
        headline="a recorded channel is not the same throughout",
    )  # fmt: skip


def _as_recorded(record: Record, at: int, size: float, k: int, end: Attempt) -> Attempt:
    """Where a fit to an output of one scale ended, compared in the scales it was recorded in."""
    scale = np.ones((record.n_samples, record.n_outputs))
    scale[at:, k] = size
    left = end.point.residuals()[0] * scale
    later = int(np.isfinite(left[at:, k]).sum())
    recorded = np.where(np.isfinite(left), record.y, np.nan)
    return replace(
        end,
        deviance=end.deviance + 2.0 * later * float(np.log(abs(size))),
        limited=Limited((recorded,), (left,), (end.point.outputs()[0] * scale,)),
    )


def _ratio(y: Array, f: Array, at: int) -> float:
    """Share of a model's output after an instant over that before."""
    there = np.isfinite(y) & np.isfinite(f)
    found = []
    for part in (slice(None, at), slice(at, None)):
        a, b = (np.where(there, one_, 0.0)[part] for one_ in (y, f))
        found.append(float(a @ b) / max(float(b @ b), np.finfo(float).tiny))
    return found[1] / found[0] if found[0] else np.inf


def _instant(y: Array, f: Array, scaled: bool) -> tuple[float, int, float]:
    """Sum of squares that is left, and the instant and the size of the change that leave it."""
    there = np.isfinite(y) & np.isfinite(f)
    y, f = np.where(there, y, 0.0), np.where(there, f, 0.0)
    if scaled:
        top, bottom = np.cumsum(y * f), np.cumsum(f * f)
    else:
        top, bottom = np.cumsum(y - f), np.cumsum(there.astype(np.float64))
    whole = float(np.sum((y if scaled else y - f) ** 2))
    places = np.arange(LONG_ENOUGH // 2, y.size - LONG_ENOUGH // 2)
    before, after = (
        (top[places - 1], bottom[places - 1]),
        (top[-1] - top[places - 1], bottom[-1] - bottom[places - 1]),
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        left = whole - before[0] ** 2 / before[1] - after[0] ** 2 / after[1]
        left = np.where(np.isfinite(left), left, np.inf)
        k = int(np.argmin(left))
        shares = before[0][k] / before[1][k], after[0][k] / after[1][k]
        size = shares[1] / shares[0] if scaled else shares[1] - shares[0]
    return float(left[k]), int(places[k]), float(size)
