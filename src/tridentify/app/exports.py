"""A model as files of other programs, made in a folder of their own and handed over as bytes."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np

from tridentify.checks.samples import typical_step
from tridentify.errors import OptionError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.export import write_c_header, write_matlab
from tridentify.record.record import Record
from tridentify.report import write_report
from tridentify.uncertainty import poles

Records = Sequence[Record] | None
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
        raise OptionError(
            f"found the file {shown(kind)}; expected one of {', '.join(KINDS)}; choose one"
        )
    ending, media, write = KINDS[kind]
    file = re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_") or "model"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"{file}{ending}")
        write(estimate, records, path)
        return path.name, media, path.read_bytes()


def _json(estimate: Estimate, records: Records, path: Path) -> None:
    estimate.save(path)


def _matlab(estimate: Estimate, records: Records, path: Path) -> None:
    write_matlab(estimate, path)


def _c(estimate: Estimate, records: Records, path: Path) -> None:
    fastest = float(np.max(np.abs(poles(estimate).roots), initial=1.0))
    dt = typical_step(records[0].t) if records else 1.0 / (PER_MODE * fastest)
    write_c_header(estimate, dt, path)


def _control(estimate: Estimate, records: Records, path: Path) -> None:
    model = estimate.model
    num, den = (
        [[list(map(float, cell)) for cell in row] for row in of] for of in (model.num, model.den)
    )
    delays = [[float(value) for value in row] for row in np.asarray(model.delay)]
    lines = [
        '"""A model for python-control."""',
        "",
        "import control",
        "",
        f"num = {num!r}",
        f"den = {den!r}",
        f"delay = {delays!r}  # seconds, not part of the transfer function",
        "model = control.TransferFunction(num, den)",
        f"model.input_labels = {list(estimate.input_names)!r}",
        f"model.output_labels = {list(estimate.output_names)!r}",
        "",
    ]
    path.write_text("\n".join(lines), encoding="utf-8")


def _report(estimate: Estimate, records: Records, path: Path) -> None:
    write_report(estimate, list(records or ()), path)


def _figure(estimate: Estimate, records: Records, path: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    from tridentify.plots import plot_fit

    figure = plot_fit(estimate, (records or ())[0])[0].get_figure(root=True)
    assert figure is not None
    figure.savefig(path, format="svg")
    plt.close("all")


def _table(estimate: Estimate, records: Records, path: Path) -> None:
    rows = ["name,value,standard error,95 % from,to,unit"]
    for one in estimate.parameters.values():
        low, high = one.interval(0.95)
        rows.append(f"{one.name},{one.value!r},{one.std!r},{low!r},{high!r},{one.unit}")
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")


Write = Callable[[Estimate, Records, Path], None]

KINDS: Mapping[str, tuple[str, str, Write]] = MappingProxyType(
    {
        "json": (".json", "application/json", _json),
        "matlab": (".m", "text/plain", _matlab),
        "c": (".h", "text/plain", _c),
        "control": (".py", "text/x-python", _control),
        "report": (".html", "text/html", _report),
        "figure": (".svg", "image/svg+xml", _figure),
        "table": (".csv", "text/csv", _table),
    }
)
"""What a model can leave as: ending, media type, writer."""
