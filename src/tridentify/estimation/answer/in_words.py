"""An estimate as text, as a notebook shows it, and what is told of how it was reached."""

from __future__ import annotations

import html
import re
import textwrap
from collections.abc import Iterator

import numpy as np

from tridentify.estimation.answer.content import ROUTES
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.derived import Derived, Row
from tridentify.estimation.answer.finding import beside_errors
from tridentify.estimation.answer.parameter import NOT_DETERMINED, Parameter
from tridentify.numerics.arrays import Array
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

_CRITERIA = re.compile(r"(?<=: lowest AICc) \(.*\)| \(of -2 log L: .*\)")
"""Behind a decision: how much worse the other choices are."""
_WIDTH = 78
"""Characters a line of the summary: fits a terminal of 80."""
_Fraction = tuple[tuple[str, str], tuple[tuple[Array, Array, Array], ...], float, float]
_TITLES = ("coefficient", "value", "std error", "95 % from", "to", "unit")


class EstimateInWords(Derived):
    """What an `Estimate` looks like, and the notes beside its numbers."""

    @property
    def cautions(self) -> tuple[str, ...]:
        """The findings that matter, in words: what was found, and what to do."""
        return tuple(finding.text for finding in self.findings if finding.matters)

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
            twice = self.trace.about(DecisionKind.NOISE_COLOURED) if noise else ()
            kept = (each for each in self.decisions() if each not in twice)
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

    def noise_level_rows(self) -> tuple[tuple[str, ...], ...]:
        """The noise of every output by experiment; empty where one level was taken for all."""
        return tuple(
            (f"experiment {number}", *(f"{size:.4g}" for size in own))
            for number, own in enumerate(self.noise_levels, 1)
        )

    def offset_note(self) -> str:
        """At which input the offsets are the output; empty when that is zero input."""
        notes = []
        for number, terms in enumerate(self.nuisance, 1):
            if np.any(terms.input_reference):
                inputs = zip(self.input_names, terms.input_reference.tolist(), strict=True)
                where = f" (experiment {number})" if len(self.nuisance) > 1 else ""
                notes.append(", ".join(f"{name} = {value:.4g}" for name, value in inputs) + where)
        return f"an offset is the output that belongs to {'; '.join(notes)}" if notes else ""

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
        if levels := self.noise_level_rows():
            titles = ("noise std", *self.output_names)
            lines += [*format_table(titles, levels), ""]
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
        for names, top_and_below, late, error in self._fractions():
            parts = (format_polynomial(*one) for one in top_and_below)
            top, bottom = (textwrap.wrap(part, _WIDTH - 2) for part in parts)
            width = max(map(len, top + bottom))
            told = with_error(late, error) if error > 0 else format_value(late, error)
            fraction = [row.center(width) for row in top] + ["-" * width]
            lines += [""] if lines else []
            label = " / ".join(short(name, _WIDTH // 3) for name in names)
            lines += [f"{label} = {f'exp(-{told} s) x' if late else ''}"]
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
        for names, top_and_below, late, error in self._fractions():
            top, below = (
                list(zip(*(part.tolist() for part in parts), strict=True))
                for parts in top_and_below
            )
            delay = f"exp(-{format_value(late, error)} s) " if late else ""
            found.append(fraction(" / ".join(names), top, below, delay))
        return "".join(found)

    def _fractions(self) -> Iterator[_Fraction]:
        """Names, numerator and denominator, delay and its error, by channel.

        Of numerator and denominator the values, their errors, and what they are told to.
        """
        for i, output in enumerate(self.output_names):
            for j, input_ in enumerate(self.input_names):
                num, den, cov = self.channel(i, j)
                std = np.sqrt(np.maximum(np.diag(cov), 0))
                n = len(den) - 1
                above, below = std[n:-1], np.concatenate(([0.0], std[:n]))
                drawn = self.channel_draws(np.asarray(self.draws), i, j)
                parts = (
                    (num, above, _told_to(num, above, drawn[0])),
                    (den, below, _told_to(den, below, drawn[1])),
                )
                yield (output, input_), parts, self.model.delay[i, j], std[-1]


def _row(parameter: Parameter, held: str = "") -> tuple[str, ...]:
    value, std, told = parameter.value, parameter.std, parameter.told_to
    if not parameter.determined:
        return parameter.name, NOT_DETERMINED, "", "", "", parameter.unit
    shown = format_value(value, told), format_std(std) or held, *parameter.written_ends
    return parameter.name, *shown, parameter.unit


def _told_to(values: Array, std: Array, draws: Array) -> Array:
    """`Parameter.told_to` of coefficients; draws (n_draws, n_coefficients)."""
    rows = zip(values.tolist(), std.tolist(), draws.T, strict=True)
    return np.array([Parameter("", value, error, draws=own).told_to for value, error, own in rows])
