"""A model as a file that the browser saves: its name, its media type, its bytes."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np

from tridentify.app.plain import saved_as
from tridentify.errors import OptionError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.export import to_bytes
from tridentify.record.checks.times import typical_step
from tridentify.record.record import Record
from tridentify.report import write_report
from tridentify.uncertainty import poles

Records = Sequence[Record] | None
Content = Callable[[Estimate, Records, str], bytes]
PER_MODE = 20.0
"""Steps of a filter in C per time constant of the fastest pole, where no record tells a step."""


def exported(estimate: Estimate, records: Records, kind: str, name: str) -> tuple[str, str, bytes]:
    """One file of a model.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record or None
        What it was estimated from, for the report and the figure.
    kind : str
        A key of `KINDS`.
    name : str
        Of the model.

    Returns
    -------
    name, media type, bytes

    Raises
    ------
    OptionError
        There is no such kind.
    """
    if kind not in KINDS:
        raise OptionError.found("the file ", kind, f"one of {', '.join(KINDS)}", "choose one")
    ending, media, content = KINDS[kind]
    file = saved_as(name, ending)
    return file, media, content(estimate, records, file.removesuffix(ending))


def _written(ending: str, estimate: Estimate, records: Records, name: str) -> bytes:
    return to_bytes(estimate, ending, dt=_step(estimate, records), name=name)


def _step(estimate: Estimate, records: Records) -> float:
    """Of the record, so that the filter runs where the model was recorded."""
    if estimate.dt is not None:
        return estimate.dt
    fastest = float(np.max(np.abs(poles(estimate).roots), initial=1.0))
    return typical_step(records[0].t) if records else 1.0 / (PER_MODE * fastest)


def _report(estimate: Estimate, records: Records, name: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return write_report(estimate, list(records or ()), Path(folder, "report.html")).read_bytes()


def _figure(estimate: Estimate, records: Records, name: str) -> bytes:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    from tridentify.plots import plot_fit

    figure = plot_fit(estimate, (records or ())[0])[0].get_figure(root=True)
    assert figure is not None
    content = io.BytesIO()
    figure.savefig(content, format="svg")
    plt.close("all")
    return content.getvalue()


KINDS: Mapping[str, tuple[str, str, Content]] = MappingProxyType(
    {
        "json": (".json", "application/json", partial(_written, ".json")),
        "matlab": (".m", "text/plain", partial(_written, ".m")),
        "c": (".h", "text/plain", partial(_written, ".h")),
        "control": (".py", "text/x-python", partial(_written, ".py")),
        "report": (".html", "text/html", _report),
        "figure": (".svg", "image/svg+xml", _figure),
        "table": (".csv", "text/csv", partial(_written, ".csv")),
    }
)
"""What a model can leave as: ending, media type, content."""
