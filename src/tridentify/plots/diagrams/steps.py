"""What the passes of an estimate say of one step: which one is drawn, and its numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tridentify.errors import OptionError, StepNotTakenError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.trace import Pass, Step
from tridentify.numerics.arrays import Array
from tridentify.writing.layout import IN_PICTURES, short

_TITLES = {
    "parallel": "parallel model (Step 1)",
    "series-parallel": "series-parallel model (Step 2)",
    "series": "series model (Step 3)",
}


@dataclass(frozen=True, eq=False)
class Taken:
    """A step of one pass, seen from one channel.

    Attributes
    ----------
    estimate : Estimate
    step : Step
    its_pass : Pass
    output, input_ : int
        Positions of the channel.
    """

    estimate: Estimate
    step: Step
    its_pass: Pass
    output: int
    input_: int

    @property
    def names(self) -> tuple[str, str]:
        """Of the output and the input, long ones without their middles."""
        estimate = self.estimate
        output, input_ = estimate.output_names[self.output], estimate.input_names[self.input_]
        return short(output, IN_PICTURES), short(input_, IN_PICTURES)

    @property
    def where(self) -> str:
        """Channel and pass, in words."""
        estimate, (output, input_) = self.estimate, self.names
        n_outputs, n_inputs = len(estimate.output_names), len(estimate.input_names)
        channel = f"{output} / {input_}"
        if n_outputs * n_inputs > 1:
            number = self.output * n_inputs + self.input_ + 1
            channel += f" (channel {number} of {n_outputs * n_inputs})"
        last = estimate.trace.passes[-1].number
        return f"{channel}, pass {self.its_pass.number} of {last}, {estimate.method}"

    @property
    def other_inputs(self) -> tuple[str, ...]:
        """Names of the inputs that add to the same output."""
        names = self.estimate.input_names
        return tuple(short(name, IN_PICTURES) for k, name in enumerate(names) if k != self.input_)

    def polynomials(self) -> tuple[Array, Array]:
        """Numerator and denominator of the channel that the step found, descending powers.

        Where the step tells the denominator alone, the numerator is that of the pass.
        """
        theta = np.array(self.estimate.theta)
        whole = np.asarray(self.its_pass.theta)
        theta[: whole.size] = whole
        found = np.asarray(self.step.coefficients)
        delays = sum(name.startswith("delay") for name in self.estimate.names)
        if self.step.name in ("parallel", "series"):
            pass
        elif found.size >= theta.size - delays:
            theta[: found.size] = found
        else:
            lower = [k for k, name in enumerate(self.estimate.names) if name.startswith("a")]
            if len(lower) == found.size:
                theta[lower] = found
        num, den, _ = self.estimate.channel_draws(theta[None], self.output, self.input_)
        return num[0], den[0]

    def errors(self) -> tuple[Array, Array]:
        """Standard errors of numerator and (monic) denominator, of the final estimate."""
        num, den, cov = self.estimate.channel(self.output, self.input_)
        std = np.sqrt(np.maximum(np.diag(cov), 0.0))
        n = den.size - 1
        return std[n : n + num.size], np.concatenate([[0.0], std[:n]])

    def weights(self) -> Array:
        """``beta`` of the channel (parallel), or of the output (series)."""
        flat = np.asarray(self.step.coefficients)
        n_outputs, n_inputs = len(self.estimate.output_names), len(self.estimate.input_names)
        if self.step.name == "series":
            return np.asarray(flat.reshape(n_outputs, -1)[self.output])
        return np.asarray(flat.reshape(n_outputs, n_inputs, -1)[self.output, self.input_])


def taken(
    estimate: Estimate, name: str, output: int, input_: int, pass_number: int | None
) -> Taken:
    """Find a step in the trace.

    Parameters
    ----------
    estimate : Estimate
    name : str
    output, input_ : int
    pass_number : int, optional
        Default: the last pass that has the step.

    Raises
    ------
    StepNotTakenError
        The estimate came about without it.
    OptionError
        There is no such channel or pass.
    """
    for what, value, count in (
        ("output", output, len(estimate.output_names)),
        ("input_", input_, len(estimate.input_names)),
    ):
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < count:
            raise OptionError(
                f"found {what}={shown(value)}; expected a number from 0 to {count - 1}; correct it"
            )
    numbers = [one.number for one in estimate.trace.passes]
    if pass_number is not None and pass_number not in numbers:
        raise OptionError(
            f"found pass_number={shown(pass_number)}; expected one of {numbers}; correct it"
        )
    for one in reversed(estimate.trace.passes):
        if pass_number is None or one.number == pass_number:
            for step in reversed(one.steps):
                if step.name == name:
                    return Taken(estimate, step, one, output, input_)
    steps = dict.fromkeys(step.name for one in estimate.trace.passes for step in one.steps)
    where = "in its passes" if pass_number is None else f"in pass {pass_number}"
    raise StepNotTakenError(
        f"found no {_TITLES[name]} {where} of {estimate.method}, whose steps are "
        f"{', '.join(steps) or 'not recorded'}; expected an estimate of ThreeModel that went "
        "through it; use draw_flow_chart, which shows what was done"
    )


def took(estimate: Estimate, name: str) -> bool:
    """Whether any pass has the step."""
    return any(step.name == name for one in estimate.trace.passes for step in one.steps)
