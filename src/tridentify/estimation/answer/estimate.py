"""What an estimation gives back: the model, its uncertainty, and how it was reached.

An `Estimate` is a value: it holds arrays, not the data. Its covariance is that of ``theta``, the
physical coefficients in the order of ``names``. What derives from them (natural frequency, damping,
gain, confidence bands) is propagated to first order, see `tridentify.numerics.delta_method`.
"""

from __future__ import annotations

import dataclasses
import html
import os
import re
import textwrap
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from tridentify.errors import DataError, ParameterNameError, ShapeError, shown
from tridentify.estimation.answer.encoding import (
    LEFT_OUT,
    check_covariance,
    check_draws,
    check_model,
    check_noise,
    check_nuisance,
    check_outliers,
    check_route,
    check_sampling,
    decode,
    load_document,
    save_document,
)
from tridentify.estimation.answer.finding import Finding, beside_errors
from tridentify.estimation.answer.loop_taken import LoopTaken
from tridentify.estimation.answer.parameter import NOT_DETERMINED, Nuisance, Parameter
from tridentify.estimation.answer.trace import Pass, Start, Status, Step, Trace, freeze_arrays
from tridentify.numerics import delta_method
from tridentify.numerics.arrays import Array
from tridentify.numerics.root_draws import pole_values
from tridentify.record.checks.names import check_names, check_units
from tridentify.record.checks.samples import check_distinct, checked_units
from tridentify.record.record import Record, in_memory
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction
from tridentify.writing.layout import (
    format_polynomial,
    format_std,
    format_table,
    format_value,
    html_table,
    short,
    unit_ratio,
    with_error,
)
from tridentify.writing.notebook import fraction
from tridentify.writing.views import EstimateViews

__all__ = ["Estimate", "Nuisance", "Parameter", "Pass", "Start", "Status", "Step", "Trace"]

