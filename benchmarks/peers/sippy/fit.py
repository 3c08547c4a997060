"""SIPPY: input-output models (OE, ARX) and subspace models (N4SID, PARSIM-K) of the known order.

Orders: a sampled system of ``n`` poles with a held input has ``n`` coefficients in numerator and
denominator and no delay beyond the sample that SIPPY supposes anyway (``theta = 0``). Where the
order of a subspace model is known its authors ask for ``SS_fixed_order``. No centering: the records
have no offset. The output-error model is found by CasADi and IPOPT from its own start at zero.

"tuned": the output-error model takes the first outputs as exact, and a constant input is divided by
its standard deviation; 40 samples of rest before the record mend both. Of the subspace horizons
``SS_f = SS_p`` 20 (the default), 40 and 80 the one whose simulation is nearest to the record.
"""

import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from protocol import Task, best_fit, continuous, from_forward_shift, rest_before, serve
from sippy_unipi import system_identification

HORIZONS = (20, 40, 80)


def rational(method: str, task: Task) -> object:
    orders = {f"{method}_orders": [task.poles, task.poles, 0]}
    found = system_identification(task.y, task.u, method, tsample=task.dt, **orders)
    return from_forward_shift(found.G.num[0][0], found.G.den[0][0], task)


def subspace(method: str, task: Task, horizon: int = 20) -> object:
    found = system_identification(
        task.y, task.u, method, tsample=task.dt,
        SS_fixed_order=task.poles, SS_f=horizon, SS_p=horizon,
    )  # fmt: skip
    return continuous(found.A, found.B, found.C, found.D, task)


def tuned(method: str) -> Callable[[Task], object]:
    def run(task: Task) -> object:
        longer = rest_before(task)
        return best_fit((lambda h=h: subspace(method, longer, h) for h in HORIZONS), task)

    return run


serve(
    {
        "OE": lambda task: rational("OE", task),
        "OE, tuned": lambda task: rational("OE", rest_before(task)),
        "ARX": lambda task: rational("ARX", task),
        "N4SID": lambda task: subspace("N4SID", task),
        "N4SID, tuned": tuned("N4SID"),
        "PARSIM-K, tuned": tuned("PARSIM-K"),
    },
    ("sippy_unipi", "casadi", "control", "numpy", "scipy"),
)
