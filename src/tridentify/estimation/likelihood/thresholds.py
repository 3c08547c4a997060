"""Every threshold in the unit of ``-2 log L``, in one table: what is compared with it, and why so.

AICc and AIC are ``-2 log L`` plus a price for each unknown, so differences of them have the same
unit. What a difference ``d`` means does not depend on the record: a model is ``exp(d / 2)`` times
less likely, and near the maximum coefficients that are off by ``s`` standard errors cost ``s^2``.

They decide how much is looked at and when it is enough. Halved or doubled one at a time, none of
them moves an estimate of the sensitivity benchmark by a tenth of a standard error
(``benchmarks/results/sensitivity.txt``; `CLEARLY` is read on very long records only).

====================  =======  ====================================================================
name                     size  what is compared with it
====================  =======  ====================================================================
`IDLE`                   1e-6  gain of a step: it is rounding
`SETTLED`                1e-7  gain that the next step promises: the end is reached
`SETTLED_LONG`           1e-4  the same on a long record, where rounding is larger and a step dear
`NEARLY_SETTLED`         1e-3  the same where no step lowers the cost any more
`HELPED`                0.005  gain of another start: it ended elsewhere, and lower
`SAME_END`               0.01  difference of two ends: they are one
`UNFINISHED`              0.1  gain that the next step promises: this is no minimum
`PASS_WITHIN`             0.1  gain of a pass within constraints: the next is not worth while
`PASS_HELPED`             0.5  gain of an adapted pass: the next is worth while
`EQUAL`                   1.0  difference of two models: neither is better
`LEAST_MASS`              5.0  log of the mass of a piece of a posterior: its neighbours count
`ALLOWANCE`               6.0  AICc above that of a richer parallel model: nothing is missing
`CLEARLY`                10.0  difference of two models: one is better
`NEAR`                   20.0  cost of another place above the best: worth following
`PLAUSIBLE`              30.0  AICc of a model and of a parallel model: both of one system
`RIVAL`                  30.0  cost of another place above the best: the record does not exclude it
`WORTHWHILE`             50.0  what a model explains beyond offset and drift: there is a response
`WHOLE_GAUSSIAN`         80.0  twice the log of a Gaussian below its highest: nothing is left there
`TRUSTED`               1.386  promised fall for each sample: more is not believed
`SENSELESS`               0.5  gain for each sample, at rounding: digits are still being won
====================  =======  ====================================================================
"""

from __future__ import annotations

import numpy as np

IDLE = 1e-6
"""A step that gains less is not worth while, and may have gained rounding alone. Three in a row end
the steps."""

SETTLED = 1e-7
"""Default of the methods' option ``tolerance``. A step that promises less moves every coefficient
by less than 3e-4 of its standard error, the square root: below what is printed. Gauss-Newton steps
gain two digits and more each, so that asking for this little costs one step more than asking for a
hundredth of a standard error."""

SETTLED_LONG = 1e-4
"""The same on records longer than `levenberg_marquardt.LONG`: a hundredth of a standard error. One
step costs a pass over all samples there, and ``N log RSS`` has an error that grows with ``N``."""

NEARLY_SETTLED = 1e-3
"""Where steps end because none lowers the cost, the end is a minimum if the next one promises less:
3 % of a standard error. Two ends on either side of a kink count as one within it too."""

HELPED = 0.005
"""Gain from which another start has led to another end. Two runs to one end differ by what
their last steps promise, `SETTLED` to `NEARLY_SETTLED`; a coefficient by 0.07 standard errors."""

SAME_END = 0.01
"""Two ends that differ by less are one, as in the benchmark of convergence: no coefficient differs
by more than a tenth of its standard error."""

UNFINISHED = 0.1
"""An end between two kinks whose next step promises more than this, a third of a standard error, is
on its way out of its cell, and its mass is counted where it arrives."""

PASS_WITHIN = 0.1
"""Steps 1 and 2 within constraints are repeated while they gain more; steps on the cost follow."""

PASS_HELPED = 0.5
"""Adapted passes are repeated while they gain more, 0.7 of a standard error. Their fixed point is
not the minimum, and the steps on the cost that follow are quicker from here."""

EQUAL = 1.0
"""Models whose AICc differs by less are as good as each other: AIC asks 2 for an unknown. So a
promise that was wrong by more is made anew, a richer start has to gain more to be followed by
another one of its kind, and a later delay has to be better by this than an earlier one."""

LEAST_MASS = 5.0
"""In ``log L``, half of the unit of the others: a piece of exp(-5) = 0.7 % of the largest mass has
no neighbours that count, as shares below a hundredth do not (`mixture.LEAST_SHARE`)."""

ALLOWANCE = 6.0
"""The parallel model's AICc is the least over some ten orders and ten rates, and so lower by chance
than that of one model of the right poles. Three unknowns at AIC's price."""

CLEARLY = 10.0
"""One model is better beyond doubt: exp(-5) = 0.7 % of its likelihood is left to the other (Burnham
& Anderson 2002, section 2.6: essentially no support)."""

NEAR = 20.0
"""Of a place with exp(-10) = 5e-5 of the best likelihood, the other poles held, steps on all poles
may still win: the fall from where the others adapt is about that of a few unknowns. Places that are
farther off hardly ever do."""

PLAUSIBLE = 30.0
"""A few steps away from a minimum, or on operators that do not quite fit, a good model may miss its
AICc by 10 or 20. One that misses by more than 30 is of other poles or delays. It only decides how
much is looked at."""

RIVAL = 30.0
"""exp(-15) = 3e-7 of the best likelihood: wide enough that a sharp minimum made by noise shows
others like it, as two poles spent on noise gain some 2 to 13 wherever they are put; a mode that is
there explains hundreds."""

WORTHWHILE = 50.0
"""Twice the most that a model of six poles makes of noise alone (12 to 25 on records of 400
samples; of two poles 2 to 13). Below it there is nothing whose place could be looked for."""

WHOLE_GAUSSIAN = 80.0
"""Beyond the place where a Gaussian is exp(-40) = 4e-18 of its highest value less than rounding is
left of its moments."""

TRUSTED = float(np.log(4.0))
"""A Gauss-Newton step that promises to divide the residual's power by more than four is far outside
of where its linear model holds; the promise is cut there."""

SENSELESS = 0.5
"""A step at rounding that gains less than this for each sample, a fifth off the residual, has no
digits left to win: what remains is not noise but arithmetic."""
