"""What validation looks at: the residual of every output, and all that a fit takes of it.

The residual is ``r = y - G u - offset - drift - free response`` at the coefficients of the
estimate. On the record that was identified the nuisance terms are those of the estimate. On
another record they are fitted, with the coefficients held, as the terms of lowest AICc: the start
of that record is its own.

Beside the residual stand its derivatives by the coefficients, multiplied by a root of their
covariance, ``D = (dy / d theta) C^{1/2}``, and those by the nuisance terms. On another record,
``r = e + D w + N v`` with ``w`` of covariance one: what the standard errors of the estimate say the
residual may hold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import ChannelCountError, DataError, TooFewSamplesError
from tridentify.estimation.answer.assemble import fingerprint
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.trace import Status
from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.curvature import physical_map
from tridentify.estimation.likelihood.noise.noise_levels import noise_sizes
from tridentify.estimation.likelihood.setup.linear_columns import free_states
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, reference_of
from tridentify.estimation.likelihood.setup.raster import are_even, on_raster
from tridentify.judgement.causes.attempts.first_samples import Predictions, beginning
from tridentify.judgement.causes.attempts.revisit import point_of, stated
from tridentify.models.response import Response
from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array, filled
from tridentify.numerics.autoregression import whiten_columns
from tridentify.numerics.information import aicc_price
from tridentify.numerics.kept import cached_property
from tridentify.numerics.least_squares import solve
from tridentify.numerics.realization import monomials
from tridentify.record.checks.times import typical_step
from tridentify.record.record import Record

LONGEST = 100_000
"""Samples of a record that are looked at."""
ROUNDING = 1e-9
"""Residual over output below which it is rounding, and nothing is tested."""
FEWEST = 20
"""Samples beyond the unknowns below which a residual cannot be tested."""
RANK = 1e-10
"""Eigenvalues of a correlation matrix below this share are rounding."""


@dataclass(frozen=True, eq=False)
class Output:
    """One output, over all experiments.

    Attributes
    ----------
    name : str
    y, fitted, residual : tuple of (n_samples,) arrays
        ``nan`` where a sample is missing.
    coefficients : tuple of (n_samples, r) arrays
        Derivatives by the coefficients times a root of their covariance.
    nuisance : tuple of (n_samples, s) arrays
        Derivatives by the terms that belong to the experiments.
    noise : (p,) array
        Autoregressive coefficients of the estimate's noise model.
    scale : tuple of float
        Noise of each experiment over that of all; empty where it is one.
    """

    name: str
    y: tuple[Array, ...]
    fitted: tuple[Array, ...]
    residual: tuple[Array, ...]
    coefficients: tuple[Array, ...]
    nuisance: tuple[Array, ...]
    noise: Array
    scale: tuple[float, ...] = ()

    @cached_property
    def seen(self) -> tuple[NDArray[np.bool_], ...]:
        """Where samples are."""
        return tuple(np.isfinite(one) for one in self.residual)

    @cached_property
    def count(self) -> int:
        """Samples that are there."""
        return sum(int(one.sum()) for one in self.seen)

    @property
    def is_rounding(self) -> bool:
        """Whether the residual is no more than rounding."""
        size = max(float(np.fmax.reduce(np.abs(one))) for one in self.y)
        joined = np.concatenate(self.residual)
        left = joined[~np.isnan(joined)]
        return not (left.size and np.sqrt(left @ left / left.size) > ROUNDING * size)

    def white(self, columns: Sequence[Array], noise: Array) -> Array:
        """Whiten columns, one experiment below the other; zero where a sample is missing.

        Over the noise of each experiment.

        Parameters
        ----------
        columns : sequence of (n_samples, k) or (n_samples,) arrays
        noise : (p,) array
        """
        columns = self.over_noise(columns)
        if columns[0].ndim > 1:
            return whiten_columns(columns, self.seen, noise)
        return whiten_columns([one[:, None] for one in columns], self.seen, noise)[:, 0]

    def over_noise(self, series: Sequence[Array]) -> Sequence[Array]:
        """One for each experiment, divided by its noise."""
        if not self.scale:
            return series
        return [one / size for one, size in zip(series, self.scale, strict=True)]

    @property
    def standardised(self) -> Sequence[Array]:
        """The residual over the noise of each experiment."""
        return self.over_noise(self.residual)


@dataclass(frozen=True, eq=False)
class View:
    """All outputs, the inputs, and where the nuisance terms come from.

    Attributes
    ----------
    records : tuple of Record
        Their beginnings, where they are long.
    outputs : tuple of Output
    point : Point
        The estimate on these records, for what could be changed about it.
    own : bool
        Whether the coefficients were fitted to these records.
    has_errors : bool
        Whether the estimate has standard errors.
    told : tuple of str
        What the reader should know.
    driven : bool
        Whether the inputs are what a reference drives, by the reference route. That the recorded
        ones react is known then; what these hold of the noise is what a finite record lets the
        reference seem to drive. Whether the reference itself reacts is another question
        (`validation.reacting_reference`).
    searched : dict
        Of every output that was asked for, what its residual is searched for
        (`validation.statistics.columns`).
    """

    records: tuple[Record, ...]
    outputs: tuple[Output, ...]
    point: Point
    own: bool
    has_errors: bool
    told: tuple[str, ...]
    driven: bool = False
    searched: dict[int, Any] = field(default_factory=dict, init=False, repr=False)

    @property
    def step(self) -> float:
        """A typical time between samples [s]."""
        first = self.records[0]
        return typical_step(first.t) if first.dt is None else first.dt

    @property
    def uneven(self) -> bool:
        """Whether time is uneven in any record, by more than a raster's jitter."""
        return not are_even(self.records)

    @property
    def stamped(self) -> bool:
        """Whether time is that of stamps in any record, even or not."""
        return any(record.dt is None for record in self.records)


