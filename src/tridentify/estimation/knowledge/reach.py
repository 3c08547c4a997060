"""Whether what is known of the coefficients is of a size that the record can have to do with.

The squares of what is known and of what the record says stand side by side in one sum. Where they
are too far apart the smaller one is lost to rounding, and what comes out meets the knowledge by
name alone: an equality in which one weight does not count says that a coefficient is zero.
"""

from __future__ import annotations

from collections.abc import Sequence

from tridentify.errors import ScaleError
from tridentify.numerics.arrays import Array
from tridentify.record.checks.scales import REACH
from tridentify.structure import Structure
from tridentify.writing.layout import format_sum

Rows = Sequence[tuple[dict[int, float], float]]


def check_reach(
    structure: Structure, names: Sequence[str], rows: Rows, sizes: Array, spread: Array
) -> None:
    """Refuse numbers out of all proportion to the coefficients that a record can show.

    Parameters
    ----------
    structure : Structure
        Its bounds and priors are judged.
    names : sequence of str, length p
    rows : sequence of (weights by position, value)
        Fixed coefficients, equalities and static gains.
    sizes : (p,) array
        Sizes of the coefficients.
    spread : (p,) array
        The factor by which a coefficient may well be larger or smaller than that.

    Raises
    ------
    ScaleError
    """
    for weights, value in rows:
        _check_row(weights, value, names, sizes, spread)
    for name, limits in (structure.bounds or {}).items():
        k = names.index(name)
        for limit in limits:
            if limit:
                _refuse_beyond("a bound", name, limit, sizes[k], spread[k], "None or zero")
    for name, (mean, width) in (structure.priors or {}).items():
        k = names.index(name)
        if abs(mean) > sizes[k]:
            _refuse_beyond("a prior mean", name, mean, sizes[k], spread[k], "no prior")
        _refuse_beyond("a prior deviation", name, width, sizes[k], spread[k], "a fixed value")


def _refuse_beyond(
    what: str, name: str, value: float, size: float, spread: float, instead: str
) -> None:
    reach = REACH * spread
    if not 1.0 / reach <= abs(value) / size <= reach:
        raise ScaleError(
            f"found {what} of {value:.3g} for {name}, where the record leads one to expect the "
            f"order {size:.0e}; expected a number within a factor of {reach:.0e} of that; give "
            f"{instead} in its place, or correct the units"
        )


def _check_row(
    weights: dict[int, float], value: float, names: Sequence[str], sizes: Array, spread: Array
) -> None:
    if len(weights) == 1:
        ((k, weight),) = weights.items()
        if value:
            _refuse_beyond("a value", names[k], value / weight, sizes[k], spread[k], "zero")
        return
    shares = {k: abs(w) * sizes[k] for k, w in weights.items()}
    heaviest = max(shares, key=lambda k: shares[k])
    lightest = min(shares, key=lambda k: shares[k])
    reach = REACH * spread[heaviest] * spread[lightest]
    if shares[lightest] < shares[heaviest] / reach or abs(value) > shares[heaviest] * reach:
        unit = weights[heaviest]
        terms = format_sum({names[k]: w / unit for k, w in weights.items()})
        raise ScaleError(
            f"found {terms} = {value / unit:g}, in which {names[lightest]} counts for "
            f"{shares[lightest] / shares[heaviest]:.0e} of {names[heaviest]}; expected terms and a "
            f"value within a factor of {reach:.0e} of each other at coefficients of the size that "
            "the record suggests; correct the weights, or fix the coefficient"
        )