Row = tuple[str, float, float, str]
_FOR_OTHER_ROOMS = frozenset(
    (
        "call",
        "decisions",
        "channel_draws",
        "derived_rows",
        "derived_values",
        "from_document",
        "held_note",
        "model_text",
        "noise_note",
        "nuisance_rows",
        "offset_note",
        "route_note",
    )
)
"""What tables, pages and files are made of: not offered to those who look an estimate over."""
SCHEMA = 2
"""Version of the file format: raised when a field is added, dropped or changes its meaning."""
ROUTES = MappingProxyType(
    {
        "open-loop": "",
        "reference": "by the reference route: a controller was running, and only what of input and "
        "output follows the reference counts",
        "direct": "by the direct route: a controller was running and no reference is given, so "
        "that the noise has a model, on which the coefficients depend",
    }
)
"""Way that an estimate was reached -> what is told of it."""
HELD = 1e-17
"""A derived error below this share of its value is no error: a tenth of the rounding of a
double."""
ONE_SIGMA = 0.6826894921370859
"""Probability within one standard deviation of a Gaussian, erf(1 / sqrt 2)."""
_CRITERIA = re.compile(r"(?<=: lowest AICc) \(.*\)| \(of -2 log L: .*\)")
"""Behind a decision: how much worse the other choices are."""
_WIDTH = 78
"""Characters a line of the summary: fits a terminal of 80."""
_TITLES = ("coefficient", "value", "std error", "95 % from", "to", "unit")


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Estimate(EstimateViews):
    """An identified model with covariance, diagnostics and the trace of its estimation.

    Attributes
    ----------
    theta : ndarray, shape (n_parameters,)
        Coefficients in the order of ``names``; ``cov`` (n_parameters, n_parameters) is theirs.
    noise_variance, fit : ndarray, shape (n_outputs,)
        Variance of the residual [output units squared]; normalised fit (NRMSE) [percent].
    nuisance : tuple of Nuisance
        One per experiment.
    cost, gradient, condition : float
        Weighted mean-square output error, its relative gradient at the end, and the condition
        number of the scaled score columns; of the whitened output error where the noise has a
        model.
    noise_model : tuple of ndarray, one (p,) per output
        Autoregressive coefficients: ``v(k) + a_1 v(k-1) + ... + a_p v(k-p)`` is white. Empty for
        white noise.
    draws : ndarray, shape (n_draws, n_parameters)
        Equally likely coefficients where the estimate is a posterior mean (``status``), else empty.
    loss : str
        What was minimised: ``"squared"``, or a robust loss, ``"huber"`` or ``"student"``. With one
        of these ``noise_variance`` is the square of the noise's robust scale, and ``fit`` leaves
        the outliers out.
    outliers : ndarray, shape (n_outliers, 4)
        Samples beyond four standard deviations of the noise under a robust loss: position of the
        experiment, of the output and of the sample, and the weight that it had (at most 1).
    findings : tuple of Finding
        What a reader should know before using the numbers, what matters most first.
    errors : {"likelihood", "scores"}
        What the covariance comes from: the curvature of the likelihood, or the scatter of the
        scores over blocks where that is clearly larger (`likelihood.scores`).
    route : {"open-loop", "reference", "direct"}
        What was made of a controller that may have been running: nothing; the parts of input and
        output that follow the reference were fitted; or the noise got a model in any case.
    loop : LoopTaken or None
        What the reference route took the loop for, or how a plant that is not stable was
        estimated; else None.
    call : str
        The method with its options, as one writes it; empty if it was not called by `identify`.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, TransferFunction, identify, simulate
    >>> u = np.sign(np.sin(np.arange(200) ** 1.5))
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.02))
    >>> estimate = identify(Record(u, y, dt=0.02), Structure(poles=1, zeros=0))
    >>> estimate.names, estimate.theta.round(6).tolist(), estimate.status.value
    (('a0', 'b0'), [4.0, 2.0], 'converged')
    """

    model: TransferFunction
    structure: Structure
    theta: Array
    names: tuple[str, ...]
    cov: Array
    noise_variance: Array
    fit: Array
    status: Status
    trace: Trace
    method: str
    n_samples: int
    nuisance: tuple[Nuisance, ...]
    degrees_of_freedom: int
    cost: float
    aicc: float
    condition: float
    gradient: float
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    units: Mapping[str, str]
    intersample: str
    dt: float | None
    record_fingerprint: str = ""
    findings: tuple[Finding, ...] = ()
    noise_model: tuple[Array, ...] = ()
    draws: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))
    loss: str = "squared"
    outliers: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 4)))
    call: str = ""
    errors: str = "likelihood"
    route: str = dataclasses.field(default="open-loop", metadata=LEFT_OUT)
    loop: LoopTaken | None = dataclasses.field(default=None, metadata=LEFT_OUT)

    def __post_init__(self) -> None:
        freeze_arrays(self)
        self._freeze_noise_model()
        if not self.draws.size:
            object.__setattr__(self, "draws", np.zeros((0, len(self.names))))
            self.draws.setflags(write=False)
        if not self.outliers.size:
            object.__setattr__(self, "outliers", np.zeros((0, 4)))
            self.outliers.setflags(write=False)
        if self.errors not in ("likelihood", "scores"):
            raise DataError(
                f"found errors={self.errors!r}; expected 'likelihood' or 'scores'; name one of them"
            )
        check_route(self.route, ROUTES)
        self._check_shapes()
        self._check_names()
        object.__setattr__(self, "units", dict(self.units))

    def _check_shapes(self) -> None:
        n_parameters, n_outputs = len(self.names), len(self.output_names)
        shapes: dict[str, tuple[int, ...]] = {"theta": (n_parameters,), "fit": (n_outputs,)}
        shapes |= {"cov": (n_parameters, n_parameters), "noise_variance": (n_outputs,)}
        for field, shape in shapes.items():
            if getattr(self, field).shape != shape:
                found = getattr(self, field).shape
                raise ShapeError(
                    f"found {field} of shape {found}; expected {shape}; order it as names"
                )

    def _check_names(self) -> None:
        """Names and units stand in tables, files and code: they are what the structure gives."""
        inputs, outputs = self.input_names, self.output_names
        check_names((*inputs, *outputs))
        check_distinct((*inputs, *outputs))
        check_units(self.units)
        # counted first: to name the coefficients of a billion poles takes for ever
        n = len(self.names)
        same = (
            len(outputs) * len(inputs) <= n
            and n == self.structure.n_parameters(len(outputs), len(inputs))
            and self.names == self.structure.names(inputs, outputs)
        )
        if not same:
            raise ParameterNameError(
                f"found the {n} coefficients {shown(self.names, 120)} of {len(outputs)} outputs "
                f"and {len(inputs)} inputs; expected those that Structure.names gives; correct them"
            )

    def _freeze_noise_model(self) -> None:
        given = self.noise_model or (np.zeros(0),) * len(self.output_names)
        if len(given) != len(self.output_names):
            raise ShapeError(
                f"found {len(given)} noise models; expected {len(self.output_names)}, one an "
                "output; give an empty one for white noise"
            )
        model = tuple(np.array(a, dtype=np.float64).reshape(-1) for a in given)
        for a in model:
            a.setflags(write=False)
        object.__setattr__(self, "noise_model", model)

    def __dir__(self) -> list[str]:
        return sorted(set(super().__dir__()) - _FOR_OTHER_ROOMS)

    def __repr__(self) -> str:
        pairs = zip(self.names, self.theta, self.std, strict=True)
        values = ", ".join(f"{name}={format_value(v, std)}" for name, v, std in pairs)
        return f"Estimate({self.method}: {self.status.value}; {values})"

    @property
    def cautions(self) -> tuple[str, ...]:
        """The findings that matter, in words: what was found, and what to do."""
        return tuple(finding.text for finding in self.findings if finding.matters)

    @property
    def std(self) -> Array:
        """Standard errors of ``theta``, shape (n_parameters,)."""
        std: Array = np.sqrt(np.maximum(np.diag(self.cov), 0.0))
        return std

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """Name -> `Parameter`, in the order of ``names``."""
        rows = zip(self.names, self.theta.tolist(), self.std.tolist(), strict=True)
        table = {
            name: Parameter(name, v, std, self._unit(name), self.draws[:, k])
            for k, (name, v, std) in enumerate(rows)
        }
        return MappingProxyType(table)

    def channel(self, output: int, input_: int) -> tuple[Array, Array, Array]:
        """Numerator, denominator and covariance of one channel.

        Parameters
        ----------
        output, input_ : int
            Positions of the channel.

        Returns
        -------
        num, den : ndarray
            Descending powers, ``den`` monic.
        cov : ndarray, shape (n + m + 2, n + m + 2)
            Of ``(a_{n-1}, ..., a_0, b_m, ..., b_0, delay)``; zero for what was not estimated.
        """
        den, num = self.model.den[output][input_], self.model.num[output][input_]
        label = f"[{self.output_names[output]},{self.input_names[input_]}]"
        position = {name: k for k, name in enumerate(self.names)}
        wanted = [f"a{k}" for k in range(len(den) - 2, -1, -1)]
        wanted += [f"b{k}" for k in range(len(num) - 1, -1, -1)]
        places = [position.get(name + label, position.get(name, -1)) for name in wanted]
        delay = f"delay[{self.input_names[input_]}]"
        places.append(position.get(delay, position.get("delay", -1)))
        where = np.array(places)
        free = where >= 0
        return num, den, np.where(free[:, None] & free, self.cov[np.ix_(where, where)], 0.0)

    def derived_rows(self) -> tuple[Row, ...]:
        """(name, value, std, unit) of poles, dampings and static gains, to first order."""
        shared = self.structure.shared
        several = len(self.input_names) * len(self.output_names) > 1
        rows: list[Row] = []
        gains: list[Row] = []
        for i, output in enumerate(self.output_names):
            for j, input_ in enumerate(self.input_names):
                num, den, cov = self.channel(i, j)
                label = f"[{output},{input_}]" if several else ""
                # what has no room in a float is shown as infinite or nan
                with np.errstate(all="ignore"):
                    gain = delta_method.dc_gain(num, den, cov)
                    n, where = len(den) - 1, "" if shared else label
                    if not shared or (i, j) == (0, 0):
                        poles = delta_method.pole_quantities(den, cov[:n, :n])
                        rows += [(row[0] + where, *row[1:]) for row in poles]
                unit = self._ratio_unit(output, input_, 0)
                gains.append(("dc gain" + label, *gain, unit))
        # below the rounding of the value there is no error, as of a frequency that is held
        return tuple(
            (name, value, 0.0 if std <= HELD * abs(value) else std, unit)
            for name, value, std, unit in rows + gains
        )

    def channel_draws(self, theta: Array, output: int, input_: int) -> tuple[Array, Array, Array]:
        """Polynomials of one channel for many coefficient vectors.

        Parameters
        ----------
        theta : ndarray, shape (n_draws, n_parameters)
        output, input_ : int
            Positions of the channel.

        Returns
        -------
        num : ndarray, shape (n_draws, m + 1)
        den : ndarray, shape (n_draws, n + 1)
        delay : ndarray, shape (n_draws,)
            [s].
        """
        source = self.input_names[input_]
        label = f"[{self.output_names[output]},{source}]"
        position = {name: k for k, name in enumerate(self.names)}

        def column(names: tuple[str, ...], known: float) -> Array:
            found = next((position[name] for name in names if name in position), None)
            return np.full(len(theta), known) if found is None else theta[:, found]

        def polynomial(letter: str, values: Array) -> Array:
            powers = range(len(values) - 1, -1, -1)
            columns = [
                column((f"{letter}{k}{label}", f"{letter}{k}"), v)
                for k, v in zip(powers, values.tolist(), strict=True)
            ]
            return np.stack(columns, axis=1)

        delay = column((f"delay[{source}]", "delay"), float(self.model.delay[output, input_]))
        num, den = self.model.num[output][input_], self.model.den[output][input_]
        return polynomial("b", num), polynomial("a", den), delay

    def derived_values(self, theta: Array) -> Array:
        """`derived_rows` of many coefficient vectors, shape (n_draws, n_quantities)."""
        blocks: list[Array] = []
        gains: list[Array] = []
        for i in range(len(self.output_names)):
            for j in range(len(self.input_names)):
                num, den, _ = self.channel_draws(theta, i, j)
                if not self.structure.shared or (i, j) == (0, 0):
                    blocks.append(pole_values(den, self.model.den[i][j]))
                with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                    gains.append(num[:, -1] / den[:, -1])
        return np.hstack([*blocks, np.stack(gains, axis=1)])

    def derived(self) -> tuple[Parameter, ...]:
        """Poles, dampings and static gains with standard errors and intervals.

        Of a posterior mean from its draws: their median, between quantiles, and half the width of
        their central 68.27 % in place of a standard error, which is finite where their tails have
        no variance. (What the mean coefficients give may lie outside.) Else to first order.
        """
        rows = self.derived_rows()
        if not len(self.draws):
            return tuple(Parameter(*row) for row in rows)
        values = self.derived_values(np.asarray(self.draws))
        ends = 0.5 + 0.5 * ONE_SIGMA * np.array([-1.0, 1.0])
        with np.errstate(invalid="ignore"):
            low, centre, high = np.nanquantile(values, (ends[0], 0.5, ends[1]), axis=0)
            spread = (0.5 * (high - low)).tolist()
        means = np.array([row[1] for row in rows])
        centre = np.where(np.isfinite(centre), centre, means).tolist()
        return tuple(
            Parameter(name, centre[k], spread[k], unit, values[:, k])
            for k, (name, _, _, unit) in enumerate(rows)
        )

    def noise_note(self) -> str:
        """Which model the noise of each output has; empty where all are white."""
        if not any(a.size for a in self.noise_model):
            return ""
        models = zip(self.output_names, self.noise_model, strict=True)
        kinds = [f"{n}: {f'AR({a.size})' if a.size else 'white'}" for n, a in models]
        return f"noise model {', '.join(kinds)}; noise std is that of the noise before whitening"

    def notes(self, *, verbose: bool = False) -> tuple[str, ...]:
        """What was decided on the way.

        Parameters
        ----------
        verbose : bool
            With the criteria of what was not chosen, and why the search ended; what only who looks
            into the search needs.
        """
        noise, offset = self.noise_note(), self.offset_note()
        if verbose:
            told = (noise, offset, *self.decisions(), self.trace.stopped)
        else:
            twice = "noise coloured (" if noise else "\n"
            kept = (each for each in self.decisions() if not each.startswith(twice))
            told = (noise, offset, *(_CRITERIA.sub("", each) for each in kept))
        return tuple(dict.fromkeys(note for note in told if note))

    def decisions(self) -> tuple[str, ...]:
        """The decisions of the trace, below the route where a controller was allowed for."""
        route = self.route_note()
        return (route, *self.trace.decisions) if route else self.trace.decisions

    def route_note(self) -> str:
        """How a controller was allowed for; empty where nothing was done about one."""
        told = ROUTES[self.route]
        return told and f"estimated {told}"

    def held_note(self, name: str) -> str:
        """Why a coefficient has no standard error ("fixed", "at bound"); empty where it has one."""
        parameter = self.parameters[name]
        if name in (self.structure.fixed or {}):
            return "fixed"
        if parameter.std or parameter.value not in (self.structure.bounds or {}).get(name, ()):
            return ""
        return "at bound"

    def nuisance_rows(self) -> tuple[Row, ...]:
        """(name, value, std, unit) of the offsets and drifts that were estimated along."""
        rows = []
        for number, terms in enumerate(self.nuisance, 1):
            where = f", experiment {number}" if len(self.nuisance) > 1 else ""
            for i, output in enumerate(self.output_names):
                unit = self.units.get(output, "")
                per_second = unit and unit_ratio(unit, "", 1)
                rows += [
                    (
                        f"offset[{output}{where}]",
                        terms.offset[i],
                        terms.offset_std[i],
                        unit,
                    ),
                    (f"drift[{output}{where}]", terms.drift[i], terms.drift_std[i], per_second),
                ]
        return tuple(row for row in rows if row[2] != 0)

    def offset_note(self) -> str:
        """At which input the offsets are the output; empty when that is zero input."""
        notes = []
        for number, terms in enumerate(self.nuisance, 1):
            if np.any(terms.input_reference):
                inputs = zip(self.input_names, terms.input_reference.tolist(), strict=True)
                where = f" (experiment {number})" if len(self.nuisance) > 1 else ""
                notes.append(", ".join(f"{name} = {value:.4g}" for name, value in inputs) + where)
        return f"an offset is the output that belongs to {'; '.join(notes)}" if notes else ""

    def _unit(self, name: str) -> str:
        match = re.fullmatch(r"([ab])(\d+)(?:\[(.*)\])?", name)
        if match is None:
            return "s" if name.startswith("delay") else ""
        i, j = 0, 0
        for row, output in enumerate(self.output_names):
            for column, input_ in enumerate(self.input_names):
                if match[3] == f"{output},{input_}":
                    i, j = row, column
        power = len(self.model.den[i][j]) - 1 - int(match[2])
        if match[1] == "a":
            return unit_ratio("", "", power)
        return self._ratio_unit(self.output_names[i], self.input_names[j], power)

    def _ratio_unit(self, output: str, input_: str, power: int) -> str:
        if output not in self.units or input_ not in self.units:
            return ""
        return unit_ratio(self.units[output], self.units[input_], power)

    def predict(self, record: Record, *, experiment: int = 0) -> Array:
        """Fitted output: G (u - reference) + offset + drift (t - t0) + free response.

        Offset, drift and initial state are held as they were estimated. Those of another record are
        others: `tridentify.compare` fits them to it.

        Parameters
        ----------
        record : Record
            The identified record, or another one with the same channels.
        experiment : int
            Whose offset, drift and initial state are taken.

        Returns
        -------
        ndarray, shape (n_samples, n_outputs)
            [output units]; ``nan`` before the last delayed input has arrived, where the initial
            state is free: what came before the record is not known.
        """
        from tridentify.models.simulate import simulate

        record = in_memory(record)
        found = (record.n_inputs, record.n_outputs)
        expected = (len(self.input_names), len(self.output_names))
        if found != expected:
            raise DataError(
                f"found a record with {found[0]} inputs and {found[1]} outputs; expected "
                f"{expected[0]} and {expected[1]} as identified; select its channels first"
            )
        record = record.settled(self.intersample)
        terms = self.nuisance[experiment]
        moved = np.any(terms.input_reference)
        shifted = record._on_its_times(record.u - terms.input_reference if moved else record.u)
        free = terms.free_response if np.any(terms.free_response) else None
        response = simulate(self.model, shifted, free_response=free, free_after=terms.free_after)
        if terms.free_after:
            response[record.t - record.t[0] < (1.0 - 1e-9) * terms.free_after] = np.nan
        fitted: Array = response + terms.offset if np.any(terms.offset) else response
        if np.any(terms.drift):
            fitted = fitted + np.outer(record.t - terms.t0, terms.drift)
        return fitted

    def residual(self, record: Record, *, experiment: int = 0) -> Array:
        """Recorded minus fitted output, shape (n_samples, n_outputs); nan where not recorded."""
        residual: Array = in_memory(record).y - self.predict(record, experiment=experiment)
        return residual

    def summary(self) -> str:
        """Fixed-width text: status, model, coefficients, derived quantities, fit, decisions."""
        advice = beside_errors(self.status.remedy, self.findings)
        advice = f"what to do: {advice}" if advice else ""
        remedy = textwrap.wrap(advice, _WIDTH, initial_indent="  ", subsequent_indent="    ")
        head = [
            "=" * _WIDTH,
            *textwrap.wrap(f"{self.method}: {self.status.message}", _WIDTH),
            *remedy,
            f"samples {self.n_samples}, experiments {len(self.nuisance)}, "
            f"degrees of freedom {self.degrees_of_freedom}, intersample {self.intersample}",
            "=" * _WIDTH,
        ]
        lines = [*head, self.model_text()]
        rows = [_row(p, self.held_note(p.name)) for p in self.parameters.values()]
        lines += ["", *format_table(_TITLES, rows)]
        along = tuple(Parameter(*row) for row in self.nuisance_rows())
        for title, found in (("derived", self.derived()), ("estimated along", along)):
            if found:
                rows = [_row(quantity) for quantity in found]
                lines += ["", *format_table((title, *_TITLES[1:]), rows)]
        spread = np.sqrt(self.noise_variance)
        outputs = zip(self.output_names, self.fit, spread, strict=True)
        fits = [(n, f"{f:.2f}", f"{s:.4g}", self.units.get(n, "")) for n, f, s in outputs]
        lines += ["", *format_table(("output", "fit [%]", "noise std", "unit"), fits), ""]
        figures = (
            ("AICc", f"{self.aicc:.6g}"),
            ("condition", f"{self.condition:.3g}"),
            ("relative gradient", f"{self.gradient:.2g}"),
        )
        lines.append(", ".join(f"{name} {value}" for name, value in figures if value != "nan"))
        for finding in self.findings:
            lines += finding.lines(_WIDTH)
        for note in self.notes():
            lines += textwrap.wrap(note, _WIDTH, initial_indent="- ", subsequent_indent="  ")
        return "\n".join(line.rstrip() for line in (*lines, "=" * _WIDTH))

    def model_text(self) -> str:
        """Each channel as a fraction in s with +/- one standard deviation, at most 78 wide."""
        lines: list[str] = []
        for i, output in enumerate(self.output_names):
            for j, input_ in enumerate(self.input_names):
                num, den, cov = self.channel(i, j)
                std = np.sqrt(np.maximum(np.diag(cov), 0))
                n = len(den) - 1
                below = np.concatenate(([0.0], std[:n]))
                parts = (format_polynomial(num, std[n:-1]), format_polynomial(den, below))
                top, bottom = (textwrap.wrap(part, _WIDTH - 2) for part in parts)
                width = max(map(len, top + bottom))
                late = format_value(self.model.delay[i, j], std[-1])
                late = with_error(self.model.delay[i, j], std[-1]) if std[-1] > 0 else late
                delay = f"exp(-{late} s) x"
                fraction = [row.center(width) for row in top] + ["-" * width]
                lines += [""] if lines else []
                names = " / ".join(short(name, _WIDTH // 3) for name in (output, input_))
                lines += [f"{names} = {delay if self.model.delay[i, j] else ''}"]
                lines += ["  " + row for row in fraction + [row.center(width) for row in bottom]]
        return "\n".join(line.rstrip() for line in lines)

    def _repr_html_(self) -> str:
        fits = ", ".join(f"{n} {f:.1f} %" for n, f in zip(self.output_names, self.fit, strict=True))
        caption = f"{self.method}: {self.status.message}; fit {fits}"
        rows = [_row(p, self.held_note(p.name)) for p in self.parameters.values()]
        rows += [_row(quantity) for quantity in self.derived()]
        remedy = beside_errors(self.status.remedy, self.findings)
        advice = [f"What to do: {remedy}."] if remedy else []
        doubts = "".join(f"<li>{html.escape(text)}</li>" for text in (*advice, *self.cautions))
        warned = f"<ul>{doubts}</ul>" if doubts else ""
        return f"{warned}{self.model_mathml()}{html_table(_TITLES, rows, caption)}"

    def model_mathml(self) -> str:
        """Every channel as a fraction in MathML, as a notebook shows it."""
        found = []
        for i, output in enumerate(self.output_names):
            for j, input_ in enumerate(self.input_names):
                num, den, cov = self.channel(i, j)
                std = np.sqrt(np.maximum(np.diag(cov), 0))
                n = len(den) - 1
                top = list(zip(num.tolist(), std[n:-1].tolist(), strict=True))
                below = list(zip(den.tolist(), [0.0, *std[:n].tolist()], strict=True))
                late = self.model.delay[i, j]
                delay = f"exp(-{format_value(late, std[-1])} s) " if late else ""
                found.append(fraction(f"{output} / {input_}", top, below, delay))
        return "".join(found)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the estimate as JSON: to a temporary name first, then renamed.

        Raises
        ------
        OutputPathError
            The file cannot be written.
        """
        return save_document(path, "schema", SCHEMA, self)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Estimate:
        """Read what `save` wrote.

        Raises
        ------
        UnreadableFileError
            There is no such file, or it is not JSON, or too large (128 MiB, four million values).
        DataError
            It is of another schema version, or damaged: a field is missing, unknown, not of its
            type, or does not go with the others.
        """
        return load_document(path, "schema", SCHEMA, cls.from_document, "estimate", "Estimate")

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> Estimate:
        """Build an estimate from what JSON holds of it, and refuse what does not belong together.

        Parameters
        ----------
        document : mapping
            The content of a file of `save`, without its schema.

        Returns
        -------
        Estimate

        Raises
        ------
        DataError, StructureError, ValueError
            A field is missing, unknown, not of its type, or does not go with the others.
        """
        made: Estimate = decode(cls, document)
        inputs, outputs = made.input_names, made.output_names
        checked_units(made.units, (*inputs, *outputs))
        check_model(made.model, made.structure, made.theta, inputs, outputs)
        check_covariance(made.cov)
        check_draws(made.draws, len(made.names))
        check_noise(made.noise_variance, made.fit, made.noise_model)
        check_nuisance(made.nuisance, made.model)
        check_outliers(made.outliers, len(made.nuisance), len(outputs), made.n_samples)
        check_sampling(
            made.n_samples, made.degrees_of_freedom, made.dt, made.intersample, made.loss
        )
        return made


def _row(parameter: Parameter, held: str = "") -> tuple[str, ...]:
    value, std = parameter.value, parameter.std
    if not parameter.determined:
        return parameter.name, NOT_DETERMINED, "", "", "", parameter.unit
    ends = [format_value(end, std) for end in parameter.interval()] if std > 0 else ["", ""]
    return parameter.name, format_value(value, std), format_std(std) or held, *ends, parameter.unit
