"""A structure and its records, resolved: what every pass of an estimator works on."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tridentify.models.flat_charts import FlatCharts
from tridentify.models.regression import Experiment, Regression, restricted
from tridentify.numerics.arrays import Array, Complex, Flags, Indices
from tridentify.numerics.kept import cached_property, varied
from tridentify.numerics.realization import Cascade, denominator, sort_poles
from tridentify.structure import Structure

SLOWEST = 1e-3
"""Slowest decay over one over the record's length: a pole that loses a thousandth over all of the
record cannot be told from an integrator in noise."""
FASTEST = 20.0
"""Fastest pole times sampling interval: exp(-20) = 2e-9 of it is left at the next sample, so that a
faster one would change nothing."""
LEAST_DAMPED = 1e-6
"""Damping that a pole keeps at least: a million radians to decay, beyond any record."""
BELOW_NYQUIST = 0.98
"""Share of the Nyquist frequency that a pair may reach: at the limit itself its two parts cannot be
told apart."""

ON_A_STEP = 0.02
"""Steps from a whole one within which a delay counts as lying on the kink there: the slope jumps,
so that steps end close to it and not on it."""

OF_ORDERS = frozenset(
    {"pattern", "n_coefficients", "n_states", "_places", "slowest", "nyquist", "fastest"}
)
"""What is the same whatever nuisance terms are estimated along (`Variant.problem`)."""

REFLECTED = "reflected an unstable pole"
TOO_FAST = "held a pole at the fastest the sampling can show"
TOO_SLOW = "held a pole at the slowest decay the record can show"


class Group(NamedTuple):
    """Channels that share one denominator.

    Attributes
    ----------
    order : int
        Degree of the denominator.
    first : int
        Position of its first pole among those of all groups.
    channels : tuple of (output, input)
    """

    order: int
    first: int
    channels: tuple[tuple[int, int], ...]

    @property
    def poles(self) -> slice:
        """Where its poles stand among those of all groups."""
        return slice(self.first, self.first + self.order)

    def of_output(self, output: int) -> bool:
        """Whether any of its channels leads to an output."""
        return any(i == output for i, _ in self.channels)


class Pattern(NamedTuple):
    """Which channel has which denominator, as arrays (`compiled_cost`).

    ``orders``, ``firsts`` (n_groups,): number of poles of each denominator, and the first of them
    among all; ``group``, ``zeros`` (n_outputs, n_inputs): the denominator of each channel and the
    degree of its numerator.
    """

    orders: Indices
    firsts: Indices
    group: Indices
    zeros: Indices

    @property
    def channels(self) -> tuple[Flags, ...]:
        """For each denominator (n_outputs, n_inputs), which channels have it."""
        return tuple(self.group == g for g in range(self.orders.size))


@dataclass(frozen=True, eq=False)
class Problem:
    """Experiments and orders; nuisance terms are decided.

    The channels fall into groups that share a denominator: all of them in one, or each on its own.
    The poles of all groups are one vector, group by group.

    Attributes
    ----------
    experiments : tuple of Experiment
    n_poles : int
        Number of poles of all groups: with one group the degree of the shared denominator.
    n_zeros : tuple of tuples of int
        Degrees of the numerators, ``[output][input]``.
    power : (n_outputs,) array
        Mean squares of the outputs about their means.
    size : (n_outputs,) array
        Mean squares of the outputs as recorded: what rounding is relative to.
    groups : tuple of Group
    limits : (n_inputs,) array, optional
        Where the delays of the inputs are estimated along: how large each may become [s].
    pinned : (n_inputs,) bool array, optional
        Delays that stay, for the time being, where they are.
    floors : (n_inputs,) array, optional
        How small each delay may become [s], where not zero.
    """

    experiments: tuple[Experiment, ...]
    n_poles: int
    n_zeros: tuple[tuple[int, ...], ...]
    power: Array
    size: Array
    groups: tuple[Group, ...]
    limits: Array | None = None
    pinned: NDArray[np.bool_] | None = None
    floors: Array | None = None

    @classmethod
    def of(
        cls,
        experiments: Sequence[Experiment],
        n_poles: int | Sequence[Sequence[int]],
        n_zeros: tuple[tuple[int, ...], ...],
    ) -> Problem:
        """A problem with the scales of its outputs.

        Parameters
        ----------
        experiments : sequence of Experiment
        n_poles : int or nested sequence of int
            Degree of the shared denominator; nested ``[output][input]`` for separate ones.
        n_zeros : tuple of tuples of int
        """
        spread = np.zeros(len(n_zeros))
        size = np.zeros(len(n_zeros))
        count = np.zeros(len(n_zeros))
        for e in experiments:
            n, own, about = e.moments
            spread += about
            size = np.maximum(size, own)
            count += n
        return cls.scaled(experiments, n_poles, n_zeros, spread / count, size)

    @classmethod
    def scaled(
        cls,
        experiments: Sequence[Experiment],
        n_poles: int | Sequence[Sequence[int]],
        n_zeros: tuple[tuple[int, ...], ...],
        power: Array,
        size: Array,
    ) -> Problem:
        """A problem whose outputs' scales are known: ``power`` and ``size`` of the attributes."""
        groups = _groups(n_poles, n_zeros)
        total = sum(group.order for group in groups)
        return cls(tuple(experiments), total, n_zeros, power, size, groups)

    def over(self, experiments: Sequence[Experiment]) -> Problem:
        """The same orders and groups for other experiments."""
        found = Problem.of(experiments, self.n_poles, self.n_zeros)
        return replace(found, groups=self.groups, limits=self.limits)

    @property
    def delays(self) -> Array:
        """(n_inputs,) how late each input reaches the first output [s]."""
        delays = self.experiments[0].delays
        return np.zeros(self.n_inputs) if delays is None else np.asarray(delays[0])

    def delayed(self, delays: Array) -> Problem:
        """The same problem with these delays [s] of the inputs, in every experiment."""
        late = np.tile(delays, (self.n_outputs, 1)) if np.any(delays) else None
        return replace(self, experiments=tuple(replace(e, delays=late) for e in self.experiments))

    def kinks(self) -> NDArray[np.bool_]:
        """(n_inputs,) whether a delay lies where the cost has a kink: on a whole step of a hold."""
        steps = [e.dt for e in self.experiments if e.intersample == "zoh" and e.t is None]
        near = [np.abs(self.delays / dt - np.round(self.delays / dt)) < ON_A_STEP for dt in steps]
        return np.any(near, axis=0) if near else np.zeros(self.n_inputs, dtype=bool)

    def freed(self, limits: Array | None, floors: Array | None = None) -> Problem:
        """The same problem with delays estimated along within limits, or known (None)."""
        return replace(self, limits=limits, floors=floors)

    @cached_property
    def pattern(self) -> Pattern:
        """Its orders and channels as arrays."""
        group = np.zeros((self.n_outputs, self.n_inputs), dtype=np.int64)
        for g, own in enumerate(self.groups):
            for i, j in own.channels:
                group[i, j] = g
        return Pattern(
            np.array([own.order for own in self.groups], dtype=np.int64),
            np.array([own.first for own in self.groups], dtype=np.int64),
            group,
            np.array(self.n_zeros, dtype=np.int64).reshape(group.shape),
        )

    @cached_property
    def flat(self) -> FlatCharts | None:
        """Its experiments for machine code; None where that does not serve."""
        return FlatCharts.of(self.experiments)

    @cached_property
    def charted(self) -> dict[Hashable, Any]:
        """What machine code is given of choices of nuisance terms (`charted.given`)."""
        return {}

    @cached_property
    def smaller(self) -> dict[Variant, Problem]:
        """The problems of choices of nuisance terms, made once (`Variant.problem`)."""
        return {}

    @property
    def n_delays(self) -> int:
        """Number of delays that are estimated along."""
        return 0 if self.limits is None else self.limits.size

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return len(self.n_zeros)

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return len(self.n_zeros[0])

    @property
    def biproper(self) -> bool:
        """Whether any channel has as many zeros as poles."""
        return any(self.n_zeros[i][j] == g.order for g in self.groups for i, j in g.channels)

    def order(self, output: int, input_: int) -> int:
        """Degree of the denominator of a channel."""
        return next(g.order for g in self.groups if (output, input_) in g.channels)

    def free_order(self, output: int) -> int:
        """Number of states that an unknown initial state of one output has."""
        return sum(g.order for g in self.groups if g.of_output(output))

    def split(self, poles: Complex) -> tuple[Complex, ...]:
        """The poles of each group."""
        return tuple(poles[g.poles] for g in self.groups)

    def lower_coefficients(self, poles: Complex) -> Array:
        """(n_poles,) ``a_{n-1} .. a_0`` of every group."""
        return np.concatenate([denominator(own)[1:] for own in self.split(poles)])

    def vector(self, poles: Complex, b: Sequence[Sequence[Array]]) -> Array:
        """The parameter vector of poles and numerators, without delays.

        Parameters
        ----------
        poles : (n_poles,) complex array
            Group by group.
        b : nested sequence of arrays
            ``b[output][input]``, descending powers.
        """
        a_places, b_places = self.places()
        found = np.zeros(self.n_coefficients - self.n_delays)
        for place, own in zip(a_places, self.split(poles), strict=True):
            found[place] = denominator(own)[1:]
        for (i, j), place in b_places.items():
            found[place] = b[i][j]
        return found

    def joined(self, poles: Complex, numerators: Array) -> Array:
        """The parameter vector of poles and of all numerators one after the other."""
        found, at = np.zeros(self.n_coefficients - self.n_delays), 0
        a_places, b_places = self.places()
        for place, own in zip(a_places, self.split(poles), strict=True):
            found[place] = denominator(own)[1:]
        for place in b_places.values():
            width = place.stop - place.start
            found[place] = numerators[at : at + width]
            at += width
        return found

    def places(self) -> tuple[tuple[slice, ...], dict[tuple[int, int], slice]]:
        """Where the coefficients stand in the parameter vector (`Structure.names`).

        Returns
        -------
        a : tuple of slice
            Of every group.
        b : dict of (output, input) to slice
            Delays that are estimated along stand behind all of them.
        """
        return self._places

    @cached_property
    def _places(self) -> tuple[tuple[slice, ...], dict[tuple[int, int], slice]]:
        a: dict[int, slice] = {}
        b: dict[tuple[int, int], slice] = {}
        at = 0
        for i, row in enumerate(self.n_zeros):
            for j, m in enumerate(row):
                k = next(k for k, g in enumerate(self.groups) if (i, j) in g.channels)
                if k not in a:
                    a[k] = slice(at, at + self.groups[k].order)
                    at += self.groups[k].order
                b[i, j] = slice(at, at + m + 1)
                at += m + 1
        return tuple(a[k] for k in range(len(self.groups))), b

    def denominator_places(self) -> NDArray[np.intp]:
        """(n_poles,) positions of all ``a`` in the parameter vector, group by group."""
        every = np.arange(self.n_coefficients)
        return np.concatenate([every[place] for place in self.places()[0]])

    @cached_property
    def n_coefficients(self) -> int:
        """Number of physical coefficients."""
        return self.n_poles + sum(m + 1 for row in self.n_zeros for m in row) + self.n_delays

    @cached_property
    def n_nuisance(self) -> int:
        """Number of nuisance terms over all experiments and outputs."""
        states, outputs = self.n_states, self.n_outputs
        return sum(states * e.free + outputs * (e.offset + e.drift) for e in self.experiments)

    @cached_property
    def n_states(self) -> int:
        """Number of states that unknown initial states of all outputs have."""
        return sum(self.free_order(i) for i in range(self.n_outputs))

    @property
    def noise(self) -> tuple[Array, ...]:
        """Autoregressive coefficients of each output's noise; empty where all are white."""
        return self.experiments[0].noise

    def whitened(self, noise: tuple[Array, ...]) -> Problem:
        """The same problem with a model of the noise (the empty tuple: white)."""
        if not noise and not any(e.noise for e in self.experiments):
            return self
        experiments = tuple(replace(e, noise=noise) for e in self.experiments)
        return replace(self, experiments=experiments)

    @cached_property
    def slowest(self) -> float:
        """Slowest decay that can be told from a constant [rad/s]."""
        return SLOWEST / max(e.duration for e in self.experiments)

    @property
    def shortest(self) -> float:
        """Length of the shortest experiment [s]."""
        return min(e.duration for e in self.experiments)

    @cached_property
    def nyquist(self) -> float:
        """Largest imaginary part of a pole that the sampling shows [rad/s]."""
        return float(BELOW_NYQUIST * np.pi / min(e.dt for e in self.experiments))

    @cached_property
    def fastest(self) -> float:
        """Fastest pole that leaves a trace between two samples [rad/s]."""
        return FASTEST / min(e.dt for e in self.experiments)

    def admissible(self, poles: Complex) -> tuple[Complex, str]:
        """Reflect unstable poles and keep all of them where the record can see them.

        Parameters
        ----------
        poles : (n,) complex array [rad/s]

        Returns
        -------
        poles : (n,) complex array
            In the open left half plane, those of each group slow to fast.
        note : str
            What was done; empty when nothing was.
        """
        fastest, slowest, reflected, fast, slow = self.fastest, self.slowest, False, False, False
        nyquist = self.nyquist
        kept = []
        # the poles are few: numbers one by one take a fraction of the time of so small arrays
        for z, size in zip(poles.tolist(), np.abs(poles).tolist(), strict=True):
            real = z.real if math.isfinite(z.real) else -fastest
            imag = z.imag if math.isfinite(z.imag) else 0.0
            reflected |= real > 0
            factor = fastest / max(size, fastest) if math.isfinite(size) else 1.0
            real, imag = -abs(real) * factor, imag * factor
            fast |= factor < 1 or abs(imag) > nyquist
            imag = min(max(imag, -nyquist), nyquist)
            floor = max(slowest, LEAST_DAMPED * abs(imag))
            slow |= -real < floor
            kept.append(complex(-max(-real, floor), imag))
        note = TOO_SLOW if slow else TOO_FAST if fast else REFLECTED if reflected else ""
        if len(self.groups) == 1:
            return sort_poles(np.array(kept, dtype=np.complex128)), note
        own = self.split(np.array(kept, dtype=np.complex128))
        return np.concatenate([sort_poles(one) for one in own]), note


