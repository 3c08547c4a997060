"""A stored record run through an on-line estimator, and the way its coefficients went."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tridentify.errors import DataError, OptionError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.trace import freeze_arrays
from tridentify.numerics.arrays import Array
from tridentify.online.asked import NotReadyError, check_above_zero
from tridentify.online.estimator import Estimator
from tridentify.online.saved.state import Flag, State
from tridentify.record.listed import listed
from tridentify.record.record import Record
from tridentify.structure import Structure

POINTS = 200
"""Estimates along a record where none is asked for: a curve on a page."""


@dataclass(frozen=True, eq=False)
class Run:
    """What an on-line estimator made of a record.

    Attributes
    ----------
    time : (k,) array
        Since the first sample [s].
    names : tuple of str
        Of the coefficients.
    innovations : (n_samples, n_outputs) array
        What of every sample was not expected; ``nan`` where there was no expectation or no sample.
    flags : tuple of Flag, length k
        Everything that was the matter since the time before.
    state : State
        At the end.
    estimate : Estimate or None
        At the end; None where the record does not determine the coefficients.
    units : tuple of str, length n
        Of the coefficients; empty where not known.
    states : tuple of State, length k
        At these times.
    """

    time: Array
    names: tuple[str, ...]
    innovations: Array
    flags: tuple[Flag, ...]
    state: State
    estimate: Estimate | None
    units: tuple[str, ...] = ()
    states: tuple[State, ...] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __repr__(self) -> str:
        return f"Run({len(self.time)} times, {len(self.innovations)} samples, {self.estimate!r})"

    @property
    def theta(self) -> Array:
        """(k, n) coefficients at the times; ``nan`` before they are determined."""
        return self._trajectory[0]

    @property
    def std(self) -> Array:
        """(k, n) their standard errors."""
        return self._trajectory[1]

    @cached_property
    def _trajectory(self) -> tuple[Array, Array]:
        """Made when it is first asked for: an estimate costs more than a thousand samples."""
        theta = np.full((len(self.states), len(self.names)), np.nan)
        std = theta.copy()
        for row, state in enumerate(self.states):
            with suppress(NotReadyError):
                found = state.method.estimate(state)
                theta[row], std[row] = found.theta, found.std
        for one in (theta, std):
            one.setflags(write=False)
        return theta, std

    @property
    def changes(self) -> Array:
        """(c,) times at which the coefficients were found to have moved [s]."""
        return np.array(self.state.changes, dtype=np.float64) * self.state.dt


def run(
    method: Estimator,
    records: Record | Sequence[Record],
    structure: Structure,
    *,
    every: float | None = None,
) -> Run:
    """Run stored records through an on-line estimator, as if their samples arrived one by one.

    Parameters
    ----------
    method : Estimator
    records : Record or sequence of Record
        Parts of one stream, each joined to the one before it by one sampling interval.
    structure : Structure
    every : float, optional
        Time between two points of the trajectory [s]; by default there are about 200.

    Returns
    -------
    Run

    Raises
    ------
    OptionError
        ``method`` is no on-line estimator, or ``every`` is not above zero.
    DataError
        There is no record, or records differ in channels or sampling.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, TransferFunction, online, simulate
    >>> u = np.sign(np.sin(np.arange(400) ** 1.5))
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.02))
    >>> record = Record(u, y, dt=0.02)
    >>> found = online.run(online.ThreeModel(), record, Structure(1, 0), every=1.0)
    >>> found.theta[-1].round(6).tolist(), found.estimate.status.value
    ([4.0, 2.0], 'converged')
    """
    if not isinstance(method, Estimator):
        raise OptionError(
            f"found method={shown(method)}; expected an on-line estimator with its options; write "
            "for example online.ThreeModel()"
        )
    given = _checked(records)
    first = given[0]
    dt = float(np.median(np.diff(first.t))) if first.dt is None else first.dt
    state = method.init(
        structure, dt, input_names=list(first.input_names), output_names=list(first.output_names),
        units=first._units_of_a_model, intersample=first.behaviour,
    )  # fmt: skip
    u, y = first.u, first.y
    if len(given) > 1:
        u = np.vstack([record.u for record in given])
        y = np.vstack([record.y for record in given])
    intervals = _intervals(given, dt)
    block = _block(every, dt, len(u))
    times, states, flags = [], [], []
    innovations = np.full(y.shape, np.nan)
    estimate: Estimate | None = None
    for start in range(0, len(u), block):
        part = slice(start, min(start + block, len(u)))
        own = None if intervals is None else intervals[part]
        state, innovations[part], seen = method.feed(state, u[part], y[part], own)
        states.append(state)
        times.append(state.time)
        flags.append((Flag(int(np.bitwise_or.reduce(seen))) & ~Flag.NOT_READY) | state.flags)
    with suppress(NotReadyError):
        estimate = method.estimate(state)
    return Run(
        np.array(times),
        state.stage.setting.names,
        innovations,
        tuple(flags),
        state,
        estimate,
        () if estimate is None else tuple(p.unit for p in estimate.parameters.values()),
        tuple(states),
    )


def _checked(records: Record | Sequence[Record]) -> list[Record]:
    given = listed(records)
    if not given:
        raise DataError("found no record; expected at least one; pass a Record or a list of them")
    first = given[0]
    for one in given:
        same = (one.input_names, one.output_names, one.dt, one.behaviour)
        if same != (first.input_names, first.output_names, first.dt, first.behaviour):
            raise DataError(
                "found records with different channels or sampling; expected parts of one stream; "
                "run them one by one"
            )
    return given


def _intervals(records: Sequence[Record], dt: float) -> Array | None:
    if all(record.dt is not None for record in records):
        return None
    return np.concatenate([np.append(dt, np.diff(record.t)) for record in records])


def _block(every: float | None, dt: float, n_samples: int) -> int:
    if every is None:
        return max(-(-n_samples // POINTS), 1)
    check_above_zero("every", every, "seconds")
    return max(round(every / dt), 1)
