"""What validation gives back: the tests, what they found, and the verdict in words."""

from __future__ import annotations

import html
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.likelihood.setup.raster import are_even
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.writing.layout import format_p, format_table, html_table

_WIDTH = 78
"""Characters a line: fits a terminal of 80."""


@dataclass(frozen=True, eq=False)
class Whiteness:
    """Autocorrelation of the residual of one output (whitened where the noise has a model).

    Attributes
    ----------
    output : str
    lags : ndarray, shape (n_lags,)
        [s]; of uneven time the typical step times the number of samples.
    autocorrelation, bound : ndarray, shape (n_lags,)
        Less what the fit alone makes of white noise; white noise lies within plus or minus
        ``bound`` with the probability ``level`` at each lag.
    tested_lags : tuple of int
        Over how many lags [samples] each Ljung-Box statistic runs.
    statistics, p_values : tuple of float
    p_value : float
        Of all together.
    """

    output: str
    lags: Array
    autocorrelation: Array
    bound: Array
    tested_lags: tuple[int, ...]
    statistics: tuple[float, ...]
    p_values: tuple[float, ...]
    p_value: float


@dataclass(frozen=True, eq=False)
class CrossCorrelation:
    """Correlation of one output's residual with one input, both whitened by the noise's model.

    Attributes
    ----------
    output, input : str
    lags : ndarray, shape (2 n_lags + 1,)
        [s]; positive where the input comes first.
    correlation, bound : ndarray, shape (2 n_lags + 1,)
        A model that misses nothing stays within plus or minus ``bound`` with the probability
        ``level`` at each lag.
    p_value : float
        Of this input's past and present, all lags together.
    """

    output: str
    input: str
    lags: Array
    correlation: Array
    bound: Array
    p_value: float


@dataclass(frozen=True, eq=False)
class Normality:
    """Distribution of one output's residual (whitened where the noise has a model).

    Attributes
    ----------
    output : str
    skewness, kurtosis : float
        Zero for Gaussian noise.
    p_value : float
        D'Agostino and Pearson's test.
    outliers : ndarray, shape (n_outliers, 3)
        Position of the experiment, time [s], and distance in standard deviations of the others.
    shocks : ndarray, shape (n_shocks, 3)
        The same where a disturbance sets in, which goes on as the noise does.
    """

    output: str
    skewness: float
    kurtosis: float
    p_value: float
    outliers: Array
    shocks: Array


@dataclass(frozen=True, eq=False)
class Stationarity:
    """Whether level, size and coefficients stay the same over the record, for one output.

    Attributes
    ----------
    output : str
    level_p_value, scale_p_value, coefficients_p_value : float
    edges : ndarray, shape (n_stretches + 1,)
        Of the stretches [samples, over all experiments].
    scales : ndarray, shape (n_stretches,)
        Standard deviation of the residual in each of them.
    """

    output: str
    level_p_value: float
    scale_p_value: float
    coefficients_p_value: float
    edges: Array
    scales: Array


@dataclass(frozen=True, eq=False)
class Transfer:
    """How an estimate carries over to a record it was not made from.

    Attributes
    ----------
    expected_fit : ndarray, shape (n_outputs,)
        Fit [percent] that its noise and its standard errors lead to expect: as good as can be.
    size_ratio : ndarray, shape (n_outputs,)
        Size of the residual over that expectation.
    size_p_values : ndarray, shape (n_outputs,)
    coefficients_p_value : float
        That the coefficients of this record are the same, given the standard errors; ``nan``
        where the estimate has none.
    """

    expected_fit: Array
    size_ratio: Array
    size_p_values: Array
    coefficients_p_value: float


ABOUT_NOISE = (
    "noise-model",
    "noise-changes",
    "noise-size",
    "bad-samples",
    "distribution",
    "quantisation",
)
"""Findings that leave the model itself standing."""


