"""Passes of the reference route: fits of what the reference drives, until they stand still.

The equation and its fixed point are derived in `methods.by_reference.reference`, (1) and (3).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.noise_driven import apart_from_noise, made
from tridentify.estimation.methods.base import Method
from tridentify.numerics.arrays import Array
from tridentify.numerics.extrapolation import extrapolated
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

MOST_PASSES = 40
"""Passes; nearly all loops need four to ten."""
PATIENCE = 10
"""Passes in which the movement of whole estimates, each with its searches, has to fall to half of
the least before: all loops that come to a root do so in fewer, and others would run to the last."""
STILL = 1e-3
"""Standard errors that the coefficients move by in the last pass."""
FLOOR = 1e-7
"""Share of a coefficient below which its standard error does not count: without noise there is
none, and what lies between the samples is known with fewer digits."""
MEMORY = 4
"""Passes that the extrapolation uses: as many as coefficients of a second-order model."""


@dataclass(frozen=True, eq=False)
class Rooted:
    """Where the passes ended.

    Attributes
    ----------
    loops : sequence of Loop
        As the last pass knew them.
    estimate : Estimate
        Of the last pass.
    passes : int
    moved : float
        By which the last pass moved the coefficients [standard errors].
    tolerance : float
        By how much it may in a root.
    whole : Estimate, optional
        The open-loop fit of the records, beginning there.
    """

    loops: Sequence[Loop]
    estimate: Estimate
    passes: int
    moved: float
    tolerance: float = STILL
    whole: Estimate | None = None

    @property
    def still(self) -> bool:
        """Whether it is a root."""
        return self.moved <= self.tolerance


def root(
    loops: Sequence[Loop],
    structure: Structure,
    first: Estimate,
    near: Callable[[TransferFunction], Method],
    say: Callable[[str], None],
    most: int = MOST_PASSES,
    *,
    renewed: bool = False,
    patience: int | None = None,
    tolerance: float = STILL,
) -> Rooted:
    """Passes of (3) until the coefficients stand still.

    Parameters
    ----------
    loops : sequence of Loop
    structure : Structure
    first : Estimate
        Where to begin.
    near : callable
        The method of the passes, which begins at a model.
    say : callable
        Is told what is going on.
    most : int
        Passes.
    renewed : bool
        Whether each pass finds what the references drive anew, apart from the noise that its model
        leaves.
    patience : int, optional
        Passes in which the movement has to fall to half of the least before; by default no limit.
    tolerance : float
        By how much the last pass may move the coefficients [standard errors].
    """
    given, images, estimate, moved = [first.theta], [], first, np.inf
    least, reached = np.inf, 0
    for count in range(1, most + 1):
        say(f"what the reference does not drive, pass {count}")
        at = model_like(estimate, given[-1])
        loops = apart(loops, estimate, at) if renewed else loops
        estimate = near(at).estimate([without_rest(one, at) for one in loops], structure)
        images.append(estimate.theta)
        scale = np.maximum(estimate.std, FLOOR * np.abs(estimate.theta) + 1e-300)
        moved = float(np.max(np.abs(images[-1] - given[-1]) / scale))
        if moved < 0.5 * least:
            least, reached = moved, count
        if moved <= tolerance or (patience is not None and count - reached >= patience):
            break
        following = _extrapolated(given, images, scale)
        if not model_like(estimate, following).is_stable:
            following = 0.5 * (given[-1] + images[-1])
        given.append(following)
    return Rooted(loops, estimate, count, moved, tolerance)


def apart(loops: Sequence[Loop], estimate: Estimate, at: TransferFunction) -> list[Loop]:
    """What the references drive, apart from the noise that a model leaves.

    Parameters
    ----------
    loops : sequence of Loop
        With parts that were fitted.
    estimate : Estimate
        With the nuisance terms of these loops.
    at : TransferFunction
    """
    found = []
    for loop, left in zip(loops, residuals(loops, estimate), strict=True):
        error = left + made(loop, estimate.model) - made(loop, at)
        found.append(replace(loop, driven=apart_from_noise(loop, at, error)))
    return found


def without_rest(loop: Loop, model: TransferFunction) -> Record:
    """The pair ``(u_M, y')`` of (3)."""
    now = loop.at(model)
    return now.instrument.with_outputs(np.asarray(loop.record.y) - now.beside(model))


def _extrapolated(given: Sequence[Array], images: Sequence[Array], scale: Array) -> Array:
    """From the last passes, in units of standard errors."""
    depth = min(MEMORY, len(images), scale.size + 1)
    x = np.column_stack(given[-depth:]) / scale[:, None]
    steps = np.column_stack(images[-depth:]) / scale[:, None] - x
    return np.asarray(given[-1] + scale * extrapolated(np.diff(x, axis=1), steps))


def model_like(estimate: Estimate, theta: Array) -> TransferFunction:
    """The model of other coefficients of the same structure."""
    channels = [
        [estimate.channel_draws(theta[None], i, j) for j in range(len(estimate.input_names))]
        for i in range(len(estimate.output_names))
    ]
    return TransferFunction(
        [[num[0] for num, _, _ in row] for row in channels],
        [[den[0] for _, den, _ in row] for row in channels],
        delay=np.array([[float(late[0]) for _, _, late in row] for row in channels]),
        input_names=estimate.input_names,
        output_names=estimate.output_names,
    )


def residuals(loops: Sequence[Loop], estimate: Estimate) -> list[Array]:
    """(n_samples, n_outputs) per experiment, ``y - G u`` less the nuisance terms."""
    return [
        estimate.residual(without_rest(loop, estimate.model), experiment=e)
        for e, loop in enumerate(loops)
    ]
