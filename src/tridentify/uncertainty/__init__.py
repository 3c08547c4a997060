"""How far an estimate can be trusted: three routes from the noise to intervals.

- *Delta method* (`derived`, `poles`, `zeros`, `response_band`, `step_band`, `impulse_band`): the
  covariance of the coefficients through exact derivatives. Immediate; right where standard errors
  are small.
- *Sampling* (`sample` and the functions that begin with ``sampled_``): the same covariance through
  the quantities themselves. Milliseconds; right also where a quantity bends within its error.
- *Parametric bootstrap* (`bootstrap`): records are simulated and identified again. Minutes at most;
  shows bias, heavy tails and failures of the estimator itself.
"""

from __future__ import annotations

from tridentify.uncertainty.frequency import (
    ResponseBand,
    frequency_response_std,
    response_band,
    response_covariance,
)
from tridentify.uncertainty.resampling import Bootstrap, Failure, bootstrap
from tridentify.uncertainty.roots import DerivedQuantity, RootUncertainty, derived, poles, zeros
from tridentify.uncertainty.sampled import (
    Sample,
    SampledQuantity,
    SampledRoots,
    sample,
    sampled_coefficients,
    sampled_derived,
    sampled_impulse_band,
    sampled_poles,
    sampled_response_band,
    sampled_step_band,
    sampled_zeros,
)
from tridentify.uncertainty.step import ImpulseBand, StepBand, impulse_band, step_band

__all__ = [
    "Bootstrap",
    "DerivedQuantity",
    "Failure",
    "ImpulseBand",
    "ResponseBand",
    "RootUncertainty",
    "Sample",
    "SampledQuantity",
    "SampledRoots",
    "StepBand",
    "bootstrap",
    "derived",
    "frequency_response_std",
    "impulse_band",
    "poles",
    "response_band",
    "response_covariance",
    "sample",
    "sampled_coefficients",
    "sampled_derived",
    "sampled_impulse_band",
    "sampled_poles",
    "sampled_response_band",
    "sampled_step_band",
    "sampled_zeros",
    "step_band",
    "zeros",
]
