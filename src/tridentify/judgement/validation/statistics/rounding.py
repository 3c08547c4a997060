"""What the steps of a converter explain of a residual by themselves."""

from __future__ import annotations

from collections.abc import Sequence

from tridentify.estimation.answer.finding import Finding
from tridentify.judgement.validation.residuals import View
from tridentify.numerics.converter import is_mostly_rounding, within_a_step

ROUNDED = ("bad-samples", "lost-rows", "noise-changes")
"""What rounding makes as well: it leaves single samples alone, and less where the output rests."""
FOLLOWED = (
    *ROUNDED,
    "channel-changes",
    "delay",
    "drift",
    "intersample",
    "noise-model",
    "nonlinear",
    "order-low",
    "saturation",
    "unmodelled-response",
    "varying",
)
"""What rounding makes as well as it follows the signal."""


def beyond_steps(found: Sequence[Finding], view: View) -> list[Finding]:
    """Without what rounding makes in outputs of which it explains all that is left."""
    names = {one.name for one in view.outputs}
    for rounding, codes in ((within_a_step, ROUNDED), (is_mostly_rounding, FOLLOWED)):
        rounded = {one.name for one in view.outputs if rounding(one.y, one.residual)}
        found = [
            one
            for one in found
            if one.code not in codes or not (set(one.outputs) or names) <= rounded
        ]
    return list(found)
