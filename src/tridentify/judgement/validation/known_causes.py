"""What the tests and the causes that were fitted tell of a view, before it is put into words."""

from __future__ import annotations

from dataclasses import dataclass

from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.causes.attempts.explanation import Explanation, Explanations
from tridentify.judgement.validation.explained import follows_no_better, told_alone
from tridentify.judgement.validation.residuals import View
from tridentify.judgement.validation.statistics.evidence import Evidence
from tridentify.judgement.validation.statistics.likelihood_ratio import CALLED


@dataclass(frozen=True, eq=False)
class KnownCauses:
    """What was found about all outputs.

    Attributes
    ----------
    estimate : Estimate
    view : View
        Without samples that are bad, where these were taken out.
    evidence : list of Evidence
        One per output.
    explained : Explanations or None
        Causes that were fitted; None where nothing called for it.
    again : list of Evidence or None
        Per output, what is found beside the cause that is named; None where that was not looked
        at.
    without_bad : str
        How far the coefficients move without samples that are bad; empty where none are.
    """

    estimate: Estimate
    view: View
    evidence: list[Evidence]
    explained: Explanations | None
    again: list[Evidence | None]
    without_bad: str

    @property
    def named(self) -> Explanation | None:
        """The cause that explains most."""
        return None if self.explained is None else self.explained.named

    @property
    def wanders(self) -> bool:
        """Whether it is a delay that varies."""
        named = self.named
        return named is not None and named.rival.exact and named.rival.code == "varying"

    @property
    def cause(self) -> str:
        """Code of the cause that is named; empty where none is."""
        if self.explained is not None and any(self.explained.reacts):
            return "feedback"
        return "" if self.named is None else self.named.rival.code

    @property
    def robust(self) -> bool:
        """Whether the estimate has a robust loss, which goes with no noise model."""
        return self.estimate.loss != "squared"

    @property
    def declined(self) -> str:
        """Why the automatic noise model was not taken; empty where that was not asked for."""
        said = self.estimate.trace.about(DecisionKind.NOISE_TAKEN_AS_WHITE)
        return next((one.rest for one in said if one.rest), "")

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