def look(
    estimate: Estimate,
    records: Sequence[Record],
    experiment: int | None,
    *,
    own: bool = False,
    known: Predictions | None = None,
) -> View:
    """Put residual and derivatives together.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
    experiment : int, optional
        Of the estimate, whose nuisance terms belong to the record.
    own : bool
        Whether the records are known to be those that were identified, or their beginnings.
    known : Predictions, optional
        What the estimate says of these very records, from elsewhere.

    Raises
    ------
    ChannelCountError
        The channels are not those of the estimate.
    TooFewSamplesError
        There are too few samples to test anything.
    DataError
        The estimate has no such experiment.
    """
    check_channels(estimate, records, experiment)
    identified = own or fingerprint(records) == estimate.record_fingerprint
    whose = [experiment] * len(records) if experiment is not None else [*range(len(records))]
    own = identified or experiment is not None
    given, known = records, known or Predictions(estimate)
    if any(a.size for a in estimate.noise_model):
        # an autoregression counts in steps of the raster
        records = [on_raster(record.settled(estimate.intersample)) for record in records]
    told = []
    if any(record.n_samples > LONGEST for record in records):
        told.append(f"the first {LONGEST} samples of each record are looked at")
    kept = tuple(beginning(record, LONGEST) for record in records)
    if own:
        chosen = stated(estimate)
        what = "the record that was identified" if identified else f"as experiment {experiment}"
        told.insert(0, f"{what}: offset and initial state are those of the estimate")
        point = point_of(estimate, kept, chosen)
        point = point.answering(_response(estimate, point, whose))
        residual = [
            known.residual(record, e) if record is one else estimate.residual(record, experiment=e)
            for record, one, e in zip(kept, given, whose, strict=True)
        ]
        for e, one in enumerate(residual):
            _leave_out(estimate, one, whose[e])
    else:
        chosen, point, residual = _fitted_start(estimate, kept)
        told.insert(0, f"another record: {chosen.label}, fitted to it with the coefficients held")
    root = root_of(estimate)
    noises = [_noise(estimate, kept, i) for i in range(len(estimate.output_names))]
    found = _outputs(estimate.output_names, noises, kept, point, residual, root)
    for output in found:
        p = output.coefficients[0].shape[1] + output.nuisance[0].shape[1]
        if output.count < p + FEWEST:
            raise TooFewSamplesError(
                f"found {output.count} samples of output {output.name!r} for {p} unknowns; "
                "expected "
                f"at least {p + FEWEST} to test a residual; record longer"
            )
    has_errors, driven = bool(np.isfinite(estimate.cov).all()), estimate.route == "reference"
    return View(kept, found, point, own, has_errors, tuple(told), driven)


