"""A coefficient that is zero as poles cancel in it is judged beside them, not beside zero."""

from types import SimpleNamespace

import numpy as np
import pytest

from tridentify import TransferFunction
from tridentify.judgement.causes.attempts.fewer import unsure

LONG = 1e3


def wide(den, std, longest=LONG):
    """Which coefficients of ``1 / den`` are unsure, with errors of ``a1``, ``a0`` and ``b0``."""
    estimate = SimpleNamespace(
        names=("a1", "a0", "b0"),
        theta=TransferFunction([1.0], den).den[0][0][[1, 2, 0]],
        std=np.array([*std, 0.01]),
        model=TransferFunction([1.0], den),
        input_names=("u",),
        output_names=("y",),
    )
    return unsure(estimate, longest)


@pytest.mark.parametrize(
    ("den", "std", "found"),
    [
        ([1.0, 0.0, -1.9], [0.01, 0.01], []),  # a magnet that holds: poles at +-1.4
        ([1.0, 0.0, -1.9], [2.0, 1.5], ["a1", "a0"]),
        ([1.0, 0.3, -0.01], [0.01, 0.01], ["a0"]),  # a slow pole that may as well be stable
        ([1.0, 0.02, 1.0], [0.02, 0.01], ["a1"]),  # damping is not told by the frequency
        ([1.0, 2.0, 0.01], [0.1, 0.006], ["a0"]),  # a slow pole within the record
        ([1.0, 2.0, 0.0], [0.1, 0.006], ["a0"]),  # an integrator, worse than the record could
        ([1.0, 2.0, 0.0], [0.1, 0.0003], []),
    ],
)
def test_size_is_that_of_the_poles_without_their_signs(den, std, found):
    assert wide(den, std) == found
