"""Whether a state from a file is one that an estimator can have: all of it, before a loop runs.

The compiled loops (`online.kernels`) trust what they are given: where things stand (``ints``), how
long a delay is (in ``c``), how many samples were kept and how many stand in a block (in ``x``). One
wrong number makes them write beyond their arrays, or go round for ever. So nothing of that is
believed: the plan is made again from structure, sampling interval and options, and has to be the
same; constants that follow from these are made again too, and have to agree; every number of the
vector has a range, and counts are whole.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.realization import cascade
from tridentify.online.kernels import gradient_slots as places
from tridentify.online.kernels import slots
from tridentify.online.kernels.slots import scatter_size, triangle_size
from tridentify.online.layout import Blueprint, NuisanceColumns, Setting, Stage
from tridentify.online.saved.number_rules import (
    ALARM_LASTS,
    HUGE,
    WHOLE,
    NumberRule,
    by_gradient,
    check_rule,
    on_equation,
    rules_of,
)

MOST_COEFFICIENTS = 10_000
"""Of a structure; their covariance alone would take 800 MB."""
MOST_ORDER = 600
"""States of a bank or degree of a polynomial; its exact equivalent takes a second to make."""
AGREES, AGREES_WITHIN = 1e-6, 1e-9
"""How far constants made by another library may be off: relative, and to the largest beside."""


def check_orders(poles: object, zeros: object, n_inputs: int, n_outputs: int) -> None:
    """Refuse orders that would fill the memory, before anything is made of them.

    Raises
    ------
    ValueError
    """
    listed = [_largest(value) for value in (poles, zeros)]
    if listed[0] > MOST_ORDER:
        raise ValueError(f"{listed[0]} poles; at most {MOST_ORDER} can be")
    count = listed[0] + n_inputs * n_outputs * (listed[1] + 1)
    if count > MOST_COEFFICIENTS:
        raise ValueError(f"{count} coefficients; at most {MOST_COEFFICIENTS} can be")


def _largest(value: object) -> int:
    if isinstance(value, (list, tuple)):
        return max((_largest(item) for item in value), default=0)
    if type(value) is not int:
        raise TypeError("orders that are no whole numbers")
    return value


def check_room(setting: Setting, blueprint: Blueprint, *, shared: bool) -> None:
    """Refuse a bank for which the arrays of the file are too short, before a plan is made of it.

    Parameters
    ----------
    setting : Setting
    blueprint : Blueprint
        As the file has it.
    shared : bool
        Whether all outputs share one triangle.

    Raises
    ------
    ValueError
    """
    m, p, q = setting.n_inputs, setting.n_outputs, blueprint.poles.size
    if q > MOST_ORDER:
        raise ValueError(f"a bank of {q} states; at most {MOST_ORDER} can be")
    if not q:
        return
    wanted = NuisanceColumns.of(setting.structure, blueprint.nuisance.free)
    free = wanted.free or (shared and wanted.offset)
    if shared:
        columns, judged = len(setting.names) + p * q * free, len(setting.names)
        least, maps = columns * (columns - 1) // 2, 0
    else:
        columns, judged = q * (m + free) + m, setting.n_directions
        least, maps = p * triangle_size(columns), p * judged * columns
    least += p * scatter_size(judged)
    if blueprint.size < least or blueprint.constants.size < q * q + maps:
        raise ValueError(
            f"{blueprint.size} numbers and {blueprint.constants.size} constants, which are too few"
        )


def check_sound(stage: Stage, values: Array, rebuilt: Blueprint) -> None:
    """Refuse a state that no estimator can have come to.

    Parameters
    ----------
    stage : Stage
        As the file has it.
    values : array
    rebuilt : Blueprint
        The plan that the settings lead to.

    Raises
    ------
    ValueError
        What is wrong.
    """
    blueprint = stage.blueprint
    if not np.array_equal(blueprint.ints, rebuilt.ints):
        at = int(np.flatnonzero(blueprint.ints != rebuilt.ints)[0])
        raise ValueError(
            f"{blueprint.ints[at]} at place {at} of the plan; the settings lead to "
            f"{rebuilt.ints[at]}"
        )
    for what, found, expected in (
        ("numbers", values.size, rebuilt.size),
        ("constants", blueprint.constants.size, rebuilt.constants.size),
        ("nuisance terms", blueprint.nuisance, rebuilt.nuisance),
    ):
        if found != expected:
            raise ValueError(f"{found} {what}; the settings lead to {expected}")
    _check_constants(blueprint, rebuilt)
    _check_stage(stage, values)
    for rule in rules_of(stage, values):
        check_rule(values, rule)
    _check_clocks(stage, values)


# ---------------------------------------------------------------------------------------- constants
def _check_constants(blueprint: Blueprint, rebuilt: Blueprint) -> None:
    """Those that follow from the settings, up to rounding; the others have to be finite."""
    ints, c = blueprint.ints, blueprint.constants
    if not np.all(np.isfinite(c)):
        raise ValueError("a constant that is no finite number")
    for begin, end in _regions(ints, c.size):
        expected = rebuilt.constants[begin:end]
        if not np.all(np.isfinite(expected)):
            raise ValueError("poles that lead to no finite constants")
        scale = float(np.abs(expected).max(initial=0.0))
        off = np.abs(c[begin:end] - expected)
        if np.any(off > AGREES * np.abs(expected) + AGREES_WITHIN * scale):
            raise ValueError(f"constants from {begin} on that the settings do not lead to")
    # these are lengths and degrees
    m, p = int(ints[slots.INPUTS]), int(ints[slots.OUTPUTS])
    exact = [(slots.INTERVAL, slots.CONSTANTS - slots.INTERVAL), (int(ints[slots.C_EXTRA]), m)]
    if on_equation(ints):
        exact.append((int(ints[slots.C_ZEROS]), m * p + 1))
    if by_gradient(ints):
        exact[0] = (slots.INTERVAL, places.RATE - slots.INTERVAL)
    for at, count in exact:
        if not np.array_equal(c[at : at + count], rebuilt.constants[at : at + count]):
            raise ValueError(f"constants from {at} on that the settings do not lead to")
    for rule in _constant_rules(ints):
        check_rule(c, rule)


def _regions(ints: Indices, size: int) -> Iterator[tuple[int, int]]:
    """Where constants stand that follow from the settings."""
    known = [slots.C_STEP, slots.C_TAPS, slots.C_DIRECT, slots.C_START, slots.C_EXTRA]
    if on_equation(ints):
        known += [slots.C_OUTPUT, slots.C_BASIS, slots.C_MONIC, slots.C_ZEROS]
        others = [slots.C_WALK] if ints[slots.FILTERING] else []
    else:
        others = [slots.C_MAPS]
    begins = sorted(int(ints[place]) for place in (*known, *others))
    free = {int(ints[place]) for place in others}
    for begin, end in zip(begins, [*begins[1:], size], strict=True):
        if begin not in free:
            yield begin, end


def _constant_rules(ints: Indices) -> Iterator[NumberRule]:
    if by_gradient(ints):
        yield NumberRule("a rate", places.RATE, 1, 0.0)
        yield NumberRule("a mark", places.KNOWN, 1, 0.0, 1.0, whole=True)
        yield NumberRule("a readiness", places.READY, 1, 0.0, 1.0)
        yield NumberRule("a pace", places.GRADIENT_PACE, 1, 0.0, 0.0)
    if on_equation(ints):
        k, p = int(ints[slots.COEFFICIENTS]), int(ints[slots.OUTPUTS])
        yield NumberRule(
            "a weight", int(ints[slots.C_MONIC] + ints[slots.ORDER]) + 1, p, 1.0 / HUGE
        )
        if ints[slots.FILTERING]:
            yield NumberRule("a speed of drift", int(ints[slots.C_WIDTHS]), k, 0.0)


# -------------------------------------------------------------------------------------------- stage
def _check_stage(stage: Stage, values: Array) -> None:
    """What stands beside the vector."""
    blueprint, setting = stage.blueprint, stage.setting
    ints, bank = blueprint.ints, blueprint.poles
    if bank.size:
        cascade(stage.poles)
        whole_model = setting.n_poles if not on_equation(ints) else bank.size
        if by_gradient(ints) and not ints[places.SERIES]:
            whole_model = bank.size - int(ints[places.KEPT])
        if stage.poles.size != whole_model:
            raise ValueError(f"{stage.poles.size} poles in place of {whole_model}")
    elif stage.poles.size or not stage.searching:
        raise ValueError("a model without a bank")
    for poles in (stage.poles, bank):
        if not np.all(np.isfinite(poles)):
            raise ValueError("poles that are no finite numbers")
    keeps = bool(ints[slots.CHUNK])
    if stage.searching and not keeps:
        raise ValueError("a search without samples to search")
    suspecting = on_equation(ints) or by_gradient(ints)
    if stage.past and not (keeps or suspecting):
        raise ValueError("samples that are kept by nobody")
    for samples in stage.past:
        _check_samples(samples, setting.n_inputs)
    _check_changes(stage.changes, float(values[slots.COUNT]))
    _check_extra(stage, values)


def _check_samples(samples: Array, n_inputs: int) -> None:
    """Intervals and inputs; an output may be missing."""
    flat = np.ascontiguousarray(samples[:, 1 : 1 + n_inputs]).ravel()
    check_rule(flat, NumberRule("an input", 0, flat.size, -slots.LARGEST, slots.LARGEST))
    intervals = np.ascontiguousarray(samples[:, 0])
    check_rule(intervals, NumberRule("an interval", 0, intervals.size, 1.0 / HUGE))
    if not len(samples):
        raise ValueError("no samples where some are kept")


def _check_changes(changes: Sequence[int], count: float) -> None:
    before = -1
    for change in changes:
        if type(change) is not int or not before < change < count:
            raise ValueError("changes that are not in order")
        before = change


def _check_extra(stage: Stage, values: Array) -> None:
    """The periods of the gradient rule, its rate and their number; a vector as it was before."""
    ints = stage.blueprint.ints
    if not by_gradient(ints) and not on_equation(ints):
        _check_snapshot(stage, values)
        return
    own = 2 if by_gradient(ints) else 0
    expected = [own + 4] if values[slots.SUSPECT] > 0.0 else [own, own + 2]
    if len(stage.extra) not in expected:
        raise ValueError(f"{len(stage.extra)} further arrays in place of {expected[0]}")
    for theta, cov in zip(stage.extra[own::2], stage.extra[own + 1 :: 2], strict=True):
        _check_witness(theta, cov, len(stage.setting.names))
    if not own:
        return
    flat, pair = stage.extra[:own]
    if pair.size != 2 or flat.size % (len(stage.setting.names) + 1):
        raise ValueError("periods of another length")
    periods = flat.reshape(-1, len(stage.setting.names) + 1)
    check_rule(flat, NumberRule("a coefficient", 0, flat.size))
    lengths = np.ascontiguousarray(periods[:, 0])
    check_rule(lengths, NumberRule("a length of a period", 0, lengths.size, 1.0 / HUGE, WHOLE))
    check_rule(pair, NumberRule("a rate", 0, 1, 1.0 / HUGE))
    check_rule(pair, NumberRule("a number of periods", 1, 1, 0.0, WHOLE, whole=True))


def _check_witness(theta: Array, cov: Array, n: int) -> None:
    """Coefficients and a covariance, or nothing (`online.suspecting`)."""
    if theta.size not in (0, n) or cov.size != theta.size**2:
        raise ValueError(f"{theta.size} coefficients of a witness in place of {n}")
    check_rule(theta, NumberRule("a coefficient", 0, theta.size))
    check_rule(cov, NumberRule("a covariance", 0, cov.size))
    variances = np.ascontiguousarray(np.diagonal(cov.reshape(theta.size, theta.size)))
    check_rule(variances, NumberRule("a variance", 0, theta.size, 0.0))


def _check_snapshot(stage: Stage, values: Array) -> None:
    """What work beside the stream began with: a vector of the same plan."""
    working = values[slots.WORK_DONE] > 0.0 and not stage.searching
    expected = int(working or values[slots.SUSPECT] > 0.0)
    if len(stage.extra) not in (expected, expected + 2):
        raise ValueError(f"{len(stage.extra)} further arrays in place of {expected}")
    for theta, cov in zip(stage.extra[expected::2], stage.extra[expected + 1 :: 2], strict=True):
        _check_witness(theta, cov, len(stage.setting.names))
    for before in stage.extra[:expected]:
        if before.size != values.size or before[slots.COUNT] > values[slots.COUNT]:
            raise ValueError("work that began with another vector")
        for rule in rules_of(stage, before):
            check_rule(before, rule)


# ------------------------------------------------------------------------------------------- vector


def _check_clocks(stage: Stage, values: Array) -> None:
    """Whether counts, times and kept samples go together."""
    x, ints, dt = values, stage.blueprint.ints, stage.setting.dt
    count = float(x[slots.COUNT])
    if x[slots.SINCE] > count or x[slots.ALARM] > count + ALARM_LASTS:
        raise ValueError("clocks that are ahead of the samples")
    if x[slots.BORN] > x[slots.TIME] + 2.0 * dt or (count == 0.0 and x[slots.TIME] != 0.0):
        raise ValueError("times that are ahead of the samples")
    time = (count - 1.0) * dt + x[slots.EXTRA] if count > 1.0 else 0.0
    if abs(time - x[slots.TIME]) > AGREES * dt + AGREES_WITHIN * abs(time):
        raise ValueError(f"a time of {x[slots.TIME]:g} s after {count:g} samples")
    order = int(ints[slots.ORDER])
    faded = order * int(ints[slots.OUTPUTS]) if on_equation(ints) else order
    if x[slots.FIRST] not in ((0.0, float(faded)) if ints[slots.FREE] else (0.0,)):
        raise ValueError(f"{x[slots.FIRST]:g} columns that have faded")
    width = stage.setting.n_inputs + stage.setting.n_outputs + 1
    filled, at = int(x[slots.FILLED]), int(ints[slots.AT_CHUNK])
    if filled:
        _check_samples(x[at : at + filled * width].reshape(-1, width), stage.setting.n_inputs)
    kept = sum(map(len, stage.past)) + filled
    if kept > count:
        raise ValueError("more samples kept than there were")
    since = count - float(x[slots.SUSPECT]) if x[slots.SUSPECT] else float(kept)
    if not x[slots.WORK_AT] <= since <= kept:
        raise ValueError("work on samples that are not kept")
