"""One finding: what stands between an estimate and trust, how much it matters, and what to do.

Findings are values that estimates, validations and advice carry. They are ranked so that what has
to be mended first comes first: a cause that explains others (bad samples, the input between the
samples, a delay) before what it would make of the residual (an order too low, coloured noise).
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

Severity = Literal["error", "warning", "note"]

SEVERITIES: tuple[Severity, ...] = ("error", "warning", "note")

CODES: Mapping[str, str] = MappingProxyType(
    {
        "no-response": "the output shows no response to the input",
        "not-excited": "the input does not move the system enough to tell its coefficients",
        "loop-not-excited": "a controller alone moves the input: nothing tells it from the plant",
        "constant-input": "an input never changes",
        "interpolated": "a log that was interpolated: outputs lie on straight lines between others",
        "wraps-round": "a channel that jumps from one end of its range to the other and back",
        "stuck-sensor": "a sensor or the recording hung, or repeats its values",
        "bad-samples": "samples that noise does not explain",
        "missing-samples": "samples that are not there",
        "lost-rows": "rows that were lost: what follows does not come from what was before",
        "channel-changes": "a recorded channel changes its unit, its gain or its level",
        "another-system": "the record is not of the system that was identified",
        "input-noise": "a recorded input carries noise that did not act",
        "intersample": "another behaviour of the input between its samples explains the record",
        "delay": "an input acts later, or earlier, than the model says",
        "filtered": "outputs that were filtered forth and back, and inputs that were not",
        "feedback": "the input reacts to the output",
        "reference-reacts": "a reference reacts to the output",
        "saturation": "values at a limit of the sensor, its converter or the actuator",
        "nonlinear": "the system is not linear over this range",
        "varying": "the system changes during the record",
        "disagreeing-experiments": "the experiments are not of one system",
        "drift": "a slow disturbance or a drift is missing",
        "order-low": "the order is too low",
        "order-high": "the record does not support so many poles and zeros",
        "not-determined": "coefficients that the record does not tell",
        "unmodelled-response": "part of the response is missing, by no cause that was tried",
        "outside-the-record": "a time constant or a gain that the record cannot show",
        "unstable": "a model that is not stable",
        "at-bound": "a coefficient that a bound holds",
        "contradiction": "what is known contradicts the record",
        "quantisation": "steps of a converter that are coarse against the noise",
        "noise-model": "noise that the standard errors do not allow for",
        "tone": "a steady tone beside the response, such as mains hum",
        "noise-changes": "noise that changes its size over the record",
        "noise-size": "a residual of another size than the estimate leads to expect",
        "distribution": "a residual that is not Gaussian",
        "samples-left-out": "samples that the estimate had to leave out",
        "judged-on-stretch": "a long record of which a stretch alone was judged",
    }
)
"""Code -> what it means, in the order in which findings of one severity are shown."""

KINDS: Mapping[str, str] = MappingProxyType(
    {
        "": "what its code says",
        "clocks": "of varying: clocks of the channels that run apart",
        "friction": "of nonlinear: play or dry friction",
        "held": "of stuck-sensor: friction may hold what moves",
        "slow-sensor": "of stuck-sensor: each value is held until the next one, throughout",
        "missing-code": "of stuck-sensor: a number that stands for a missing value",
        "floor": "of input-noise: white noise beside a smooth input, seen in its spectrum",
        "opposite": "of disagreeing-experiments, another-system: a channel has the opposite sign",
        "gain": "of disagreeing-experiments, another-system: a channel has another gain",
        "late": "of disagreeing-experiments: an experiment is late, or early",
        "repeated": "of intersample: an input recorded slower than the outputs, and repeated",
        "late-log": "of intersample: an input logged at the end of the interval in which it acted",
        "between": "of intersample: an input that is held moves between the samples",
        "scale": "of channel-changes: a gain, a unit or a sign, and not a level",
        "alone": "of intersample: compared with the present behaviour, beside no other cause",
    }
)
"""Kind -> which case of a code it is, where other findings depend on that."""

_RANK = {code: k for k, code in enumerate(CODES)}


@dataclass(frozen=True)
class Finding:
    """What was found, how much it matters, and what to do.

    Attributes
    ----------
    code : str
        One of `CODES`; stable, for programs.
    severity : {"error", "warning", "note"}
        The numbers are wrong; they are to be used with care; to be known.
    message : str
        What was found, a sentence.
    remedy : str
        What to do, a sentence; empty where nothing needs doing.
    outputs : tuple of str
        Those that are concerned; empty where all are.
    experiment : int or None
        Position of the experiment, from 0; None where it is all of them, or the only one.
    times : tuple of float
        When [s]: instants of single samples, or first and last of a stretch.
    effect : str
        How much it matters: what the remedy brought when it was tried, or by how much the
        coefficients move.
    kind : str
        One of `KINDS`: which case of its code, for programs.

    Examples
    --------
    >>> found = Finding("delay", "error", "The input acts later.", "Use delay=0.1.")
    >>> found.text
    'The input acts later. Use delay=0.1.'
    """

    code: str
    severity: Severity
    message: str
    remedy: str = ""
    outputs: tuple[str, ...] = ()
    experiment: int | None = None
    times: tuple[float, ...] = ()
    effect: str = ""
    kind: str = ""

    def __post_init__(self) -> None:
        if self.code not in CODES:
            raise ValueError(f"found code {self.code!r}; expected one of {', '.join(CODES)}")
        if self.severity not in SEVERITIES:
            raise ValueError(f"found severity {self.severity!r}; expected one of {SEVERITIES}")
        if self.kind not in KINDS:
            raise ValueError(f"found kind {self.kind!r}; expected one of {', '.join(KINDS)}")
        object.__setattr__(self, "outputs", tuple(self.outputs))
        object.__setattr__(self, "times", tuple(float(t) for t in self.times))

    @property
    def matters(self) -> bool:
        """Whether it is more than a note."""
        return self.severity != "note"

    @property
    def text(self) -> str:
        """Message, effect and remedy, one after the other."""
        return " ".join(part for part in (self.message, self.effect, self.remedy) if part)

    def lines(self, width: int) -> list[str]:
        """Message, effect and remedy, wrapped for a terminal.

        Parameters
        ----------
        width : int
            Most characters a line.
        """
        mark = {"error": "! ", "warning": "! ", "note": "- "}[self.severity]
        said = " ".join(part for part in (self.message, self.effect) if part)
        rows = textwrap.wrap(said, width, initial_indent=mark, subsequent_indent="  ")
        if self.remedy:
            rows += textwrap.wrap(
                f"what to do: {self.remedy}",
                width,
                initial_indent="  ",
                subsequent_indent="    ",
            )
        return rows


def ranked(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Each once, the most severe first, causes before what follows from them.

    Examples
    --------
    >>> found = [Finding("noise-model", "warning", "b"), Finding("delay", "warning", "a")]
    >>> [f.code for f in ranked(found)]
    ['delay', 'noise-model']
    """
    once = dict.fromkeys(findings)
    return tuple(sorted(once, key=lambda f: (SEVERITIES.index(f.severity), _RANK[f.code])))


