"""Names that users of other packages try, and what they are called here."""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

_COEFFICIENT = re.compile(r"[ab]\d+|delay")

OF_AN_ESTIMATE: Mapping[str, str] = MappingProxyType(
    {
        "params": "estimate.parameters, or estimate.theta for the numbers alone",
        "coef_": "estimate.theta",
        "bse": "estimate.std",
        "conf_int": 'estimate.to_frame(level=0.95), or estimate.parameters["a0"].interval(0.95)',
        "cov_params": "estimate.cov",
        "resid": "estimate.residual(record)",
        "aic": "estimate.aicc",
        "num": "estimate.model.num",
        "den": "estimate.model.den",
        "poles": "estimate.model.poles",
        "zeros": "estimate.model.zeros",
        "dc_gain": "estimate.model.dc_gain, or estimate.derived() with standard errors",
    }
)
"""Name -> what to write in its place."""

OF_A_RECORD: Mapping[str, str] = MappingProxyType(
    {
        "plot": "tridentify.plots.plot_record(record)",
        "inputs": "record.u, and record.input_names",
        "outputs": "record.y, and record.output_names",
        "time": "record.t",
    }
)


class Pointers:
    """Answers a name that an object does not have with the one that is meant.

    Examples
    --------
    >>> from tridentify import Record
    >>> try:
    ...     Record([0, 1], [0, 1], dt=0.1).plot
    ... except AttributeError as error:
    ...     print(error)
    found no 'plot' in a Record; use tridentify.plots.plot_record(record)
    """

    _elsewhere: ClassVar[Mapping[str, str]] = MappingProxyType({})

    if not TYPE_CHECKING:  # a type checker knows all attributes that there are

        def __getattr__(self, name: str) -> Any:
            """Say what to use; only names that the object does not have come here."""
            kind = type(self)
            use = kind._elsewhere.get(name, "")
            if not use and kind._elsewhere is OF_AN_ESTIMATE and _COEFFICIENT.fullmatch(name):
                use = f'estimate.parameters["{name}"].value'
            article = "an" if kind.__name__[0] in "AEIOU" else "a"
            said = f"found no {name!r} in {article} {kind.__name__}; use {use}"
            plain = f"{kind.__name__!r} object has no attribute {name!r}"
            raise AttributeError(said if use else plain, name=name, obj=self)
