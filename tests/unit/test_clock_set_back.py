"""A clock that is set back at the end of summer time is told from runs below each other."""

import numpy as np
import pytest

from tridentify.errors import TimeNotIncreasingError
from tridentify.record.checks.times import check_increasing


@pytest.mark.parametrize("step", [1.0, 60.0, 300.0, 900.0])
def test_an_hour_doubled_is_the_clock(step):
    first = np.arange(0.0, 4 * 3600.0, step)
    local = np.append(first, np.arange(first[-1] + step - 3600.0, 6 * 3600.0, step))
    with pytest.raises(TimeNotIncreasingError, match="summer time"):
        check_increasing(local)


def test_runs_of_an_hour_are_runs():
    run = np.arange(0.0, 3600.0, 60.0)
    with pytest.raises(TimeNotIncreasingError, match="2 runs below each other"):
        check_increasing(np.append(run, run))
