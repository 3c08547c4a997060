"""Whether what is slow in a residual is more than the spectrum of its noise foretells.

The waves of the test of the level stand out against an autoregression that was fitted to all
frequencies, which misses how noise of the kind of 1/f rises at the lowest ones. So where it is
called for, their power is judged by that of the next faster waves (`numerics.slow_spectrum`).
"""

from __future__ import annotations

from tridentify.judgement.validation.residuals import Output, View
from tridentify.numerics.arrays import Array
from tridentify.numerics.slow_spectrum import BY_NOISE, slow_chance


def slowly(output: Output, white: Array) -> float:
    """Probability of so much slow power by the noise alone, whitened or not, whichever is less.

    Zero of several experiments, whose own levels are few waves.

    Parameters
    ----------
    output : Output
    white : (n,) array
        The residual, whitened, beside what was fitted.
    """
    if len(output.residual) > 1:
        return 0.0
    return min(slow_chance(white), slow_chance(output.residual[0]))


def is_no_slower(view: View) -> bool:
    """Whether no residual is slower than the spectrum of its own noise foretells.

    Of noise that is taken for white nothing is foretold.
    """
    if view.uneven or not all(one.noise.size for one in view.outputs):
        return False
    return not any(
        slowly(one, one.white(one.residual, one.noise)) <= BY_NOISE for one in view.outputs
    )