@dataclass(frozen=True, eq=False)
class Variant:
    """A choice of nuisance terms seen from a problem that has all of them.

    Attributes
    ----------
    free, offset : bool
        Which terms to keep.
    drift : int
        Degree of the drift that is kept.
    constants : tuple of (n_inputs,) arrays or None
        Per experiment, what has to be added back to the inputs.
    """

    free: bool
    offset: bool
    drift: int
    constants: tuple[Array | None, ...]

    def problem(self, base: Problem) -> Problem:
        """The smaller problem; its inputs are the base's, so it is for counting only."""
        found = base.smaller.get(self)
        if found is None:
            own, whole = (self.free, self.offset, self.drift), base.experiments
            if all((e.free, e.offset, e.drift) == own for e in whole) and not any(
                constant is not None for constant in self.constants
            ):
                found = base.smaller[self] = base
                return found
            experiments = tuple(e.beside(*own) for e in whole)
            found = base.smaller[self] = varied(base, OF_ORDERS, experiments=experiments)
        return found

    def regressions(self, whole: Sequence[Regression], bank: Cascade) -> tuple[Regression, ...]:
        """Triangles of the smaller problem from those of the base."""
        return tuple(
            restricted(
                regression,
                bank,
                free=self.free,
                offset=self.offset,
                drift=self.drift,
                constants=constants,
            )
            for regression, constants in zip(whole, self.constants, strict=True)
        )


def poles_of(structure: Structure) -> int:
    """Degree of the shared denominator."""
    return structure.common_poles


def states_of(structure: Structure, n_outputs: int, n_inputs: int) -> tuple[int, ...]:
    """Number of states behind every output: of the shared denominator, or of all its own."""
    if structure.shared:
        return (poles_of(structure),) * n_outputs
    return tuple(sum(row) for row in structure.poles_matrix(n_outputs, n_inputs))


def _groups(
    n_poles: int | Sequence[Sequence[int]], n_zeros: tuple[tuple[int, ...], ...]
) -> tuple[Group, ...]:
    channels = [(i, j) for i, row in enumerate(n_zeros) for j in range(len(row))]
    if isinstance(n_poles, int):
        return (Group(n_poles, 0, tuple(channels)),)
    found, first = [], 0
    for i, j in channels:
        found.append(Group(n_poles[i][j], first, ((i, j),)))
        first += n_poles[i][j]
    return tuple(found)
