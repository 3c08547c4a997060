"""What another record is, whose coefficients are not those of the estimate.

What is tried there with the coefficients held is another gain of one channel, its sign or its unit:
with ``d`` what the model makes of the channel, the gain is its least-squares coefficient beside the
start of the record and an offset. What new coefficients alone explain is fitted from many poles:
those of the estimate may be far from those of another plant. Where they explain what there is to
explain, it is another system, and what else a residual of held coefficients looks like is not
there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.likelihood.setup.nuisance import Nuisances
from tridentify.judgement.causes.attempts.attempt import Attempt, attempt
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.system.odd_experiment import CERTAIN, WRONG, rounded
from tridentify.judgement.validation.explained import present_of
from tridentify.judgement.validation.known_causes import KnownCauses
from tridentify.judgement.validation.phrases import sentence
from tridentify.judgement.validation.residuals import View, start_columns
from tridentify.judgement.validation.result import Transfer
from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.lagrange import span

MOST_OF_IT = 0.9
"""Share of what the best explanation brings (-2 log L) from which a simpler one is it."""
FALLS = 3.0
"""Size of a residual over that to be expected from which a model is that of another system."""
RATES = 8
"""Places over the band of the record at which real poles may begin."""
STRETCHED = (0.3, 1.0, 3.0)
"""Times the poles of the estimate at which others may begin."""
LOOKS_LIKE = (
    "lost-rows",
    "channel-changes",
    "input-noise",
    "intersample",
    "delay",
    "filtered",
    "feedback",
    "bad-samples",
    "order-low",
    "unmodelled-response",
    "noise-model",
    "noise-changes",
)
"""What a residual of coefficients that are not those of the record may look like."""
UNITS = (
    (180.0 / np.pi, "degrees and radians"),
    (9.80665, "g and m/s^2"),
    (3.6, "km/h and m/s"),
    (100.0, "per cent and parts of one"),
    (1000.0, "a unit and its thousandth"),
)
"""Gains that are units, and which."""
NEAR = 0.02
"""Difference from a unit, relative, up to which a gain is it."""


@dataclass(frozen=True, eq=False)
class _Gain:
    """Another gain of one channel.

    Attributes
    ----------
    channel : str
    value, std : float
    energy : (n_outputs,) array
        Sums of squares that it leaves.
    """

    channel: str
    value: float
    std: float
    energy: Array


def about_other_record(
    found: Sequence[Finding], transfer: Transfer, beside: KnownCauses
) -> list[Finding]:
    """Findings of another record, with what makes it another one first.

    Parameters
    ----------
    found : sequence of Finding
        With one that says that the coefficients are others, or they are given back as they are.
    transfer : Transfer
    beside : KnownCauses
    """
    view = beside.view
    said = [one for one in found if one.code == "another-system"]
    if not said or view.own:
        return list(found)
    estimate = beside.estimate
    counts = np.array([float(output.count) for output in view.outputs])
    held, gains = _gains(view, estimate)
    free = _free(view, estimate)
    if free is None or not np.all(held > 0):
        return list(found)
    least = free.raw_energy
    if beside.named is not None:
        ends = beside.named.attempts
        least = np.minimum(least, np.sum([end.raw_energy for end in ends], axis=0))

    def brings(energy: Array) -> float:
        return float(counts @ np.log(held / np.maximum(energy, 1e-300)))

    best = max(gains, key=lambda one: brings(one.energy), default=None)
    enough = MOST_OF_IT * brings(least)
    others = [one for one in found if one.code not in ("another-system", *LOOKS_LIKE)]
    if best is not None and brings(best.energy) >= enough and _is_other(best):
        return [_of_gain(best, view, held, said[0]), *others]
    if not (brings(free.raw_energy) >= enough and np.max(transfer.size_ratio) > FALLS):
        return list(found)
    before, after = _fits(view, held), _fits(view, free.raw_energy)
    pairs = zip(estimate.output_names, before, after, strict=True)
    fits = ", ".join(f"fit of {name} from {a:.1f} to {b:.1f} %" for name, a, b in pairs)
    told = replace(said[0], severity="error", effect=f"With coefficients of its own: {fits}.")
    return [told, *others]


def _is_other(gain: _Gain) -> bool:
    return abs(gain.value - 1.0) > CERTAIN * gain.std


def _of_gain(gain: _Gain, view: View, held: Array, said: Finding) -> Finding:
    """The record has another sign, another unit or another gain in one channel."""
    opposite = gain.value < 0
    size = abs(gain.value)
    plain = abs(size - 1.0) < CERTAIN * gain.std
    how = "answers with the opposite sign"
    if not plain:
        times = f"answers with a gain of {rounded(gain.value, gain.std)} times that of the estimate"
        how = times + (", of the opposite sign" if opposite else "") + _unit(size)
    alone = view.records[0].n_inputs == view.records[0].n_outputs == 1
    where = "this record" if alone else f"{gain.channel} of this record"
    pairs = zip(view.outputs, _fits(view, held), _fits(view, gain.energy), strict=True)
    fits = ", ".join(f"fit of {output.name} from {a:.1f} to {b:.1f} %" for output, a, b in pairs)
    return replace(
        said,
        severity="error" if opposite or not 1.0 / WRONG < size < WRONG else "warning",
        message=sentence(f"{where} {how}; the rest is as the estimate says"),
        remedy="Look at the signs, the units and the gains of its channels, and validate again "
        "with the one that is wrong put right.",
        effect=f"With that gain, and the coefficients held: {fits}.",
        kind="opposite" if opposite else "gain",
    )


def _unit(size: float) -> str:
    """Which units a gain stands for, in words; empty for none.

    Examples
    --------
    >>> _unit(0.01745), _unit(1.1)
    (' (degrees and radians?)', '')
    """
    for factor, which in UNITS:
        if min(abs(size / factor - 1.0), abs(size * factor - 1.0)) < NEAR:
            return f" ({which}?)"
    return ""


def _fits(view: View, energy: Array) -> Array:
    """(n_outputs,) NRMSE [percent], each record about its own mean."""
    spread = []
    for output in view.outputs:
        seen = [y[s] for y, s in zip(output.y, output.seen, strict=True)]
        spread.append(sum(float(np.sum((one - one.mean()) ** 2)) for one in seen if one.size))
    return np.asarray(100.0 * (1.0 - np.sqrt(energy / np.maximum(spread, 1e-300))))


def _gains(view: View, estimate: Estimate) -> tuple[Array, list[_Gain]]:
    """Sums of squares that the estimate leaves, and other gains of single channels."""
    first, starts = view.records[0], start_columns(estimate, view.records)

    def driven(only: int | None) -> list[Array]:
        parts = []
        for record in view.records:
            u = record.u
            own = u if only is None else np.where(np.arange(u.shape[1]) == only, u, 0.0)
            parts.append(simulate(estimate.model, record._on_its_times(own)))
        return parts

    whole = driven(None)
    left = [_beside_start(view, i, starts, whole, whole) for i in range(first.n_outputs)]
    held = np.array([float(r @ r) for r, _ in left])
    found = []
    for i, name in enumerate(first.output_names):
        found.append(_one_gain(name, left, {i: left[i][1]}, held))
    for j, name in enumerate(first.input_names if first.n_inputs > 1 else ()):
        part = driven(j)
        own = {i: _beside_start(view, i, starts, whole, part)[1] for i in range(len(left))}
        found.append(_one_gain(name, left, own, held))
    return held, [one for one in found if one is not None]


def _beside_start(
    view: View, i: int, starts: Sequence[Array], whole: Sequence[Array], part: Sequence[Array]
) -> tuple[Array, Array]:
    """What the model leaves of an output, and a part of what it makes of it, beside any start."""
    output = view.outputs[i]
    seen = np.concatenate(output.seen)
    known = span(starts[i][seen])
    y, all_of_it, moves = (
        np.concatenate(one)[seen]
        for one in (output.y, [y[:, i] for y in whole], [y[:, i] for y in part])
    )

    def beside(one: Array) -> Array:
        return np.asarray(one - known @ (known.T @ one))

    return beside(y - all_of_it), beside(moves)


def _one_gain(
    channel: str, left: Sequence[tuple[Array, Array]], moves: dict[int, Array], held: Array
) -> _Gain | None:
    """One gain of what moves some outputs, each weighted by what is left of it."""
    over = sum(float(d @ left[i][0]) / held[i] for i, d in moves.items() if held[i] > 0)
    under = sum(float(d @ d) / held[i] for i, d in moves.items() if held[i] > 0)
    if not under > 0:
        return None
    share, energy = over / under, held.copy()
    variance = 0.0
    for i, d in moves.items():
        r = left[i][0] - share * d
        energy[i] = float(r @ r)
        variance += (energy[i] / max(r.size, 1)) * float(d @ d) / held[i] ** 2 if held[i] else 0.0
    return _Gain(channel, 1.0 + share, float(np.sqrt(variance)) / under, energy)


def _free(view: View, estimate: Estimate) -> Attempt | None:
    """Where coefficients of the record's own end, from poles all over its band."""
    noises = [np.zeros(0)] * len(view.outputs)
    present = present_of(view, estimate, noises)
    drift = present.nuisances.drift
    present = replace(present, nuisances=Nuisances("free", True, drift))
    found = []
    for poles in _starts(present):
        try:
            found.append(attempt(present.problem(), [poles], present.orders, rounds=0))
        except TridentifyError:
            continue
    ends = [end for end in found if end is not None]
    return min(ends, key=lambda end: end.deviance, default=None)


def _starts(present: Present) -> list[Complex]:
    found = [np.asarray(times * present.poles) for times in STRETCHED]
    if isinstance(present.order, int):
        slow = 2.0 / max(record.duration for record in present.records)
        spread = 1.0 + np.arange(present.order)
        for rate in np.geomspace(slow, 1.0 / present.step, RATES):
            found.append(np.asarray(-rate * spread, dtype=np.complex128))
    return found