def check_channels(estimate: Estimate, records: Sequence[Record], experiment: int | None) -> None:
    """Refuse records that an estimate cannot be laid beside.

    Raises
    ------
    ChannelCountError
        The channels are not those of the estimate.
    TooFewSamplesError
        An output was not recorded.
    DataError
        The estimate has no such experiment.
    """
    wanted = (estimate.input_names, estimate.output_names)
    for record in records:
        if (record.input_names, record.output_names) != wanted:
            raise ChannelCountError(
                f"found a record with channels {record.input_names} -> {record.output_names}; "
                f"expected {wanted[0]} -> {wanted[1]} as identified; select its channels first"
            )
        for i, name in enumerate(record.output_names):
            if not np.isfinite(record.y[:, i]).any():
                raise TooFewSamplesError(
                    f"found no sample of output {name!r}; expected a recorded output to compare "
                    "with; choose a record that has it"
                )
    if experiment is None:
        return
    if not 0 <= experiment < len(estimate.nuisance) or len(records) > 1:
        raise DataError(
            f"found experiment={experiment} for {len(records)} records and an estimate of "
            f"{len(estimate.nuisance)} experiments; expected one record and an experiment from "
            "0 to "
            f"{len(estimate.nuisance) - 1}; leave experiment out to fit a start of its own"
        )


def _leave_out(estimate: Estimate, residual: Array, experiment: int) -> None:
    """Samples that a robust fit counts as outliers do not count here either."""
    for e, i, k, _ in estimate.outliers:
        if int(e) == experiment and int(k) < len(residual):
            residual[int(k), int(i)] = np.nan


def _choices(estimate: Estimate, records: Sequence[Record]) -> list[Nuisances]:
    """Ways in which other records may begin."""
    drift = estimate.structure.drift_degree
    found = [Nuisances("rest", False, drift), Nuisances("rest", True, drift)]
    if any(np.any(record.u[0]) for record in records):
        found.append(Nuisances("equilibrium", True, drift))
    return [*found, Nuisances("free", False, drift), Nuisances("free", True, drift)]


def _response(estimate: Estimate, point: Point, whose: Sequence[int] | None) -> Response:
    """The estimate's own outputs on the bank; without ``whose`` the free responses stay."""
    rows, direct = np.zeros_like(point.response.rows), np.zeros_like(point.response.direct)
    free = point.response.free.copy() if whose is None else np.zeros_like(point.response.free)
    for branch in point.branches:
        n = branch.inner.order
        powers = monomials(branch.inner, n)
        for i, j in np.argwhere(branch.channels).tolist():
            den, num = estimate.model.den[i][j], estimate.model.num[i][j]
            b = np.concatenate([np.zeros(n + 1 - num.size), num])
            direct[i, j] = b[0]
            rows[i, j, branch.own] = (b[1:] - b[0] * den[1:])[::-1] @ powers
            for e, own in enumerate(whose or ()):
                c = estimate.nuisance[own].free_response
                if c.ndim == 3:
                    free[e, i, branch.own] = c[i, j, -n:][::-1] @ powers
                else:
                    free[e, i, branch.own] = c[i, -n:][::-1] @ powers
    return Response(rows, direct, free)


def _columns(point: Point, output: int) -> tuple[tuple[Array, ...], NDArray[np.bool_], Array]:
    """Derivatives of one output by all unknowns; which are coefficients; the physical map."""
    physical, keys = physical_map(point)
    width = physical.shape[1]
    ours = np.zeros(width, dtype=np.bool_)
    for key, place in keys.items():
        inner = key[1] if isinstance(key, tuple) else key
        ours[place] = key in ("a", "delay") or (isinstance(inner, tuple) and inner[0] == "b")
    return point.sensitivities(np.eye(width), output), ours, physical


def _nuisance_columns(
    columns: Sequence[Array], ours: NDArray[np.bool_]
) -> tuple[tuple[Array, ...], NDArray[np.intp]]:
    """Those by nuisance terms that move this output at all, and which they are."""
    whole = [filled(one) for one in columns]
    kept = np.flatnonzero(~ours & np.any([one.any(axis=0) for one in whole], axis=0))
    return tuple(one[:, kept] for one in whole), kept


