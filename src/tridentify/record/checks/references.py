"""Checks of references: what drove a loop from outside while its input was set by a controller."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from tridentify.errors import ChannelNameError, LengthMismatchError, OptionError, shown
from tridentify.numerics.arrays import Array
from tridentify.record.checks.samples import (
    Behaviour,
    Intersample,
    check_band_limited,
    check_distinct,
    check_intersample,
    check_tall,
    looks_measured,
    rests_between_steps,
    sample_array,
)


def check_shared(
    inputs: tuple[Sequence[str], Array],
    output_names: Sequence[str],
    references: tuple[Sequence[str], Array | None],
) -> None:
    """Refuse references called as an output, as each other, or as an input with other samples.

    Parameters
    ----------
    inputs, references : names and samples
    output_names : sequence of str

    Raises
    ------
    ChannelNameError

    Examples
    --------
    >>> import numpy as np
    >>> heat = np.array([[0.0], [1.0]])
    >>> check_shared((("heat",), heat), ("y",), (("heat",), heat))
    """
    names, driven = references
    check_distinct((*output_names, *names))
    for k, name in enumerate(names):
        if name not in inputs[0] or driven is None:
            continue
        if not np.array_equal(inputs[1][:, list(inputs[0]).index(name)], driven[:, k]):
            raise ChannelNameError(
                f"found the channel name {shown(name)} more than once, as an input and as a "
                "reference with other samples; expected the same samples, or another name; rename "
                "one"
            )


def reference_array(
    reference: ArrayLike | None, names: Sequence[str] | None, n_samples: int
) -> Array | None:
    """Give read-only samples of shape (n_samples, n_references), or None where there is none.

    Parameters
    ----------
    reference : array_like or None
    names : sequence of str or None
        As stated; there must be none without a reference.
    n_samples : int
        Of the record.

    Raises
    ------
    SampleTypeError, ShapeError, LengthMismatchError
        The samples are no real numbers, or do not fit the record.
    ChannelNameError
        Names without a reference.

    Examples
    --------
    >>> reference_array([0, 1, 1], None, 3).shape
    (3, 1)
    """
    if reference is None:
        if names is not None and len(names):
            raise ChannelNameError(
                f"found reference_names={shown(names)} without a reference; expected reference=, "
                "the samples that they name; give both or neither"
            )
        return None
    samples = sample_array("reference", reference)
    if len(samples) != n_samples:
        raise LengthMismatchError(
            f"found {len(samples)} samples of reference and {n_samples} of u; expected equal "
            "lengths along the first axis; cut the longer one, or transpose if time runs along a "
            "row"
        )
    check_tall("reference", samples)
    return samples


def reference_between(
    stated: Intersample | None,
    intersample: Intersample,
    reference: Array | None,
    step: float | None,
) -> Intersample | None:
    """What a reference is stated to do between its samples: by itself, or as the input does.

    What is stated of an input that was measured holds of no reference that rests and is switched:
    lines would lead from each rest to the next, and a loop follow them before it was told to.

    Parameters
    ----------
    stated : {"zoh", "foh", "band-limited", "auto"} or None
        None for what is stated of the input, but for a reference that is switched.
    intersample : {"zoh", "foh", "band-limited", "auto"}
        Of the input.
    reference : ndarray or None
    step : float or None
        Uniform sampling interval [s].

    Returns
    -------
    str or None
        None without a reference.

    Raises
    ------
    OptionError, NonUniformTimeError, TooFewSamplesError
        There is no such behaviour, there is no reference to have it, or the record does not allow
        it.

    Examples
    --------
    >>> import numpy as np
    >>> ramp, switched = np.arange(8.0)[:, None], np.repeat([0.0, 1.0], 4)[:, None]
    >>> [reference_between(None, "foh", one, 0.1) for one in (ramp, switched)]
    ['foh', 'zoh']
    """
    if reference is None:
        if stated is not None:
            raise OptionError(
                f"found reference_intersample={shown(stated)} without a reference; expected "
                "reference=, the samples that it is about; give both or neither"
            )
        return None
    if stated is None:
        return drawn_unless_switched(intersample, list(reference.T))
    check_intersample(stated, "reference_intersample", "reference")
    if stated == "band-limited":
        check_band_limited(step, len(reference), "reference_intersample")
    return stated


def drawn_unless_switched(intersample: Intersample, references: Sequence[Array]) -> Intersample:
    """What is stated of an input, for references that nothing is stated of; switched ones are held.

    Examples
    --------
    >>> drawn_unless_switched("band-limited", [np.repeat([0.0, 1.0], 4)])
    'zoh'
    """
    drawn = intersample in ("foh", "band-limited")
    return "zoh" if drawn and rests_between_steps(references) else intersample


def settled_reference(stated: Intersample | None, reference: Array | None) -> Behaviour | None:
    """What a reference is taken to do between its samples; its samples decide what is left open.

    Examples
    --------
    >>> import numpy as np
    >>> settled_reference("auto", np.array([[0.0], [1.0], [1.0]]))
    'zoh'
    """
    if reference is None or stated is None:
        return None
    if stated != "auto":
        return stated
    return "foh" if looks_measured(reference) else "zoh"
