"""``tridentify identify``: files and a structure in, coefficients with standard errors out."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from tridentify.cli import options, tables
from tridentify.cli.ask import (
    chooses_orders,
    chosen_method,
    nested_delays,
    nested_poles,
    nested_zeros,
)
from tridentify.cli.knowledge import known_from
from tridentify.cli.load import RecordSource, load, rules_from, units_from
from tridentify.cli.results import ResultFolder
from tridentify.cli.run import estimate_model, load_sample_loop, show_estimate, write_results
from tridentify.cli.terminal import Activity, show_json
from tridentify.estimation.methods.base import Method
from tridentify.structure import AutoStructure, Structure


def identify(
    files: options.Files,
    inputs: options.Inputs,
    outputs: options.Outputs,
    poles: options.PolesOrAuto = None,
    zeros: options.ZerosOrAuto = None,
    time: options.Time = None,
    dt: options.Step = None,
    intersample: options.Intersample = options.Between.AUTO,
    instants: options.Instants = options.Merging.AUTO,
    missing: options.Missing = None,
    units: options.Units = None,
    start: options.Start = None,
    stop: options.Stop = None,
    delay: options.Delay = None,
    offset: options.Offset = options.Choice.AUTO,
    drift: options.Drift = None,
    initial_state: options.InitialState = options.Beginning.AUTO,
    fixed: options.Fixed = None,
    bounds: options.Limits = None,
    priors: options.Priors = None,
    gains: options.Gains = None,
    method: options.Method = "three-model",
    noise: options.NoiseModel = options.Noise.AUTO,
    loss: options.Losses = options.Loss.SQUARED,
    out: options.Out = None,
    title: options.Title = None,
    as_json: options.AsJson = False,
) -> None:
    """Identify the coefficients of a model from records in files.

    Without --poles the orders are chosen. Example: tridentify identify flight.csv --input elevator
    --output q --poles 2 --zeros 1
    """
    source = RecordSource(
        files,
        tuple(inputs),
        tuple(outputs),
        time,
        dt,
        intersample.value,
        start,
        stop,
        instants.value,
        units_from(units or ()),
        rules_from(missing or ()),
    )
    shape = len(outputs), len(inputs)
    template = Structure(
        1,
        0,
        delay=nested_delays(delay or (), *shape),
        offset=offset.answer,
        drift=None if drift is None else drift.answer,
        initial_state=initial_state.value,
    )
    known = known_from(fixed or (), bounds or (), priors or (), gains or ())
    structure: Structure | AutoStructure
    if chooses_orders(poles or (), zeros or (), bool(fixed or bounds or priors or gains)):
        structure = AutoStructure(template=template)
    else:
        structure = replace(
            template,
            poles=nested_poles(poles or (), *shape),
            zeros=nested_zeros(zeros or (), *shape),
            **known,
        )
    _answer(source, structure, chosen_method(method, noise, loss), out, title, as_json)


def _answer(
    source: RecordSource,
    structure: Structure | AutoStructure,
    method: Method,
    out: Path | None,
    title: str | None,
    as_json: bool,
) -> None:
    """Read, estimate, write, print."""
    written: Sequence[Path] = ()
    with ExitStack() as stack:
        results = None if out is None else stack.enter_context(ResultFolder(out))
        activity = stack.enter_context(Activity())
        records = load(source, activity)
        load_sample_loop(activity)
        estimate = estimate_model(records, structure, method, activity.stage)
        if results is not None:
            write_results(estimate, records, results.draft, activity, title)
            written = results.publish()
    if as_json:
        document = tables.estimate_document(estimate, records)
        show_json(document | {"files": [str(path) for path in written]})
    else:
        show_estimate(estimate, records, written)
