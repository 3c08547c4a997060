"""Whether an estimate can be used, in one word and in a sentence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.estimation.answer.estimate import Estimate, Status
from tridentify.estimation.answer.finding import CODES, Finding

HEADS = {"good": "Usable", "caution": "Usable with caution", "bad": "Not usable"}
"""Class of an estimate -> how its headline begins."""

KNOWN = 0.5
"""Relative standard error below which a coefficient shows a response."""


def class_of(estimate: Estimate, findings: Sequence[Finding]) -> str:
    """How far to trust the estimate: "good", "caution" or "bad"."""
    if unusable(estimate, findings):
        return "bad"
    doubts = any(finding.matters for finding in findings)
    return "caution" if doubts or estimate.status is not Status.CONVERGED else "good"


def predicts(estimate: Estimate) -> bool:
    """Whether an estimate is to predict its record from sample to sample, and the input tells.

    On the direct route, where the response to some input is known to better than half.
    """
    response = [one for name, one in estimate.parameters.items() if name.startswith("b")]
    known = any(one.std > 0 and one.relative_std < KNOWN for one in response)
    return estimate.route == "direct" and known


def unusable(estimate: Estimate, findings: Sequence[Finding]) -> str:
    """Why an estimate is not usable, a sentence; empty where it is.

    Parameters
    ----------
    estimate : Estimate
    findings : sequence of Finding
        Ranked.

    Returns
    -------
    str
        Where the search failed, a finding says that the numbers are wrong, or a constant follows
        an output more closely than the model; not on the direct route, whose model predicts from
        sample to sample: simulated without its controller, a plant that integrates leaves any
        record in which something pushed it.
    """
    if not estimate.status.ok:
        why = [estimate.status.message.rstrip(".")]
    else:
        worse = [
            name
            for name, fit in zip(estimate.output_names, estimate.fit, strict=True)
            if np.isfinite(fit) and fit < 0.0 and not predicts(estimate)
        ]
        wrong = [one for one in findings if one.severity == "error"]
        why = [f"a constant follows {', '.join(worse)} more closely than the model"] * bool(worse)
        why += [CODES[one.code] for one in (wrong or [f for f in findings if f.matters])[:1]]
        if not (worse or wrong):
            return ""
    return f"{HEADS['bad']}: {'; '.join(why)}."
