"""Delays that are estimated along: the whole method from every place where they may lie.

The places (`search.delay_search`), one for every kind of start, are finished on the same samples,
those that the longest of them allows, and the best by AICc counts, where what it leaves out beyond
a tenth of the record counts against it. It is finished once more on all samples that it allows
itself, but for two, in which it may move. What other delays add to its uncertainty, and what is to
be said of them, comes last (`search.delays`).

A slow disturbance draws a smooth input to where its response looks like the disturbance, seconds
away, and from there no drift leads back. So where the residual of the best end asks for a drift,
the delays are looked for once more beside the highest degree in question: what is that slow tells
little of a delay, and a degree too many costs nothing of it. The new places compete with the best.

Where the start is left open and a record shows that it begins at rest (`setup.held_past`), it
is taken so: nothing is left out, and no free state can explain a step that the model does not
follow closely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tridentify.errors import IdentifiabilityError
from tridentify.estimation.methods.around_maximum.maximum import Maximiser, Reached
from tridentify.estimation.methods.base import Progress
from tridentify.estimation.search.delay_search import (
    AGREE,
    MOST_ROUNDS,
    DelayPlace,
    delay_places,
    price,
)
from tridentify.estimation.search.delays import (
    AT_LIMIT,
    AT_REST,
    SPARE,
    Located,
    begins_at_rest,
    left_out,
    other_delays,
    refuse_direct,
    refuse_still,
    repeated_inputs,
    with_delays,
)
from tridentify.numerics.arrays import Array
from tridentify.record.checks.orders import HIGHEST_DRIFT
from tridentify.record.record import Record
from tridentify.structure import Structure


def over_delays(
    method: Maximiser,
    records: Sequence[Record],
    structure: Structure,
    say: Progress,
    given: Array | None = None,
) -> Reached:
    """The best of the ends from every place, on all samples that it allows.

    Parameters
    ----------
    method : Maximiser
    records : sequence of Record
    structure : Structure
        With free delays.
    say : callable
        Is told what is going on.
    given : (n_inputs,) array, optional
        Delays to begin with [s], in place of a search.
    """
    refuse_direct(records[0], structure)
    refuse_still(records, structure)
    if begins_at_rest(records, structure):
        if any(np.any(record.u[0]) for record in records):
            stated = replace(structure, initial_state="equilibrium", offset=True)
        else:
            stated = replace(structure, initial_state="rest")
        return over_delays(method, records, stated, say, given).told(AT_REST)
    say("where the delays lie")
    none = np.zeros(0, dtype=np.complex128)
    places = delay_places(records, structure) if given is None else [DelayPlace(given, none)]
    best, place, known, limits = _best(method, records, structure, say, places)
    if best.open_drift and given is None:
        say("where the delays lie beside a drift")
        other = delay_places(records, replace(structure, drift=min(best.open_drift, HIGHEST_DRIFT)))
        here = replace(place, delays=best.point.problem.delays, poles=best.point.poles)
        near = AGREE * min(e.dt for e in best.point.problem.experiments)
        other = [one for one in other if np.any(np.abs(one.delays - here.delays) > near)]
        if other:
            best, place, known, limits = _best(method, records, structure, say, [here, *other])
    for _ in range(MOST_ROUNDS):
        delays = best.point.problem.delays
        own, _ = with_delays(records, structure, [delays])
        spare = left_out(records, known) - left_out(records, own)
        few = spare <= SPARE * len(records) * records[0].n_outputs
        if np.all(delays < AT_LIMIT * limits) and few:
            break
        known, limits = with_delays(records, structure, [delays])
        located = Located(DelayPlace(delays, best.point.poles), limits)
        best = method.maximise(records, known, say, located)
        best.curvature.refuse_undetermined()
    rivals = [*place.rivals, (place.delays, place.poles)] if place.poles.size else []
    spread, words = other_delays(best, rivals)
    return replace(best.told(*repeated_inputs(records), *words), spread=spread)


def _best(
    method: Maximiser,
    records: Sequence[Record],
    structure: Structure,
    say: Progress,
    places: Sequence[DelayPlace],
) -> tuple[Reached, DelayPlace, Structure, Array]:
    """The end of lowest cost, its place, and the structure and limits that all were finished with.

    All are finished on the samples that the longest of the delays allows.
    """
    known, limits = with_delays(records, structure, [place.delays for place in places])
    found, refusals = [], []
    for place in places:
        try:
            reached = method.maximise(records, known, say, Located(place, limits))
            reached.curvature.refuse_undetermined()
            found.append((reached, place))
        except IdentifiabilityError as refusal:
            refusals.append(refusal)
    if not found:
        raise refusals[0]
    samples = float(sum(record.y.size for record in records))

    def cost(one: tuple[Reached, DelayPlace]) -> float:
        own = with_delays(records, structure, [one[0].point.problem.delays])[0]
        return one[0].aicc + price(left_out(records, own), samples)

    return (*min(found, key=cost), known, limits)
