"""Instants that are all but a uniform raster: jittered stamps, and rows that are missing.

An autoregression is a model of evenly spaced samples. Stamps that jitter by a few per cent of the
step still are, as far as noise is concerned: the correlation of noise over a step changes by less
than it is known to, while the response is computed at the stamps themselves. A row that is missing
from a raster is a sample that was not recorded: put back without an output, and with the input that
lay there (the last value, or the line between the neighbours), it changes the response in nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.arrays import Array
from tridentify.record.record import Record

Places = NDArray[np.intp]

JITTER = 0.1
"""Largest departure of a step from a whole number of steps, in steps."""

FULL = 0.5
"""Share of the raster that must be there."""


def places_on_raster(t: Array) -> Places | None:
    """Where samples stand on a raster, from 0; None where their instants are none.

    Parameters
    ----------
    t : (n_samples,) array
        Rising.

    Examples
    --------
    >>> places_on_raster(np.array([0.0, 1.01, 2.0, 4.99, 6.0, 7.0])).tolist()
    [0, 1, 2, 5, 6, 7]
    >>> places_on_raster(np.array([0.0, 1.0, 2.4, 3.1])) is None
    True
    """
    steps = np.diff(t)
    dt = float(np.median(steps))
    whole = np.round(steps / dt)
    if np.any(whole < 1) or np.any(np.abs(steps / dt - whole) > JITTER * whole):
        return None
    found = np.concatenate([[0], np.cumsum(whole)]).astype(np.intp)
    return found if t.size >= FULL * (found[-1] + 1) else None


def even_step(record: Record) -> float | None:
    """Step of a record whose samples are evenly spaced, or all but; None where they are not.

    Parameters
    ----------
    record : Record
        Rows that are missing from its raster make it uneven (`on_raster` puts them back).

    Examples
    --------
    >>> jittered = Record([0, 1, 1], [1, 2, 3], t=[0.0, 1.01, 2.0], intersample="foh")
    >>> even_step(jittered), even_step(Record([0, 1, 1], [1, 2, 3], t=[0.0, 1.0, 3.0]))
    (1.0, None)
    """
    if record.dt is not None:
        return record.dt
    places = places_on_raster(np.asarray(record.t))
    if places is None or places[-1] + 1 != record.n_samples:
        return None
    return float(np.median(np.diff(record.t)))


def are_even(records: Sequence[Record]) -> bool:
    """Whether one model of the noise serves all records: evenly spaced, with one step."""
    steps = [even_step(record) for record in records]
    known = [step for step in steps if step is not None]
    return len(known) == len(steps) and max(known) - min(known) <= JITTER * min(known)


def spread_out(series: Array, places: Places) -> Array:
    """Rows on their places, ``nan`` between them."""
    found = np.full((int(places[-1]) + 1, *series.shape[1:]), np.nan)
    found[places] = series
    return found


def _filled(samples: Array, behaviour: str, times: Array, places: Places) -> Array:
    """An input, or a reference, on every place of a raster."""
    every = np.arange(places[-1] + 1)
    if behaviour == "zoh":
        return np.asarray(samples[np.searchsorted(places, every, "right") - 1])
    t = np.interp(every, places, times)
    return np.column_stack([np.interp(t, times, one) for one in samples.T])


def on_raster(record: Record) -> Record:
    """The record with the rows that are missing from its raster, without outputs; else itself.

    Parameters
    ----------
    record : Record

    Examples
    --------
    >>> record = Record([0, 1, 1, 3], [1, 2, 3, 5], t=[0, 1, 2, 4], intersample="foh")
    >>> full = on_raster(record)
    >>> full.dt, full.u.ravel().tolist(), full.y.ravel().tolist()
    (1.0, [0.0, 1.0, 1.0, 2.0, 3.0], [1.0, 2.0, 3.0, nan, 5.0])
    """
    if record.dt is not None or record.behaviour == "band-limited":
        return record
    places = places_on_raster(np.asarray(record.t))
    if places is None or places[-1] + 1 == record.n_samples:
        return record
    t = np.interp(np.arange(places[-1] + 1), places, record.t)
    u, driven = _filled(record.u, record.behaviour, record.t, places), record.reference
    if driven is not None:
        driven = _filled(driven, str(record.reference_behaviour), record.t, places)
    return Record(
        u,
        spread_out(np.asarray(record.y), places),
        t=t,
        intersample=record.behaviour,
        **{**record._loop, "reference": driven},
        input_names=record.input_names,
        output_names=record.output_names,
        units=record.units,
    )._weighed(record._noise_scale)
