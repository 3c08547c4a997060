"""What advice gives back: findings, and what the record shows of the system."""

from __future__ import annotations

import html
import textwrap
from dataclasses import dataclass
from typing import Any

from tridentify.estimation.answer.finding import Finding
from tridentify.judgement.advice.frequency import FrequencyResponse
from tridentify.judgement.advice.seen import DelaySeen
from tridentify.judgement.causes.attempts.intersample import TIE
from tridentify.record.checks.samples import Behaviour
from tridentify.writing.layout import html_table

_WIDTH = 78
"""Characters a line: fits a terminal of 80."""


@dataclass(frozen=True, eq=False)
class Advice:
    """What records can tell before a model is chosen.

    Attributes
    ----------
    findings : tuple of Finding
        What stands in the way, what matters most first.
    frequency : FrequencyResponse or None
        Measured frequency response and coherence; None where the records are too short.
    delays : tuple of DelaySeen
        For every input and output with a response: how late it begins.
    poles : int or None
        How many directions of state rise above the noise, over all channels, of operators that know
        nothing of the system. Neither a bound nor a choice of the number of poles, which
        `select_structure` makes: an integrator and coloured noise take several directions, two
        lags close together may show as one. None where nothing rises.
    behaviour : {"zoh", "foh", "band-limited"}
        Of the input between the samples: the one that explains the records best.
    behaviours : dict of str to float
        Behaviour -> by how much its ``-2 log L`` is higher than that of the best.
    input_names, output_names : tuple of str
    n_samples : int
        Of all records.
    duration : float
        [s].
    notes : tuple of str
        What was done to the records on the way.

    Examples
    --------
    >>> Advice((), None, (), 2, "zoh", {"zoh": 0.0}, ("u",), ("y",), 100, 5.0).ok
    True
    """

    findings: tuple[Finding, ...]
    frequency: FrequencyResponse | None
    delays: tuple[DelaySeen, ...]
    poles: int | None
    behaviour: Behaviour
    behaviours: dict[Behaviour, float]
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    n_samples: int
    duration: float
    notes: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether nothing was found that spoils an estimate."""
        return not any(finding.severity == "error" for finding in self.findings)

    def facts(self) -> list[tuple[str, str]]:
        """What the record shows, in pairs of a name and a value."""
        rows = [("record", f"{self.n_samples} samples, {self.duration:.6g} s")]
        if self.frequency is not None:
            for j, name in enumerate(self.input_names):
                band = self.frequency.band(j)
                rows.append((f"{name} excites", _band(band)))
            for i, output in enumerate(self.output_names):
                for j, name in enumerate(self.input_names):
                    rows.append((f"{output} answers {name}", _band(self.frequency.seen(i, j))))
        rows += [(f"{seen.output} after {seen.input}", _late(seen)) for seen in self.delays]
        rows.append(("input between samples", self._between()))
        rows.append(("poles it may support", self._supported()))
        return rows

    def _supported(self) -> str:
        if self.poles is None:
            return "not told"
        return (
            f"about {self.poles} at first sight; lags close together, an integrator and coloured "
            "noise blur the count: tridentify select compares orders"
        )

    def _between(self) -> str:
        others = [
            f"with {name} {more:.3g} higher"
            for name, more in self.behaviours.items()
            if name != self.behaviour and more >= TIE
        ]
        told = f"-2 log L: {', '.join(others)}" if others else "the record does not tell"
        return f"{self.behaviour} ({told})"

    def summary(self) -> str:
        """All of it as text, findings first."""
        lines: list[str] = []
        for finding in self.findings:
            lines += finding.lines(_WIDTH)
        if not self.findings:
            lines.append("nothing stands in the way of an estimate")
        rows = self.facts()
        width = min(max(len(name) for name, _ in rows), 36)
        lines.append("")
        for name, value in rows:
            lines += textwrap.wrap(
                f"{name:{width}s}  {value}", _WIDTH, subsequent_indent=" " * (width + 2)
            )
        for note in self.notes:
            lines += textwrap.wrap(note, _WIDTH, initial_indent="- ", subsequent_indent="  ")
        return "\n".join(lines)

    def __repr__(self) -> str:
        codes = ", ".join(dict.fromkeys(finding.code for finding in self.findings))
        return f"Advice({codes or 'nothing found'})"

    def _repr_html_(self) -> str:
        rows = [(f"{f.message} {f.effect}".strip(), f.remedy) for f in self.findings]
        found = (
            html_table(("found", "what to do"), rows)
            if rows
            else "<p>nothing stands in the way of an estimate</p>"
        )
        notes = "".join(f"<p>{html.escape(note)}</p>" for note in self.notes)
        return found + html_table(("the record", ""), self.facts()) + notes

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, numbers and text, as for JSON."""
        return {
            "ok": self.ok,
            "findings": [vars(finding).copy() for finding in self.findings],
            "frequency": None if self.frequency is None else self.frequency.to_dict(),
            "delays": [vars(seen).copy() for seen in self.delays],
            "poles": self.poles,
            "behaviour": self.behaviour,
            "behaviours": dict(self.behaviours),
            "inputs": list(self.input_names),
            "outputs": list(self.output_names),
            "n_samples": self.n_samples,
            "duration": self.duration,
            "notes": list(self.notes),
        }


def _band(ends: tuple[float, float] | None) -> str:
    return "nowhere" if ends is None else f"from {ends[0]:.3g} to {ends[1]:.3g} rad/s"


def _late(seen: DelaySeen) -> str:
    return seen.text if seen.low > 0 else f"less than {seen.high:.3g} s"
