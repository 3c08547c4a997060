"""Another behaviour of the input is advised where it is likelier and costs no output its fit."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tridentify.judgement.causes.attempts.intersample import Behaviours


def compared(fall: float, present: float, other: float) -> Behaviours:
    """Held against lines; fits [percent] as they were fitted."""
    attempts = {
        name: SimpleNamespace(fits=np.array([80.0, fit]))
        for name, fit in (("zoh", present), ("foh", other))
    }
    above = {"zoh": 0.0, "foh": -fall}
    return Behaviours("zoh", cast(Any, above), cast(Any, attempts), False, 500)


@pytest.mark.parametrize(
    ("fall", "present", "other", "advised"),
    [
        (30.0, 90.0, 95.0, "foh"),
        (30.0, 90.0, 89.5, "foh"),
        (30.0, 51.8, -49.0, "zoh"),
        (5.0, 90.0, 95.0, "zoh"),
        (-30.0, 90.0, 80.0, "zoh"),
    ],
)
def test_a_behaviour_that_loses_the_fit_is_not_advised(fall, present, other, advised) -> None:
    assert compared(fall, present, other).advised == advised