@dataclass(frozen=True)
class Check:
    """One test of the family that the verdict rests on.

    Attributes
    ----------
    name, output : str
    p_value : float
        ``nan`` where it could not be made.
    rejected : bool
        By Holm's procedure over all tests together.
    """

    name: str
    output: str
    p_value: float
    rejected: bool


@dataclass(frozen=True, eq=False, repr=False)
class Validation:
    """Whether an estimate can be trusted, by what its residual shows.

    Attributes
    ----------
    fit : ndarray, shape (n_outputs,)
        ``100 (1 - |y - fitted| / |y - mean|)`` [percent] (NRMSE).
    r2 : ndarray, shape (n_outputs,)
        ``1 - var(y - fitted) / var(y)``: Young's coefficient of determination of the simulated
        output.
    whiteness : tuple of Whiteness
        One per output.
    cross_correlation : tuple of CrossCorrelation
        One per output and input, output by output.
    normality : tuple of Normality
    stationarity : tuple of Stationarity
    transfer : Transfer or None
        None on the record that was identified.
    tests : tuple of Check
        All that the verdict rests on.
    findings : tuple of Finding
        What speaks against the estimate first.
    verdict : str
        One or two sentences.
    notes : tuple of str
        What was looked at, and what could not be tested.
    level : float
        Probability that a right model is called ``ok``.
    own : bool
        Whether the record is the identified one.
    output_names, input_names : tuple of str
    times : tuple of ndarray, one (n_samples,) per experiment
        [s]
    residual, innovations : tuple of ndarray, one (n_samples, n_outputs) per experiment
        As it is; and white with variance one if model and noise are right. ``nan`` where missing.
    units : dict of str to str
        Of the channels.
    uneven : bool
        Whether time is uneven, so that lags count samples.

    References
    ----------
    L. Ljung, *System Identification*, 2nd ed., chapter 16 (1999). P. Young, *Recursive Estimation
    and Time-Series Analysis*, 2nd ed. (2011), for R2_T.

    Examples
    --------
    >>> from tridentify import Record, Structure, TransferFunction, identify, simulate, validate
    >>> rng = np.random.default_rng(1)
    >>> u = np.repeat(rng.choice([-1.0, 1.0], 50), 4)
    >>> y = simulate(TransferFunction([2.0], [1.0, 2.0]), Record(u, u, dt=0.1))[:, 0]
    >>> record = Record(u, y + 0.1 * rng.standard_normal(200), dt=0.1)
    >>> found = validate(identify(record, Structure(1, 0)), record)
    >>> found.ok, [test.name for test in found.tests[:3]]
    (True, ['white', 'past inputs', 'feedback'])
    """

    fit: Array
    r2: Array
    whiteness: tuple[Whiteness, ...]
    cross_correlation: tuple[CrossCorrelation, ...]
    normality: tuple[Normality, ...]
    stationarity: tuple[Stationarity, ...]
    transfer: Transfer | None
    tests: tuple[Check, ...]
    findings: tuple[Finding, ...]
    verdict: str
    notes: tuple[str, ...]
    level: float
    own: bool
    output_names: tuple[str, ...]
    input_names: tuple[str, ...]
    times: tuple[Array, ...]
    residual: tuple[Array, ...]
    innovations: tuple[Array, ...]
    units: dict[str, str]
    uneven: bool = False

    def __post_init__(self) -> None:
        _freeze(self)

    @property
    def ok(self) -> bool:
        """Whether nothing serious was found."""
        return not any(finding.matters for finding in self.findings)

    @property
    def model_ok(self) -> bool:
        """Whether nothing serious but the description of the noise was found."""
        return not any(f.matters and f.code not in ABOUT_NOISE for f in self.findings)

    def __repr__(self) -> str:
        return f"Validation({'ok' if self.ok else 'not ok'}: {self.verdict})"

    def summary(self) -> str:
        """Fixed-width text: verdict, findings with remedies, fit, tests."""
        lines = ["=" * _WIDTH, *textwrap.wrap(self.verdict, _WIDTH), "=" * _WIDTH]
        for finding in self.findings:
            lines += finding.lines(_WIDTH)
        lines += [""] if self.findings else []
        lines += [*format_table(("output", "fit [%]", "expected", "R2_T", ""), self._fits()), ""]
        lines += format_table(("test", "p-value", "output"), self._rows())
        lines.append("")
        for note in self.notes:
            lines += textwrap.wrap(note, _WIDTH, initial_indent="- ", subsequent_indent="  ")
        return "\n".join(line.rstrip() for line in (*lines, "=" * _WIDTH))

    def _fits(self) -> list[tuple[str, ...]]:
        expected = ["" for _ in self.output_names]
        if self.transfer is not None:
            expected = [f"{value:.2f}" for value in self.transfer.expected_fit]
        rows = zip(self.output_names, self.fit, expected, self.r2, strict=True)
        return [(name, f"{fit:.2f}", best, f"{r2:.4f}", "") for name, fit, best, r2 in rows]

    def _rows(self) -> list[tuple[str, ...]]:
        return [
            (test.name, format_p(test.p_value) + "*" * test.rejected, test.output)
            for test in self.tests
        ]

    def _repr_html_(self) -> str:
        colour = "#00664a" if self.ok else "#a63c00"
        parts = [f'<p style="color:{colour}"><b>{html.escape(self.verdict)}</b></p>']
        if self.findings:
            # a list, since the cells of a table do not wrap everywhere
            parts.append(f"<ul>{''.join(map(_item, self.findings))}</ul>")
        parts.append(html_table(("output", "fit [%]", "expected", "R2_T", ""), self._fits()))
        parts.append(html_table(("test", "p-value", "output"), self._rows()))
        return "".join(parts)

    def to_dict(self) -> dict[str, Any]:
        """All of it but the samples, as plain lists, numbers and text; ``nan`` as None."""
        left = ("times", "residual", "innovations")
        document = {"ok": self.ok, "model_ok": self.model_ok}
        return document | {
            field.name: _plain(getattr(self, field.name))
            for field in fields(self)
            if field.name not in left
        }


