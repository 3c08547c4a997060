"""Delays that are estimated along: what they leave out, how far they may go, what else is as good.

The covariance is that of all minima near the end and of the cells between the kinks
(`likelihood.mixture`).

An input that repeats itself explains an output as well with a delay of a period more, or of half
of one with the gain reversed: the shortest is given, and the others are told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.errors import ConstantInputError, UnsupportedError
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.likelihood.answer import Ending, Spread
from tridentify.estimation.likelihood.cost import evaluate
from tridentify.estimation.likelihood.mixture import mixture
from tridentify.estimation.likelihood.setup.held_past import at_rest
from tridentify.estimation.likelihood.setup.nuisance import first_explained
from tridentify.estimation.search.delay_search import ROOM, STRETCHES, DelayPlace
from tridentify.estimation.search.repeated_input import repeats
from tridentify.numerics.arrays import Array, Complex
from tridentify.record.record import Record
from tridentify.structure import Structure

# share of the probability from which another delay is named
NAMED = 0.05
# steps; nearer delays are one minimum
MOVED = 0.1
# samples that may be left out beyond those that the delay itself takes, before it is done again
SPARE = 2
# share of the limit from which a delay lies at it
AT_LIMIT = 0.999
# share of the shortest record that a delay must leave
LONGEST_SHARE = 0.9
AT_REST = DecisionKind.INITIAL_STATE.told(" taken as at rest: nothing moves when the record begins")


@dataclass(frozen=True, eq=False)
class Located:
    """Where delays are taken up, and how far they may go.

    Attributes
    ----------
    place : DelayPlace
    limits : (n_inputs,) array
        [s].
    """

    place: DelayPlace
    limits: Array


def begins_at_rest(records: Sequence[Record], structure: Structure) -> bool:
    """Whether all records show an equilibrium at their first samples, where that is left open.

    A free state would explain a part of a step that the model does not follow.
    """
    away = any(np.any(one.u[0]) for one in records)
    if structure.initial_state != "auto" or (away and structure.offset is False):
        return False
    return all(at_rest(one, one.t - one.t[0], STRETCHES[1] * one.duration) for one in records)


def left_out(records: Sequence[Record], known: Structure) -> float:
    """Output samples before the first that the inputs explain."""
    return float(sum(first_explained(one, known) * one.n_outputs for one in records))


def repeated_inputs(records: Sequence[Record]) -> list[str]:
    """A word on each input whose delay is one of several that are as good."""
    told: list[str] = []
    for j, name in enumerate(records[0].input_names):
        found = [one for record in records if (one := repeats(record, j))]
        if len(found) < len(records):
            continue
        after, sign = found[0]
        step = records[0].duration / max(records[0].n_samples - 1, 1)
        if all(abs(one[0] - after) < step and one[1] == sign for one in found):
            reversed_ = "" if sign > 0 else " with the gain reversed"
            told.append(
                DecisionKind.REPEATED_INPUT.told(
                    f" ({name}, after {after:.4g} s{', inverted' * (sign < 0)}): a delay later by "
                    f"that explains the record as well{reversed_}, and the shortest is given"
                )
            )
    return told


def other_delays(
    ending: Ending, rivals: Sequence[tuple[Array, Complex]]
) -> tuple[Spread | None, list[str]]:
    """The covariance of all minima and cells, and a word on other delays.

    Where the scores scatter more than the likelihood says, so does the mixture.

    Parameters
    ----------
    ending : Ending
        With free delays.
    rivals : sequence of (delays, poles)
        Where else minima may lie.

    Returns
    -------
    spread : Spread or None
        None where the local curvature says all.
    words : list of str
    """
    problem = ending.point.problem
    step = max(e.dt for e in problem.experiments)
    others = [one for one in rivals if np.any(np.abs(one[0] - problem.delays) > MOVED * step)]
    best = ending.point
    if problem.pinned is not None:
        best = evaluate(replace(problem, pinned=None), best.poles)
    found = mixture(best, others)
    if found is None:
        return None, []
    told = _in_words(found.shares, found.means[:, -problem.n_inputs :], problem.delays, step)
    words = [told] if told else []
    scatter = ending.curvature.scatter
    if scatter is None:
        return Spread(found.cov), words
    return Spread(max(scatter.ratio, 1.0) * found.cov, errors="scores"), [
        *words,
        scatter.in_words(),
    ]


def _in_words(shares: Array, means: Array, delays: Array, step: float) -> str:
    """Delays farther off than a step, where they hold a share of the probability."""
    groups: list[tuple[float, Array]] = []
    for k in np.argsort(-shares):
        near = [i for i, (_, one) in enumerate(groups) if np.all(np.abs(one - means[k]) < step)]
        if np.all(np.abs(means[k] - delays) < step):
            continue
        if near:
            groups[near[0]] = (groups[near[0]][0] + float(shares[k]), groups[near[0]][1])
        else:
            groups.append((float(shares[k]), means[k]))
    named = [
        f"{', '.join(f'{max(d, 0.0):.4g}' for d in one)} s ({100.0 * share:.0f} %)"
        for share, one in groups
        if share > NAMED
    ]
    if not named:
        return ""
    return DecisionKind.OTHER_DELAYS.told(f": {'; '.join(named)}")


def refuse_direct(record: Record, structure: Structure) -> None:
    """Refuse channels that follow their input at once: the delay of a jump has no derivative.

    Raises
    ------
    UnsupportedError
    """
    poles = structure.poles_matrix(record.n_outputs, record.n_inputs)
    zeros = structure.zeros_matrix(record.n_outputs, record.n_inputs)
    if any(
        m == n
        for row, line in zip(poles, zeros, strict=True)
        for n, m in zip(row, line, strict=True)
    ):
        raise UnsupportedError(
            "found as many zeros as poles together with delay='free'; expected fewer zeros, as the "
            "output must depend smoothly on the delay; lower zeros, or give the delay in seconds"
        )


def refuse_still(records: Sequence[Record], structure: Structure) -> None:
    """Refuse an input that never moves: without an edge nothing tells its delay.

    Raises
    ------
    ConstantInputError
        Unless it is stated that it was switched on at the first sample.
    """
    for j, name in enumerate(records[0].input_names):
        if structure.initial_state != "rest" and not any(np.ptp(one.u[:, j]) for one in records):
            raise ConstantInputError(
                f"found input {name!r} that stays at {records[0].u[0, j]:g} together with "
                "delay='free'; expected an input that changes; record a change of it, or state "
                "initial_state='rest' if it was switched on at the first sample"
            )


def with_delays(
    records: Sequence[Record], structure: Structure, delays: Sequence[Array]
) -> tuple[Structure, Array]:
    """A structure with known delays that leaves room around some, and how far they may go.

    Parameters
    ----------
    records : sequence of Record
    structure : Structure
        With free delays.
    delays : sequence of (n_inputs,) arrays [s]

    Returns
    -------
    known : Structure
        Output samples that no input explains, up to its delays, are not to be used.
    limits : (n_inputs,) array [s]
    """
    first = records[0]
    longest = max(float(one.max()) for one in delays)
    step = max(float(np.median(np.diff(record.t))) for record in records)
    shortest = min(record.duration for record in records)
    room = min(longest + ROOM * step, LONGEST_SHARE * shortest)
    known = replace(structure, delay=((room,) * first.n_inputs,) * first.n_outputs)
    stated = structure.initial_state in ("rest", "equilibrium")
    limit = LONGEST_SHARE * shortest if stated else room
    return known, np.full(first.n_inputs, limit)
