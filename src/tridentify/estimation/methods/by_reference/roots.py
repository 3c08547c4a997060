"""Where the passes of the reference route end.

For white noise, for the other kind of controller, and with a model of the noise. `passes` has the
equations, `reference` what the roots are for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Status
from tridentify.estimation.closed_loop.between_samples import Loop, Sampling
from tridentify.estimation.closed_loop.driven import Driven, driven
from tridentify.estimation.likelihood.noise.noise_model import STILL as NOISE_STILL
from tridentify.estimation.methods.base import Method
from tridentify.estimation.methods.by_reference.controller_kind import opposite
from tridentify.estimation.methods.by_reference.passes import (
    PATIENCE,
    STILL,
    Rooted,
    residuals,
    root,
    without_rest,
)
from tridentify.numerics.arrays import Array
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

WORSE = 0.05
"""Share by which a better known driven input may raise the mean square of what is left: it takes
nothing that is noise, and what it takes of the response shows at once."""
FARTHER = 1.5
"""Mean square of what a root leaves over that of the open-loop fit, or of another root, from which
there may be a better one. The open-loop fit is the least of all; what feedback adds to a root is a
few per cent, and one that misses a start of the loop leaves fifty times as much."""
MOST_BESIDE = 12
"""Passes of such a fit: it begins near its end, and runs about where hardly any noise is left."""


def white_root(
    parts: Sequence[Driven],
    sampling: Sampling,
    structure: Structure,
    plain: Method,
    near: Callable[[TransferFunction], Method],
    say: Callable[[str], None],
    *,
    again: bool = True,
) -> Rooted:
    """The root for one kind of controller and white noise.

    With ``again`` the driven input of a continuous controller is found anew, beside the noise.
    """
    loops = [Loop(part, sampling) for part in parts]
    first = plain.estimate([one.instrument for one in loops], structure)
    best = _nearer(root(loops, structure, first, near, say), structure, near, say)
    # between the samples the driven input itself counts, and not its shape alone
    return _renewed(best, structure, near, say) if sampling != "sampled" and again else best


def other_root(
    best: Rooted,
    structure: Structure,
    near: Callable[[TransferFunction], Method],
    say: Callable[[str], None],
) -> Rooted:
    """The root for the other kind of controller, from the one that is there."""
    kind = opposite(best.loops[0].sampling)
    others = [Loop(driven(one.record, between=kind == "continuous"), kind) for one in best.loops]
    return root(others, structure, best.estimate, near, say)


def with_noise_model(
    white: Rooted, structure: Structure, method: Method, say: Callable[[str], None]
) -> Rooted:
    """The same on whitened samples, where the residual calls for a model of the noise."""
    say("coloured noise")
    at, loops = white.estimate.model, white.loops
    first = method.estimate([without_rest(one, at) for one in loops], structure)
    if not any(a.size for a in first.noise_model):
        return replace(white, estimate=first)
    # each pass is itself no stiller than that, with its noise model
    found = root(
        loops, structure, first, lambda _: method, say, patience=PATIENCE, tolerance=NOISE_STILL
    )
    found = replace(found, passes=found.passes + white.passes)
    fitted = all(isinstance(one.driven, Driven) for one in loops)
    # at a limit there is no root to come to, and each pass costs a whole estimate
    at_limit = found.estimate.status in (Status.AT_STABILITY_LIMIT, Status.AT_SAMPLING_LIMIT)
    if loops[0].sampling == "sampled" or not fitted or at_limit:
        return found
    return _renewed(found, structure, lambda _: method, say, tolerance=NOISE_STILL)


def rise(found: Rooted) -> float:
    """Of ``-2 log L`` in white noise, from the open-loop fit to a root."""
    if found.whole is None:
        return 0.0
    left, least = (_mean_square(residuals(found.loops, e)) for e in (found.estimate, found.whole))
    count = sum(int(np.isfinite(one.record.y).sum()) for one in found.loops)
    return count * float(np.log(left / least))


def _nearer(
    best: Rooted,
    structure: Structure,
    near: Callable[[TransferFunction], Method],
    say: Callable[[str], None],
) -> Rooted:
    """The root from the open-loop fit, where that leaves clearly less of the output.

    Where most of what moved is no reference's doing, a start or a disturbance, the passes may end
    at a root that explains hardly any of it.
    """
    try:
        open_loop = near(best.estimate.model).estimate(
            [one.record for one in best.loops], structure
        )
        best, least = replace(best, whole=open_loop), _mean_square(residuals(best.loops, open_loop))
        if _mean_square(residuals(best.loops, best.estimate)) < FARTHER * least:
            return best
        other = root(best.loops, structure, open_loop, near, say)
    except TridentifyError:
        return best
    before, after = (_mean_square(residuals(one.loops, one.estimate)) for one in (best, other))
    return other if FARTHER * after < before else best


def _renewed(
    best: Rooted,
    structure: Structure,
    near: Callable[[TransferFunction], Method],
    say: Callable[[str], None],
    tolerance: float = STILL,
) -> Rooted:
    """The root with the driven input apart from the noise; the one that was, where it is worse.

    Where hardly any noise is left, what is follows the reference and would take its part.
    """
    try:
        end = root(
            best.loops, structure, best.estimate, near, say, MOST_BESIDE,
            renewed=True, tolerance=tolerance,
        )  # fmt: skip
    except TridentifyError:
        return best
    before, after = (_mean_square(residuals(one.loops, one.estimate)) for one in (best, end))
    no_worse = after < (1.0 + WORSE * best.still) * before
    if not (end.still and no_worse if best.still else end.still or no_worse):
        return best
    return replace(end, passes=end.passes + best.passes)


def _mean_square(left: Sequence[Array]) -> float:
    """Of the residuals of all outputs, each relative to nothing but itself."""
    return float(np.exp(np.mean(np.log(np.nanmean(np.vstack(left) ** 2, axis=0) + 1e-300))))