def joined(*groups: Iterable[Finding]) -> tuple[Finding, ...]:
    """Ranked, without what a later group says again of the same outputs and experiment.

    An estimate and a validation of it look at one record: what both find is told once, and what
    contradicts a better founded finding is left out (`agreed`). An error is never left out for
    less: what said it more mildly gives way.

    Examples
    --------
    >>> once = joined([Finding("delay", "error", "a")], [Finding("delay", "warning", "b")])
    >>> [f.message for f in once]
    ['a']
    >>> once = joined([Finding("delay", "warning", "a")], [Finding("delay", "error", "b")])
    >>> [f.message for f in once]
    ['b']
    """
    known: list[Finding] = []
    for group in groups:
        before = tuple(known)
        for one in group:
            same = [other for other in before if same_thing(one, other)]
            if one.severity == "error" and not any(other.severity == "error" for other in same):
                known = [other for other in known if other not in same]
            elif same:
                continue
            known.append(one)
    return ranked(agreed(known))


FEWER = ", or use fewer poles or zeros"
"""What the remedy for coefficients that a record does not tell ends with."""


def agreed(findings: Iterable[Finding]) -> list[Finding]:
    """Without what contradicts a larger model that was fitted, or without that model.

    A model without half of the response (an error of ``order-low``) shows no response for want of
    poles, and experiments with opposite signs show none together. Where fewer poles explain a
    record as well, more of them are no advice.

    Examples
    --------
    >>> low = Finding("order-low", "warning", "The order is too low.", "Use poles=3.")
    >>> vague = Finding("not-determined", "warning", "b0.", f"Excite the system more{FEWER}.")
    >>> agreed([low, vague])[1].remedy
    'Excite the system more.'
    >>> [f.severity for f in agreed([low, Finding("order-high", "warning", "Fewer will do.")])]
    ['note', 'warning']
    """
    found = list(findings)
    low = [one for one in found if one.code == "order-low" and one.matters]
    opposite = [one for one in found if one.kind == "opposite"]
    if any(one.severity == "error" for one in (*low, *opposite)):
        found = [one for one in found if one.code not in ("no-response", "order-high")]
    elif any(one.code == "order-high" for one in found):
        found = [replace(one, severity="note", remedy="") if one in low else one for one in found]
        return found
    return [replace(one, remedy=without_fewer(one.remedy, low)) for one in found]


def without_fewer(remedy: str, findings: Iterable[Finding]) -> str:
    """A remedy without fewer poles where a finding advises more.

    Examples
    --------
    >>> low = Finding("order-low", "warning", "The order is too low.", "Use poles=3.")
    >>> without_fewer("record longer, or use fewer poles or zeros", [low])
    'record longer'
    """
    more = any(one.code == "order-low" and one.matters and one.remedy for one in findings)
    return remedy.replace(FEWER, "") if more else remedy


def beside_errors(remedy: str, findings: Iterable[Finding]) -> str:
    """What an estimate's status advises, where no finding says that something else comes first.

    Examples
    --------
    >>> wrong = Finding("delay", "error", "The input acts later.", "Use delay=0.1.")
    >>> beside_errors("record longer", [wrong])
    ''
    """
    found = tuple(findings)
    if any(one.severity == "error" and one.remedy for one in found):
        return ""
    return without_fewer(remedy, found)


def same_thing(one: Finding, other: Finding) -> bool:
    """Whether two findings say the same of outputs that they share."""
    shared = not (one.outputs and other.outputs) or set(one.outputs) & set(other.outputs)
    places = {one.experiment, other.experiment}
    return one.code == other.code and (None in places or len(places) == 1) and bool(shared)
