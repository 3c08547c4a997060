"""What the steps of a converter explain of a residual by themselves."""

from __future__ import annotations

from collections.abc import Sequence

from tridentify.estimation.answer.finding import Finding
from tridentify.judgement.validation.residuals import View
from tridentify.numerics.converter import within_a_step

ROUNDED = ("bad-samples", "lost-rows", "noise-changes")
"""What rounding makes as well: it leaves single samples alone, and less where the output rests."""
MERELY = 0.6
"""Steps of the converter within which a residual is rounding, which leaves half a one: what else is
in it is a tenth of a step."""
FOLLOWED = (*ROUNDED, "nonlinear", "unmodelled-response", "order-low", "varying")
"""What rounding makes as well as it follows the signal."""


def beyond_steps(found: Sequence[Finding], view: View) -> list[Finding]:
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
