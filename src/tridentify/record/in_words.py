"""A record in a line of text, and as a notebook shows it."""

from __future__ import annotations

import html

import numpy as np

from tridentify.record.samples import Samples
from tridentify.writing.notebook import sparkline

_DRAWN = 6
"""Channels drawn in a notebook."""


class RecordInWords(Samples):
    """What a `Record` looks like."""

    def _labelled(self, names: tuple[str, ...]) -> str:
        return ", ".join(f"{n} [{self.units[n]}]" if n in self.units else n for n in names)

    def __repr__(self) -> str:
        step = "time not uniform" if self.dt is None else f"dt={self.dt:.6g} s"
        label = f"{self.name!r}, " if self.name else ""
        return (
            f"Record({label}{self.n_samples} samples, {self.duration:.6g} s, {step}, "
            f"{self.intersample}, inputs: {self._labelled(self.input_names)}, "
            f"outputs: {self._labelled(self.output_names)}{self._driven()})"
        )

    def _driven(self) -> str:
        """The references in words, and what they do between samples where that differs."""
        if self.reference is None:
            return ""
        same = self.reference_intersample == self.intersample
        own = "" if same else f" ({self.reference_intersample})"
        return f", references: {self._labelled(self.reference_names)}{own}"

    def _repr_html_(self) -> str:
        missing = int(np.isnan(self.y).sum())
        rows = {
            "samples": f"{self.n_samples} ({missing} missing)" if missing else str(self.n_samples),
            "time": f"{self.t[0]:.6g} s to {self.t[-1]:.6g} s",
            "step": "not uniform" if self.dt is None else f"{self.dt:.6g} s, {self.intersample}",
            "inputs": self._labelled(self.input_names),
            "outputs": self._labelled(self.output_names),
        }
        drawn = [(self.input_names, self.u), (self.output_names, self.y)]
        if self.reference is not None:
            rows["references"] = self._driven().partition(": ")[2]
            drawn.append((self.reference_names, self.reference))
        cells = "".join(f"<tr><th>{k}</th><td>{html.escape(v)}</td></tr>" for k, v in rows.items())
        for names, signals in drawn:
            for name, signal in list(zip(names, signals.T, strict=True))[:_DRAWN]:
                drawing = sparkline(signal, name)
                cells += f"<tr><th>{html.escape(name)}</th><td>{drawing}</td></tr>"
        return f"<table><caption>Record {html.escape(self.name)}</caption>{cells}</table>"