def untested(
    estimate: Estimate,
    records: Sequence[Record],
    level: float,
    *,
    own: bool,
    fits: tuple[Array, Array],
    residual: tuple[Array, ...],
    verdict: str,
    notes: tuple[str, ...],
    findings: tuple[Finding, ...] = (),
) -> Validation:
    """A validation before anything is tested, its innovations zero.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
    level : float
    own : bool
    fits : tuple of (n_outputs,) arrays
        Fit [percent] and R2.
    residual : tuple of (n_samples, n_outputs) arrays
    verdict : str
    notes : tuple of str
    findings : tuple of Finding
    """
    return Validation(
        fit=fits[0],
        r2=fits[1],
        whiteness=(),
        cross_correlation=(),
        normality=(),
        stationarity=(),
        transfer=None,
        tests=(),
        findings=findings,
        verdict=verdict,
        notes=notes,
        level=level,
        own=own,
        output_names=estimate.output_names,
        input_names=estimate.input_names,
        times=tuple(np.array(record.t) for record in records),
        residual=residual,
        innovations=tuple(np.zeros_like(one) for one in residual),
        units=dict(estimate.units),
        uneven=not are_even(records),
    )


def _item(finding: Finding) -> str:
    """What was found, how much it matters and what to do, as an item of a list."""
    said = html.escape(f"{finding.message} {finding.effect}".strip())
    remedy = f"<br><b>What to do:</b> {html.escape(finding.remedy)}" if finding.remedy else ""
    return f"<li>{said}{remedy}</li>"


def _freeze(value: object) -> None:
    if isinstance(value, np.ndarray):
        value.setflags(write=False)
    elif isinstance(value, tuple):
        for one in value:
            _freeze(one)
    elif is_dataclass(value):
        for field in fields(value):
            _freeze(getattr(value, field.name))


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, (tuple, list, np.ndarray)):
        return [_plain(one) for one in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value
