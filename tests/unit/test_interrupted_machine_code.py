"""An interruption that has to wait until machine code is done."""

from __future__ import annotations

import signal
import time

import numpy as np
import pytest

from tridentify.numerics.kernels.cascades import bank_parts


def interrupted(_number: int, _frame: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timer counts processor time")
def test_an_interruption_of_machine_code_stays_one() -> None:
    """Code that returns arrays asks for their type: there it was lost to a SystemError."""
    poles = -np.linspace(1.0, 2.0, 50).astype(np.complex128)

    def work(times: float) -> None:
        while times > 0:
            bank_parts(poles, np.array([poles.size]), 1, poles.size)
            times -= 1

    work(1)
    began = time.process_time()
    work(1)
    took = time.process_time() - began
    before = signal.signal(signal.SIGVTALRM, interrupted)
    try:
        for part in (0.3, 0.5, 0.7):
            signal.setitimer(signal.ITIMER_VIRTUAL, part * took)
            with pytest.raises(KeyboardInterrupt):
                work(np.inf)
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)
