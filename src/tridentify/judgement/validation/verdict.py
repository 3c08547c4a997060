"""From test results to words: what was found, in seconds and names of channels, and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding, Severity, ranked
from tridentify.judgement.causes.explanation import Explanation, Explanations
from tridentify.judgement.causes.feedback import Coming
from tridentify.judgement.validation.evidence import Evidence
from tridentify.judgement.validation.explained import (
    drift_tried,
    finding_of,
    follows_no_better,
    is_little_beside_colour,
    of_sampling,
    told_alone,
)
from tridentify.judgement.validation.likelihood_ratio import CALLED
from tridentify.judgement.validation.residuals import View
from tridentify.judgement.validation.result import Check, CrossCorrelation, Transfer
from tridentify.numerics.arrays import Array
from tridentify.numerics.converter import within_a_step


def family(
    evidence: Sequence[Evidence], names: Sequence[str], transfer: Transfer | None
) -> list[Check]:
    """Every test, not yet judged; ``nan`` where it could not be made."""
    found = []
    for one, name in zip(evidence, names, strict=True):
        explained = one.past < CALLED or one.level < CALLED
        white = one.coloured if explained else one.whiteness.p_value
        rows = (
            ("white", white),
            ("past inputs", one.past),
            ("feedback", one.feedback),
            ("level", one.level),
            ("scale", one.scale),
            ("coefficients constant", one.later),
            ("linear", one.linear),
            ("Gaussian", one.normality.p_value),
        )
        found += [Check(what, name, p, False) for what, p in rows]
    if transfer is not None:
        found.append(Check("same coefficients", "all", transfer.coefficients_p_value, False))
        pairs = zip(names, transfer.size_p_values.tolist(), strict=True)
        found += [Check("size of the noise", name, p, False) for name, p in pairs]
    return found


NO_CONTROLLER = "if no controller was running ask for as many zeros as poles;"
"""What to do where the output follows the input at once, before what to do about feedback."""


class KnownCauses(NamedTuple):
    """What is known of causes when test results are put into words.

    Attributes
    ----------
    estimate : Estimate
    explained : Explanations or None
        The causes that were fitted; None where nothing called for it.
    again : list of Evidence or None
        Per output, what is found beside the cause that is named; None where that was not looked
        at.
    without_bad : str
        How far the coefficients move without samples that stand alone; empty where that was not
        tried.
    """

    estimate: Estimate
    explained: Explanations | None
    again: list[Evidence | None]
    without_bad: str

    @property
    def named(self) -> Explanation | None:
        """The cause that explains most."""
        return None if self.explained is None else self.explained.named

    @property
    def robust(self) -> bool:
        """Whether the estimate has a robust loss, which goes with no noise model."""
        return self.estimate.loss != "squared"

    @property
    def no_better(self) -> bool:
        """Whether that cause is a larger model which follows the record no better."""
        if self.named is None or self.explained is None:
            return False
        return follows_no_better(self.named, self.explained.present)

    def keeps_colour(self, output: int, seen: Evidence) -> bool:
        """Whether white weights are as wrong beside a drift that is estimated along as before.

        What was seen of an output was seen beside slow waves too.
        """
        if self.named is None or self.named.rival.code != "drift":
            return False
        white = not (self.robust or self.estimate.noise_model[output].size)
        return white and (self.again[output] or seen).plainly_white < CALLED

    @property
    def torn(self) -> str:
        """Where rows were lost, if that is the cause; empty where it is another one."""
        if self.named is None or self.named.rival.code != "lost-rows":
            return ""
        times = self.named.rival.times
        at = ", ".join(f"{t:.4g}" for t in times)
        return f"what follows {at} s does not come from what was before"

    @property
    def alone(self) -> Explanation | None:
        """That cause where it explains so much that no test of the residual has to reject.

        Likelihoods of samples of which some are bad say nothing by themselves.
        """
        if self.named is None or self.without_bad or not told_alone(self.named):
            return None
        return self.named


CALLING = ("past inputs", "level", "coefficients constant", "linear")
"""Tests that a cause may explain."""

ROBUST = "use a robust loss (loss='huber' or 'student'; --loss), or mark them as missing"
WEIGHED = "mark them as missing where they are wrong; the robust loss gives them little weight"
"""What to do about bad samples under the squared loss, and under one that does so already."""

SAID_BY = {
    "level": ("drift",),
    "coefficients constant": ("varying", "disagreeing-experiments"),
    "linear": ("nonlinear", "saturation"),
}
"""Test -> causes that say what it says: the model that is fitted beside a cause is a rough one, and
may leave some of it."""


def findings(
    view: View,
    evidence: Sequence[Evidence],
    pictures: Sequence[CrossCorrelation],
    tests: Sequence[Check],
    transfer: Transfer | None,
    beside: KnownCauses,
) -> tuple[Finding, ...]:
    """All findings, the most important first.

    Parameters
    ----------
    view : View
    evidence : sequence of Evidence, one per output
    pictures : sequence of CrossCorrelation
        Output by output.
    tests : sequence of Check
        Judged.
    transfer : Transfer or None
    beside : KnownCauses
        What would explain the residual.
    """
    rejected = {(test.name, test.output): test.p_value for test in tests if test.rejected}
    found: list[Finding] = []
    n_inputs = view.records[0].n_inputs
    concerned = []
    for i, (one, output) in enumerate(zip(evidence, view.outputs, strict=True)):
        own = pictures[n_inputs * i : n_inputs * (i + 1)]
        name = output.name
        calling = [test for test in CALLING if (test, name) in rejected]
        left = dict(rejected)
        if (calling or beside.torn) and beside.named is not None:
            concerned.append((name, beside.torn or _where(one, own, calling)))
            again = None if of_sampling(beside.named) else beside.again[i]
            left = _left(rejected, name, again, beside.named.rival.code)
            if beside.no_better or beside.keeps_colour(i, one):
                # this model stays, and its standard errors do not allow for what is left
                left |= {key: p for key, p in rejected.items() if key == ("white", name)}
        elif ("past inputs", name) in rejected:
            found.append(_unexplained(one, own, beside))
        reacts = None if beside.explained is None else beside.explained.reacts[i]
        found += _about_one(view, one, name, left, own, beside, reacts)
    if concerned and beside.named is not None and beside.explained is not None:
        names = [name for name, _ in concerned]
        where = _sentence(concerned[0][1])[:-1]
        told = finding_of(beside.named, beside.explained, beside.estimate, names, where)
        if is_little_beside_colour(beside.named) and any(f.code == "noise-model" for f in found):
            told = replace(told, severity="note")
        found.append(told)
    elif beside.alone is not None and beside.explained is not None:
        where = f"AICc falls by {beside.alone.gain:.3g} where one more cause is fitted"
        found.append(finding_of(beside.alone, beside.explained, beside.estimate, (), where))
    if transfer is not None:
        found += _carried(view, transfer, rejected)
    if beside.estimate.route == "direct":
        found = [_as_noise(one) if one.code == "drift" else one for one in found]
    return ranked(_beyond_steps(found, view))


ROUNDED = ("bad-samples", "lost-rows", "noise-changes")
"""What rounding makes as well: it leaves single samples alone, and less where the output rests."""
MERELY = 0.6
"""Steps of the converter within which a residual is rounding, which leaves half a one: what else is
in it is a tenth of a step."""
FOLLOWED = (*ROUNDED, "nonlinear", "unmodelled-response", "order-low", "varying")
"""What rounding makes as well as it follows the signal."""


def _beyond_steps(found: Sequence[Finding], view: View) -> list[Finding]:
    """Without what rounding makes in outputs of which it explains all that is left."""
    names = {one.name for one in view.outputs}
    for part, codes in ((1.0, ROUNDED), (MERELY, FOLLOWED)):
        rounded = {one.name for one in view.outputs if within_a_step(one.y, one.residual, part)}
        found = [
            one
            for one in found
            if one.code not in codes or not (set(one.outputs) or names) <= rounded
        ]
    return list(found)


def _as_noise(drift: Finding) -> Finding:
    """What is slow beside an estimate by the direct route, whose noise model stands for it.

    A drift that is fitted with white weights, as all causes are, would be biased by the feedback.
    """
    seen = drift.message.split(": ")[0].rstrip(".")
    said = f"{seen}: something pushes the plant slowly, and the model of the noise stands for it."
    return replace(drift, severity="note", message=said, remedy="", effect="")


def _left(
    rejected: dict[tuple[str, str], float], name: str, again: Evidence | None, named: str
) -> dict[tuple[str, str], float]:
    """What is still rejected beside a cause that was fitted along, and is not that cause."""
    quiet = set(CALLING) | {"white"}
    if again is not None and again.past >= CALLED:
        still = {
            "level": again.level,
            "coefficients constant": again.later,
            "linear": again.linear,
            "white": again.coloured,
            "feedback": again.feedback,
            "scale": again.scale,
        }
        quiet = {"past inputs"} | {test for test, p in still.items() if not p < CALLED}
        quiet |= {test for test, codes in SAID_BY.items() if named in codes}
    return {key: p for key, p in rejected.items() if key[1] != name or key[0] not in quiet}


def _where(one: Evidence, pictures: Sequence[CrossCorrelation], calling: Sequence[str]) -> str:
    """What the residual shows."""
    name = pictures[0].output
    if calling[0] == "past inputs":
        j = int(np.argmin(one.by_input))
        low, high = _around(pictures[j], True)
        return (
            f"the residual of {name} is correlated with {pictures[j].input} at {seconds(low, high)}"
        )
    said = {
        "level": f"the level of the residual of {name} moves slowly over the record",
        "coefficients constant": f"the coefficients behind {name} do not hold over the record",
        "linear": f"the residual of {name} follows powers or a limit of the input or of the output",
    }
    return said[calling[0]]


def seconds(low: float, high: float) -> str:
    """A stretch of lags.

    Examples
    --------
    >>> seconds(0.1, 0.4), seconds(0.2, 0.2)
    ('lags 0.1-0.4 s', 'lag 0.2 s')
    """
    alike = span(low, high) == span(low, low)
    return f"{'lag' if alike else 'lags'} {span(low, high)} s"


def span(low: float, high: float) -> str:
    """Two numbers that are not negative, or one where they look alike.

    Examples
    --------
    >>> span(0.1, 0.4), span(0.25, 0.25)
    ('0.1-0.4', '0.25')
    """
    a, b = f"{low:.3g}", f"{high:.3g}"
    return a if a == b else f"{a}-{b}"


def _around(picture: CrossCorrelation, past: bool) -> tuple[float, float]:
    """The lags beside the farthest out that are outside the bounds too."""
    side = picture.lags >= 0 if past else picture.lags < 0
    lags = picture.lags[side]
    bound = np.where(picture.bound[side] > 0, picture.bound[side], np.inf)
    ratio = np.abs(picture.correlation[side]) / bound
    top = int(np.argmax(ratio))
    low = high = top
    while low > 0 and ratio[low - 1] > 1:
        low -= 1
    while high + 1 < ratio.size and ratio[high + 1] > 1:
        high += 1
    first, last = float(lags[low]), float(lags[high])
    return (first, last) if past else (-last, -first)


def _unexplained(
    one: Evidence, pictures: Sequence[CrossCorrelation], beside: KnownCauses
) -> Finding:
    """A response that is missing, by no cause that was tried."""
    name = pictures[0].output
    j = int(np.argmin(one.by_input))
    low, high = _around(pictures[j], True)
    where = _where(one, pictures, ("past inputs",))
    if low == high == 0.0:
        # a strictly proper response begins later: neither poles nor a delay make this
        return _finding(
            "unmodelled-response",
            name,
            f"{where}: the input reacts to the output within the sample (feedback), or the output "
            "has a share of the input itself",
            "open the loop, or add a test signal that is large against the feedback; without one, "
            "try as many zeros as poles",
        )
    tried = "" if beside.explained is None else ", and none of the causes that were tried is it"
    return _finding(
        "unmodelled-response",
        name,
        f"{where}: part of the response is missing{tried}",
        "check that the input is what acted on the system, and look for inputs that were not "
        "recorded; the standard errors do not allow for what is missing",
    )


def _finding(
    code: str,
    output: str,
    text: str,
    advice: str,
    severity: Severity = "warning",
    *,
    effect: str = "",
    times: Sequence[float] = (),
    experiment: int | None = None,
) -> Finding:
    """A finding whose words become sentences."""
    outputs = () if output == "all" else (output,)
    said, do, much = (_sentence(part) for part in (text, advice, effect))
    return Finding(code, severity, said, do, outputs, experiment, tuple(times), much)


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}." if text else ""


def _about_one(
    view: View,
    one: Evidence,
    name: str,
    rejected: dict[tuple[str, str], float],
    pictures: Sequence[CrossCorrelation],
    beside: KnownCauses,
    reacts: Coming | None,
) -> list[Finding]:
    found = []

    def add(code: str, test: str, text: str, advice: str, effect: str = "") -> None:
        if (test, name) in rejected:
            found.append(_finding(code, name, text, advice.rstrip("."), effect=effect.rstrip(".")))

    if ("feedback", name) in rejected:
        found.append(_feedback(view, name, pictures, reacts, _strictly_proper(beside.estimate)))
    add(
        "drift",
        "level",
        f"the level of the residual of {name} moves slowly over the record: the sensor drifts, or "
        "an offset or a slow disturbance is missing",
        *drift_tried(beside.explained, beside.estimate),
    )
    if ("white", name) in rejected:
        found.append(_not_white(view, one, name, beside))
    add(
        "nonlinear",
        "linear",
        f"the residual of {name} follows powers or a limit of the input or of the output: the "
        "system is not linear over this range",
        "use smaller amplitudes, or identify each operating point on its own",
    )
    add(
        "varying",
        "coefficients constant",
        f"the coefficients behind {name} differ between the first and the second half of the "
        "samples",
        "identify the parts on their own, or use online.ThreeModel(forgetting=...)",
    )
    found += _about_noise(view, one, name, rejected, beside)
    return found


def _strictly_proper(estimate: Estimate) -> bool:
    """Whether no input of a model acts in the same sample."""
    shape = len(estimate.output_names), len(estimate.input_names)
    poles = np.array(estimate.structure.poles_matrix(*shape))
    return bool(np.all(poles > np.array(estimate.structure.zeros_matrix(*shape))))


def _feedback(
    view: View,
    name: str,
    pictures: Sequence[CrossCorrelation],
    reacts: Coming | None,
    strictly_proper: bool,
) -> Finding:
    """The input reacts to the output, or acts in the same sample where the model cannot."""
    direct = reacts is not None and not reacts.lag and strictly_proper
    if reacts is None:
        picture = pictures[int(np.argmax([_outside(picture) for picture in pictures]))]
        which, when = picture.input, f"{span(*_around(picture, False))} s later"
        effect = ""
    else:
        which = pictures[reacts.input].input
        when = f"{reacts.lag * view.step:.3g} s later" if reacts.lag else "of the same sample"
        share = f"{100.0 * reacts.share:.0f} %"
        effect = (
            f"inputs that come too late to act explain {share} of its sum of squares beside all "
            "past ones, and no other cause that was tried takes that away"
        )
    return _finding(
        "feedback",
        name,
        f"the residual of {name} is correlated with {which} {when}: the input reacts to the output "
        f"(feedback), {'' if direct else 'or '}its clock is late"
        f"{', or the output follows it at once' if direct else ''}",
        f"{f'{NO_CONTROLLER} else ' if direct else ''}"
        "open the loop, or add a test signal that is large against the feedback; check that the "
        "channels share one clock",
        effect=effect,
    )


def _when(rows: Array, n_experiments: int) -> str:
    """Times of samples in words, each with its experiment where there are several.

    Examples
    --------
    >>> _when(np.array([[0.0, 2.5, 6.0], [0.0, 0.5, 7.0]]), 1)
    '0.5, 2.5 s'
    >>> _when(np.array([[1.0, 0.04, 9.0], [0.0, 24.9, 8.0], [1.0, 0.08, 7.0]]), 2)
    '24.9 s of experiment 1, 0.04, 0.08 s of experiment 2'
    """
    said = []
    for e in np.unique(rows[:, 0]):
        times = ", ".join(f"{t:.4g}" for t in np.sort(rows[rows[:, 0] == e, 1]))
        said.append(f"{times} s" + (f" of experiment {int(e) + 1}" if n_experiments > 1 else ""))
    return ", ".join(said)


def _about_noise(
    view: View,
    one: Evidence,
    name: str,
    rejected: dict[tuple[str, str], float],
    beside: KnownCauses,
) -> list[Finding]:
    found = []
    if len(one.normality.outliers) and not np.isnan(one.scale):
        rows = one.normality.outliers
        far = rows[np.argsort(-np.abs(rows[:, 2]))]
        at = _when(far[:3], len(view.records))
        many = f"{len(rows)} samples lie" if len(rows) > 1 else "a sample lies"
        which = "at" if len(rows) <= 3 else "the farthest at"
        first = int(rows[0, 0])
        found.append(
            _finding(
                "bad-samples",
                name,
                f"{many} up to {np.abs(far[0, 2]):.0f} standard deviations from the model of "
                f"{name} ({which} {at})",
                WEIGHED if beside.robust else ROBUST,
                times=np.sort(rows[:, 1]).tolist(),
                effect=beside.without_bad.rstrip("."),
                experiment=first if len(view.records) > 1 and np.all(rows[:, 0] == first) else None,
            )
        )
    elif ("Gaussian", name) in rejected:
        found.append(
            _finding(
                "distribution",
                name,
                f"the residual of {name} is not Gaussian (skewness {one.normality.skewness:.2f}, "
                f"excess kurtosis {one.normality.kurtosis:.2f}); the numbers do not rest on that",
                ""
                if beside.robust
                else "nothing, unless the tails are heavy: then loss='student' is more accurate",
                "note",
            )
        )
    if ("scale", name) in rejected:
        ratio = float(np.nanmax(one.scales) / max(float(np.nanmin(one.scales)), 1e-300))
        found.append(
            _finding(
                "noise-changes",
                name,
                f"the noise of {name} changes its size over the record, by a factor of "
                f"{ratio:.1f}: the standard errors are not right",
                "cut the record, or take standard errors from parts of it",
            )
        )
    return found


def _carried(
    view: View, transfer: Transfer, rejected: dict[tuple[str, str], float]
) -> list[Finding]:
    found = []
    if ("same coefficients", "all") in rejected:
        found.append(
            _finding(
                "another-system",
                "all",
                "the coefficients of this record differ from the estimate by more than its "
                "standard errors",
                "identify both records together if they are one system, else each on its own",
            )
        )
    for i, output in enumerate(view.outputs):
        if ("size of the noise", output.name) in rejected:
            more = transfer.size_ratio[i] > 1
            why, advice = (
                f"this record is {'noisier' if more else 'quieter'}",
                "nothing for the model; weight the records by their noise if they are joined",
            )
            spoilt = [("past inputs", output.name), ("level", output.name)]
            if any(key in rejected for key in [*spoilt, ("same coefficients", "all")]):
                why, advice = (
                    "what the model misses is in it, and it does not tell the noise of this record",
                    "mend what is missing first, and validate again",
                )
            found.append(
                _finding(
                    "noise-size",
                    output.name,
                    f"the residual of {output.name} is {transfer.size_ratio[i]:.2f} times as "
                    f"large as the estimate leads to expect: {why}",
                    advice,
                    "note",
                )
            )
    return found


def _not_white(view: View, one: Evidence, name: str, beside: KnownCauses) -> Finding:
    """A residual that is correlated with itself, and whether the errors that are stated know it."""
    modelled = _has_noise(view, name)
    noise = "the noise model does not fit" if modelled else "the noise is not white"
    seen = f"the residual of {name} is correlated with itself at {_reach(view, one)}: {noise}"
    if view.own and beside.estimate.errors == "scores":
        allows = (
            f"{seen}; the standard errors are from the scatter of the scores, which allows for it"
        )
        if modelled or beside.robust or view.uneven:
            do = "look for what shakes the output, if smaller standard errors are wanted"
            return _finding("noise-model", name, allows, do, "note")
        do = "use noise='ar' (--noise ar), which estimates the noise along, for smaller ones"
        return _finding("noise-model", name, allows, do)
    if modelled or beside.robust:
        do = "take the standard errors for too small"
    elif view.uneven:
        do = "take the standard errors for too small; a noise model needs uniform time: resample"
    else:
        do = "use noise='ar' (--noise ar), which estimates the noise along"
    does_not = f"{seen}, and the standard errors do not allow for it"
    return _finding("noise-model", name, does_not, do)


def _has_noise(view: View, name: str) -> bool:
    return any(output.name == name and output.noise.size > 0 for output in view.outputs)


def _outside(picture: CrossCorrelation) -> float:
    side = picture.lags < 0
    bound = np.where(picture.bound[side] > 0, picture.bound[side], np.inf)
    return float(np.max(np.abs(picture.correlation[side]) / bound, initial=0.0))


def _reach_of(view: View, one: Evidence) -> tuple[float, float]:
    found = one.autocorrelation
    ratio = np.abs(found.value - found.mean) / np.where(found.std > 0, found.std, np.inf)
    top = int(np.argmax(ratio))
    low = high = top
    while low > 0 and ratio[low - 1] > 2.58:
        low -= 1
    while high + 1 < ratio.size and ratio[high + 1] > 2.58:
        high += 1
    return (low + 1) * view.step, (high + 1) * view.step


def _reach(view: View, one: Evidence) -> str:
    return seconds(*_reach_of(view, one))


def in_words(
    found: Sequence[Finding], names: Sequence[str], transfer: Transfer | None, fit: Sequence[float]
) -> str:
    """The verdict: one or two sentences.

    Parameters
    ----------
    found : sequence of Finding
    names : sequence of str
        Of the outputs.
    transfer : Transfer or None
    fit : sequence of float
        Of every output [percent].
    """
    serious = [f for f in found if f.matters]
    fits = ", ".join(f"{n} {f:.1f} %" for n, f in zip(names, fit, strict=True))
    where = f"fit {fits}"
    if transfer is not None:
        best = ", ".join(f"{f:.1f} %" for f in transfer.expected_fit)
        where += f" on a record that was not identified, where {best} was to be expected"
    if serious:
        text = f"{serious[0].message[:-1]} ({where})."
        others = list(dict.fromkeys(_brief(f.message) for f in serious[1:]))
        return text + (f" Besides, {'; '.join(others[:3])}." if others else "")
    what = "noise alone" if transfer is None else "noise and the standard errors alone"
    text = f"Nothing speaks against the model: the residual is explained by {what} ({where})."
    if any(f.code == "order-low" for f in found):
        text = f"Nothing speaks against the response of the model ({where})."
    if found:
        text += f" To be known: {decapitalised(found[0].message)}"
    return text


def _brief(message: str) -> str:
    """What was found, without what it means."""
    return decapitalised(message.split(":")[0].split(" (")[0].rstrip("."))


def decapitalised(message: str) -> str:
    """A sentence as the second half of another."""
    return message[0].lower() + message[1:]
