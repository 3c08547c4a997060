"""Whether an estimate can be used, in one word and in a sentence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.estimation.answer.estimate import Estimate, Status
from tridentify.estimation.answer.finding import CODES, Finding

HEADS = {"good": "Usable", "caution": "Usable with caution", "bad": "Not usable"}
"""Class of an estimate -> how its headline begins."""


def class_of(estimate: Estimate, findings: Sequence[Finding]) -> str:
    """How far to trust the estimate: "good", "caution" or "bad"."""
    if unusable(estimate, findings):
        return "bad"
    doubts = any(finding.matters for finding in findings)
    return "caution" if doubts or estimate.status is not Status.CONVERGED else "good"


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
        an output more closely than the model.
    """
    if not estimate.status.ok:
        why = [estimate.status.message.rstrip(".")]
    else:
        worse = [
            name
            for name, fit in zip(estimate.output_names, estimate.fit, strict=True)
            if np.isfinite(fit) and fit < 0.0
        ]
        wrong = [one for one in findings if one.severity == "error"]
        why = [f"a constant follows {', '.join(worse)} more closely than the model"] * bool(worse)
        why += [CODES[one.code] for one in (wrong or [f for f in findings if f.matters])[:1]]
        if not (worse or wrong):
            return ""
    return f"{HEADS['bad']}: {'; '.join(why)}."
