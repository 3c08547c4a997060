"""Several models on several records, each simulated and judged alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tridentify.errors import ChannelNameError, SampleTypeError, shown
from tridentify.judgement.comparison.entries import Entry, Models, entries_of, integrates, made_up
from tridentify.judgement.comparison.quantities import quantities
from tridentify.judgement.comparison.refit import refitted
from tridentify.judgement.comparison.result import Comparison
from tridentify.numerics.arrays import Array
from tridentify.numerics.threads import one_blas_thread
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction

EXAMPLE = "compare([one, other], record)"


def compare(
    estimates: Models | Record | Sequence[Record],
    records: Record | Sequence[Record] | Models,
    *more: Any,
    names: Sequence[str] | None = None,
) -> Comparison:
    """Simulate every model on every record, its start and offset fitted to that record.

    Parameters
    ----------
    estimates : Estimate, TransferFunction, sequence of these, or mapping of names to them
        Of any orders and methods. They are held.
    records : Record or sequence of Record
        Any that have the inputs of the models: those that were identified, or others.
    *more
        More models, as in MATLAB: ``compare(record, one, other)`` is understood too.
    names : sequence of str, optional
        One a model; by default the keys of a mapping, the orders where they differ, else the
        methods.

    Returns
    -------
    Comparison

    Raises
    ------
    SampleTypeError
        Something is no model or no record, or there are no records.
    ChannelNameError
        A record lacks an input or all outputs of a model.
    OptionError
        There is no model, or the names are not as many.

    Notes
    -----
    To each record belong an initial state, an offset (the trim of inputs and outputs), and a drift
    where the model was identified with one; of a transfer function where it integrates, since the
    unknown trim of an input is a ramp then. They are fitted by least squares, the same for every
    model, so that a model of another flight is judged by its dynamics and not by its trim.
    `Estimate.predict` holds them instead. The samples count alike: where the noise is coloured, the
    fit by a model of the noise is another (`validate`).

    Channels are matched by name; by position where a model or a record was given no names. The time
    grows with the samples.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, TransferFunction, compare, simulate
    >>> u = np.repeat([0.0, 1.0, -1.0, 0.5], 50)
    >>> y = simulate(TransferFunction([2.0], [1.0, 2.0]), Record(u, u, dt=0.05))
    >>> models = {"right": TransferFunction([2.0], [1.0, 2.0]),
    ...           "slow": TransferFunction([1.0], [1.0, 1.0])}
    >>> compare(models, Record(u, 5.0 + y, dt=0.05)).fits[:, 0, 0].round(1).tolist()
    [100.0, 64.0]
    """
    models, given = _sorted_out((estimates, records, *more))
    entries = entries_of(models, names, example=EXAMPLE)
    seen = tuple(_with_names(record, entries) for record in given)
    called = _record_names(given)
    pairs = [
        [_matched(entry, record, name) for record, name in zip(seen, called, strict=True)]
        for entry in entries
    ]
    outputs = tuple(
        dict.fromkeys(name for row in pairs for pair in row for name in pair.record.output_names)
    )
    with one_blas_thread():
        responses = tuple(tuple(_response(pair, outputs) for pair in row) for row in pairs)
    measured = [_columns(record.output_names, record.y, outputs) for record in seen]
    fits = np.array(
        [[_fit(y, own) for y, own in zip(measured, row, strict=True)] for row in responses]
    )
    return Comparison(
        fits,
        responses,
        tuple(entry.name for entry in entries),
        called,
        outputs,
        seen,
        entries,
        quantities(entries),
        _notes(entries, called, pairs, outputs, fits),
    )


@dataclass(frozen=True, eq=False)
class _Pair:
    """A model and a record on the channels that they share, in one order."""

    model: TransferFunction
    record: Record
    drift: int


def _sorted_out(given: Sequence[Any]) -> tuple[Any, tuple[Record, ...]]:
    """Models and records, in whatever order they were given."""
    data = [one for one in given if _is_data(one)]
    models = [one for one in given if not _is_data(one)]
    if len(data) != 1 or not models:
        found = ", ".join(shown(type(one).__name__) for one in given)
        raise SampleTypeError(
            f"found {found}; expected models (Estimate or TransferFunction, or several) and a "
            f"Record or a list of records; write {EXAMPLE}"
        )
    records = (data[0],) if isinstance(data[0], Record) else tuple(data[0])
    if len(models) == 1:
        return models[0], records
    flat: list[Any] = []
    for one in models:
        many = isinstance(one, Sequence) and not isinstance(one, str)
        flat += list(one) if many else [one]
    return flat, records


def _is_data(one: Any) -> bool:
    if isinstance(one, Record):
        return True
    several = isinstance(one, Sequence) and not isinstance(one, str) and len(one) > 0
    return several and all(isinstance(item, Record) for item in one)


def _with_names(record: Record, entries: Sequence[Entry]) -> Record:
    """A record without names under those of the first model that has some and fits."""
    if not made_up(record.input_names, record.output_names):
        return record
    for entry in entries:
        counts = (len(entry.input_names), len(entry.output_names))
        if not entry.unnamed and counts == (record.n_inputs, record.n_outputs):
            own = {n: record.units[n] for n in record.reference_names if n in record.units}
            return record._derive(
                input_names=entry.input_names,
                output_names=entry.output_names,
                units={**entry.units, **own},
            )
    return record


def _matched(entry: Entry, record: Record, name: str) -> _Pair:
    """The model's outputs that the record has, and the record's channels in the model's order."""
    inputs, outputs = entry.input_names, entry.output_names
    if entry.unnamed and (len(inputs), len(outputs)) == (record.n_inputs, record.n_outputs):
        inputs, outputs = record.input_names, record.output_names
    missing = [one for one in inputs if one not in record.input_names]
    kept = [i for i, one in enumerate(outputs) if one in record.output_names]
    if missing or not kept:
        what = f"input {missing[0]!r}" if missing else f"output {shown(', '.join(outputs))}"
        raise ChannelNameError(
            f"found no {what} of {entry.name!r} in {name!r}, which has "
            f"{shown(', '.join(record.input_names), 60)} -> "
            f"{shown(', '.join(record.output_names), 60)}; expected the channels of the model; "
            "name the record's channels as the model's"
        )
    seen = record.select(inputs, [outputs[i] for i in kept])
    if entry.estimate is not None:
        seen = seen.settled(entry.estimate.intersample)
        drift = entry.estimate.structure.drift_degree
    else:
        drift = int(integrates(entry.model, record.duration))
    model = TransferFunction(
        [list(entry.model.num[i]) for i in kept],
        [list(entry.model.den[i]) for i in kept],
        delay=entry.model.delay[kept].tolist(),
    )
    return _Pair(model, seen, drift)