def _fitted_start(
    estimate: Estimate, records: Sequence[Record]
) -> tuple[Nuisances, Point, list[Array]]:
    """The start and the offset of other records, by AICc, for coefficients that are held."""
    best: tuple[float, Nuisances, Point, list[Array]] | None = None
    for chosen in _choices(estimate, records):
        point = point_of(estimate, records, chosen)
        residual = []
        for record, experiment in zip(records, point.problem.experiments, strict=True):
            moved = record.u - reference_of(record, chosen)
            driven = simulate(estimate.model, record._on_its_times(moved))
            residual.append(experiment.y - driven)
        free = np.zeros_like(point.response.free)
        criterion, n, k = 0.0, 0.0, 0.0
        for i in range(point.problem.n_outputs):
            columns, ours, _ = _columns(point, i)
            terms, kept = _nuisance_columns(columns, ours)
            left = tuple(one[:, i] for one in residual)
            sizes = noise_sizes(records, i)
            noise = _noise(estimate, records, i)
            output = Output("", left, left, left, terms, terms, noise, sizes)
            white = output.white(left, output.noise)
            solution = solve(output.white(terms, output.noise), white)
            for e, one in enumerate(terms):
                residual[e][:, i] -= one @ solution.x
            _set_free(point, free, i, dict(zip(kept.tolist(), solution.x, strict=True)))
            size = point.problem.size[i] * 1e-30
            criterion += output.count * np.log(solution.cost / output.count + size)
            n, k = n + output.count, k + kept.size + 1
        criterion += aicc_price(float(k), n)
        if best is None or criterion < best[0]:
            response = replace(_response(estimate, point, None), free=free)
            best = criterion, chosen, point.answering(response), residual
    assert best is not None
    return best[1:]


def start_columns(estimate: Estimate, records: Sequence[Record]) -> list[Array]:
    """What any start, and an offset, add to outputs, the coefficients held.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record

    Returns
    -------
    list of (n_samples, k) array
        Of every output, one experiment below the other.
    """
    point = point_of(estimate, records, Nuisances("free", True, estimate.structure.drift_degree))
    found = []
    for i in range(point.problem.n_outputs):
        columns, ours, _ = _columns(point, i)
        found.append(np.vstack(_nuisance_columns(columns, ours)[0]))
    return found


def _set_free(point: Point, free: Array, output: int, values: dict[int, float]) -> None:
    """Free responses that were fitted, on the states of the bank."""
    keys = point.width
    started = free_states(point.branches, output)
    for e in range(free.shape[0]):
        place = keys.get((output, ("free", e)))
        if place is not None:
            own = [values.get(k, 0.0) for k in range(place.start, place.stop)]
            free[e, output, started] = own


def _noise(estimate: Estimate, records: Sequence[Record], output: int) -> Array:
    """The estimate's noise model, where time is even enough for one."""
    return estimate.noise_model[output] if are_even(records) else np.zeros(0)


def root_of(estimate: Estimate) -> Array:
    """(n_coefficients, r) a factor of the covariance; the identity where there is none."""
    if not np.isfinite(estimate.cov).all() or estimate.status is Status.STALLED:
        return np.eye(len(estimate.names))
    std = estimate.std
    kept = np.flatnonzero(std)
    root = np.zeros((std.size, kept.size))
    scaled = estimate.cov[np.ix_(kept, kept)] / np.outer(std[kept], std[kept])
    values, vectors = np.linalg.eigh(scaled)
    root[kept] = std[kept, None] * vectors * np.sqrt(np.where(values > RANK, values, 0.0))
    return np.asarray(root[:, root.any(axis=0)])


def refitted(view: View, point: Point) -> View:
    """The same records seen from another model that was fitted to them.

    Parameters
    ----------
    view : View
    point : Point
        Where that model ended.
    """
    root = np.eye(point.problem.n_coefficients)
    noises = [output.noise for output in view.outputs]
    names = [output.name for output in view.outputs]
    found = _outputs(names, noises, view.records, point, point.residuals(), root)
    return replace(view, outputs=found, point=point, own=True, has_errors=False)


def _outputs(
    names: Sequence[str],
    noises: Sequence[Array],
    records: Sequence[Record],
    point: Point,
    residual: Sequence[Array],
    root: Array,
) -> tuple[Output, ...]:
    found = []
    for i, name in enumerate(names):
        columns, ours, physical = _columns(point, i)
        # the physical coefficients may differ by many orders of magnitude
        scale = np.abs(physical[:, ours]).max(axis=1, keepdims=True)
        scale = np.where(scale > 0, scale, 1.0)
        moved = np.linalg.solve(physical[:, ours] / scale, root / scale)
        own = tuple(filled(one[:, ours]) @ moved for one in columns)
        terms = _nuisance_columns(columns, ours)[0]
        left = tuple(
            np.where(np.isfinite(e.y[:, i]), one[:, i], np.nan)
            for e, one in zip(point.problem.experiments, residual, strict=True)
        )
        y = tuple(np.asarray(record.y[:, i]) for record in records)
        fitted = tuple(a - b for a, b in zip(y, left, strict=True))
        sizes = noise_sizes(records, i)
        found.append(Output(name, y, fitted, left, own, terms, noises[i], sizes))
    return tuple(found)