def _response(pair: _Pair, outputs: Sequence[str]) -> Array:
    found = refitted(pair.model, pair.record, drift=pair.drift)
    return _columns(pair.record.output_names, found, outputs)


def _columns(names: Sequence[str], values: Array, outputs: Sequence[str]) -> Array:
    """Columns in the order of the outputs; nan for one that is not there."""
    found = np.full((values.shape[0], len(outputs)), np.nan)
    for column, name in enumerate(names):
        if name in outputs:
            found[:, list(outputs).index(name)] = values[:, column]
    return found


def _fit(measured: Array, response: Array) -> list[float]:
    """NRMSE of every output over the samples that both have [percent]."""
    found = []
    for y, fitted in zip(measured.T, response.T, strict=True):
        seen = np.isfinite(y) & np.isfinite(fitted)
        spread = float(np.linalg.norm(y[seen] - y[seen].mean())) if np.any(seen) else 0.0
        left = float(np.linalg.norm(y[seen] - fitted[seen]))
        found.append(100.0 * (1.0 - left / spread) if spread > 0 else np.nan)
    return found


def _record_names(records: Sequence[Record]) -> tuple[str, ...]:
    """Names of the records, numbered where they have none or one twice."""
    given = [record.name for record in records]
    if len(records) == 1:
        return (given[0] or "record",)
    return tuple(
        name if name and given.count(name) == 1 else f"{name or 'record'} {k}"
        for k, name in enumerate(given, 1)
    )


def _notes(
    entries: Sequence[Entry],
    called: Sequence[str],
    pairs: Sequence[Sequence[_Pair]],
    outputs: Sequence[str],
    fits: Array,
) -> tuple[str, ...]:
    """Why fits are missing where model and record have the output."""
    told = []
    for k, r, i in np.argwhere(np.isnan(fits)).tolist():
        pair, output = pairs[k][r], outputs[i]
        if output not in pair.record.output_names:
            continue
        y = pair.record.y[:, pair.record.output_names.index(output)]
        if np.nanmax(y) == np.nanmin(y):
            told.append(f"no fit of {output} in {called[r]}: the record does not move")
        elif float(np.max(pair.model.delay)) > pair.record.duration:
            told.append(f"no fit of {entries[k].name} in {called[r]}: its delay is longer")
        else:
            told.append(
                f"no fit of {output} by {entries[k].name} in {called[r]}: the model is unstable, "
                f"and over {pair.record.duration:.3g} s its response drowns in rounding; compare "
                "shorter stretches (record.slice)"
            )
    return tuple(dict.fromkeys(told))
