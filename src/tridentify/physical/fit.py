"""From records to physical parameters.

The coefficients are estimated freely first (`identify`). What the map makes of them is found by the
least distance (`distance`) and, unless that is enough, by the likelihood itself (`likelihood`). The
covariance of the parameters is the inverse information ``(G' V^{-1} G)^{-1}`` with ``G`` the
derivatives of the map; where the map is one to one that is the delta method, ``G^{-1} V G^{-T}``.
Where parameters are not determined (`identifiability`) the information is inverted on what is, and
the parameters and products that depend on nothing else are given.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from scipy.special import chdtrc

from tridentify.errors import (
    ChannelNameError,
    OptionError,
    PhysicalParameterError,
    UnsupportedError,
    shown,
)
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.parameter import Parameter
from tridentify.estimation.methods.base import Method, Progress
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.identify import identify
from tridentify.numerics.arrays import Array
from tridentify.numerics.threads import one_blas_thread
from tridentify.physical.distance import Known, Nearest, Restriction, nearest, weight_of
from tridentify.physical.identifiability import (
    Identifiability,
    combination_gradient,
    identifiability,
    product_text,
    product_unit,
)
from tridentify.physical.likelihood import PhysicalMaximum, directions, maximum
from tridentify.physical.model import PhysicalModel
from tridentify.physical.profile import Profile
from tridentify.physical.result import AS_WELL, PhysicalEstimate
from tridentify.record.record import Record

Fit = Literal["likelihood", "distance"]

WEAK = 1.0
"""Relative standard error from which a parameter is called poorly known: its sign is open."""


def estimate_physical(
    model: PhysicalModel,
    records: Record | Sequence[Record],
    method: Method | None = None,
    *,
    known: Mapping[str, float | tuple[float, float]] | None = None,
    channels: Mapping[str, str] | None = None,
    fit: Fit = "likelihood",
    progress: Progress | None = None,
) -> PhysicalEstimate:
    """Estimate physical parameters from records.

    Parameters
    ----------
    model : PhysicalModel
    records : Record or sequence of Record
        One or several experiments on the same system.
    method : Method, optional
        For the coefficients; ``ThreeModel(finish="likelihood")`` by default.
    known : mapping of str to float or (float, float), optional
        Parameters that are known, by name: a value that is held, or a value with its standard
        deviation, which the record may improve and which is carried over to the others.
    channels : mapping of str to str, optional
        Channel of the model -> channel of the records, where the names differ.
    fit : {"likelihood", "distance"}
        Whether to end on the likelihood of the records or on the least distance to the freely
        estimated coefficients; the two differ on short records only. With a delay among the
        coefficients it is the distance, since other samples are explained at another delay.
    progress : callable, optional
        Told in words what is going on.

    Returns
    -------
    PhysicalEstimate
        Parameters that are not determined are ``nan``, and its notes say what is determined.

    Raises
    ------
    PhysicalParameterError
        ``known`` names no parameter, or has no usable value for it.
    ChannelNameError
        The records do not have the model's channels.
    UnsupportedError
        The method gives coefficients without covariance.
    ConvergenceError
        No parameters are near the estimated coefficients.
    DataError, StructureError, IdentifiabilityError
        As `identify`.

    Examples
    --------
    >>> from tridentify import Record, simulate
    >>> from tridentify.physical import estimate_physical, mass_spring_damper
    >>> oscillator = mass_spring_damper()
    >>> force = np.sign(np.sin(np.arange(400) ** 1.5))
    >>> rest = Record(force, force, dt=0.05, input_names=["force"], output_names=["position"])
    >>> y = simulate(oscillator.transfer_function({"m": 2.0, "c": 1.0, "k": 8.0}), rest)
    >>> y = y + 1e-3 * np.random.default_rng(1).standard_normal(y.shape)
    >>> record = Record(force, y, dt=0.05, input_names=["force"], output_names=["position"])
    >>> estimate = estimate_physical(oscillator, record)
    >>> estimate.values.round(2).tolist()
    [2.0, 1.0, 8.0]
    """
    if fit not in ("likelihood", "distance"):
        raise OptionError.found("fit=", fit, "'likelihood' or 'distance'", "choose one")
    held = checked_known(model, known or {})
    listed = [records] if isinstance(records, Record) else list(records)
    chosen = [_arranged(model, record, channels or {}) for record in listed]
    default = ThreeModel(finish="likelihood")
    estimate = identify(chosen, model.structure, method or default, progress=progress)
    if not np.all(np.isfinite(estimate.cov)):
        raise UnsupportedError(
            f"found no covariance of the coefficients from {estimate.method}; expected one, which "
            "weighs them; use ThreeModel() or OutputError()"
        )
    chosen = [record.settled(estimate.intersample) for record in chosen]
    if model.structure.delay == "free":
        fit = "distance"
    with one_blas_thread():
        return _from_coefficients(model, chosen, estimate, held, fit, progress or (lambda _: None))


def checked_known(
    model: PhysicalModel, known: Mapping[str, float | tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    """Values with standard deviations of the parameters that are known.

    Raises
    ------
    PhysicalParameterError
    """
    found: dict[str, tuple[float, float]] = {}
    for name, given in known.items():
        if name not in model.names:
            raise PhysicalParameterError(
                f"found {shown(name)} among the known parameters; expected some of "
                f"{', '.join(model.names)}; correct the name"
            )
        pair = tuple(given) if isinstance(given, (tuple, list)) else (given, 0.0)
        usable = len(pair) == 2 and all(
            isinstance(x, (int, float, np.number)) and math.isfinite(x) for x in pair
        )
        positive = model.parameters[model.names.index(name)].positive
        if not usable or pair[1] < 0 or (positive and pair[0] <= 0):
            wanted = "a positive value" if positive else "a finite value"
            raise PhysicalParameterError.found(
                f"{name}=", given, f"{wanted}, or (value, standard deviation)"
            )
        found[name] = (float(pair[0]), float(pair[1]))
    return found


def _arranged(model: PhysicalModel, record: Record, channels: Mapping[str, str]) -> Record:
    """The record's channels in the order of the model."""
    ours = (*model.input_names, *model.output_names)
    unknown = [name for name in channels if name not in ours]
    if unknown:
        raise ChannelNameError(
            f"found channels for {shown(unknown[0])}; expected channels of {model.name}: "
            f"{', '.join(ours)}; correct the name"
        )
    single = len(ours) == 2 and record.n_inputs == record.n_outputs == 1
    if single and not channels:
        return record
    inputs = [channels.get(name, name) for name in model.input_names]
    outputs = [channels.get(name, name) for name in model.output_names]
    there = (*record.input_names, *record.output_names)
    missing = [name for name in (*inputs, *outputs) if name not in there]
    if missing:
        raise ChannelNameError(
            f"found the channels {', '.join(there)}; expected {', '.join(ours)} for {model.name}; "
            f"say which is which, as in channels={{{ours[0]!r}: {there[0]!r}}}"
        )
    return record.select(inputs, outputs)


def _from_coefficients(
    model: PhysicalModel,
    records: Sequence[Record],
    estimate: Estimate,
    known: Known,
    fit: Fit,
    say: Progress,
) -> PhysicalEstimate:
    weight = weight_of(estimate.cov, estimate.theta)
    restriction = Restriction(model, estimate.theta, weight, known)
    said = identifiability(model, known=tuple(known))
    say("physical parameters of least distance")
    closest = nearest(restriction, unique=said.complete)
    said = identifiability(model, model.at(closest.z), tuple(known))
    rank = restriction.rank(said.rank)
    profile = Profile.of(records, estimate)
    best: PhysicalMaximum | None = None
    if fit == "likelihood" and estimate.loss == "squared":
        say("physical parameters of greatest likelihood")
        best = maximum(restriction, profile, closest.z, rank)
    z = closest.z if best is None else best.z
    root = directions(restriction, z, rank) if best is None else best.root
    held = best.held if best else profile.at(model.theta_at(z))
    raw = np.full(profile.counts.size, np.nan) if held is None else held.raw
    statistic = closest.distance if best is None else best.ratio
    errors = np.sqrt(np.diag(estimate.cov))
    freedom = int(np.sum(errors > 0)) + len(restriction.informed) - rank
    tested = freedom > 0 and np.isfinite(statistic)
    values, cov = _parameters(model, said, known, z, root)
    slope = model.jacobian(z)
    notes = [*said.lines(), *_other_notes(model, closest, best, fit, values, cov, estimate.loss)]
    return PhysicalEstimate(
        model_name=model.name,
        names=model.names,
        units=tuple(p.unit for p in model.parameters),
        descriptions=tuple(p.description for p in model.parameters),
        values=values,
        cov=cov,
        known=known,
        combinations=_combinations(model, said, z, root),
        notes=tuple(notes),
        alternatives=np.array([model.values(o) for o in closest.others]).reshape(-1, values.size),
        theta=model.theta_at(z),
        theta_cov=_square(slope @ root),
        fit=100.0 * (1.0 - np.sqrt(raw / np.maximum(profile.spread, 1e-300))),
        statistic=float(statistic) if tested else np.nan,
        freedom=freedom,
        p_value=float(chdtrc(freedom, statistic)) if tested else np.nan,
        by_distance=_parameters(model, said, known, closest.z, root)[0],
        estimate=estimate,
    )


def _square(root: Array) -> Array:
    return np.asarray(root @ root.T)


def _parameters(
    model: PhysicalModel, said: Identifiability, known: Known, z: Array, root: Array
) -> tuple[Array, Array]:
    """Parameters and their covariance; ``nan`` for what is not determined."""
    values = model.values(z)
    cov = _square(model.slope(z)[:, None] * root)
    lost = [n in said.unknown and n not in said.determined for n in model.names]
    if not said.complete:
        values[lost] = np.nan
        cov[lost, :] = np.nan
        cov[:, lost] = np.nan
    for i, name in enumerate(model.names):
        if name in known and known[name][1] == 0:
            values[i] = known[name][0]
    return values, cov


def _combinations(
    model: PhysicalModel, said: Identifiability, z: Array, root: Array
) -> tuple[Parameter, ...]:
    """Determined products, where parameters are not, and declared combinations."""
    values, scale = model.values(z), model.slope(z) / model.values(z)
    logs = scale[:, None] * root  # standard errors of log|phi|
    found = []
    for powers in said.products:
        exponents = {name: float(p) for name, p in powers}
        w = np.array([exponents.get(name, 0.0) for name in model.names])
        value = float(np.prod(values**w))
        std = abs(value) * float(np.linalg.norm(w @ logs))
        unit = product_unit(powers, model.units)
        found.append(Parameter(product_text(powers), value, std, unit))
    for name, function in model.combinations.items():
        if (name in said.combinations or said.complete) and name not in {p.name for p in found}:
            gradient = combination_gradient(model, name, z)
            std = float(np.linalg.norm(gradient @ logs))
            found.append(Parameter(name, float(function(model.at(z))), std))
    return tuple(found)


def _other_notes(
    model: PhysicalModel,
    closest: Nearest,
    best: PhysicalMaximum | None,
    fit: Fit,
    values: Array,
    cov: Array,
    loss: str,
) -> list[str]:
    found = []
    for other in closest.others:
        listed = ", ".join(f"{n}={v:.5g}" for n, v in model.at(other).items())
        found.append(f"{AS_WELL}: {listed}")
    std = np.sqrt(np.maximum(np.diag(cov), 0.0))
    weak = [n for n, v, s in zip(model.names, values, std, strict=True) if s > WEAK * abs(v) > 0]
    if weak:
        found.append(f"{', '.join(weak)}: standard error above the value; hardly determined")
    if fit == "likelihood" and loss != "squared":
        return [*found, f"the loss is {loss}: parameters of least distance are given"]
    if fit == "likelihood" and (best is None or not best.converged):
        what = "no finite response at the parameters of least distance, which are given"
        found.append(what if best is None else "the weights of the outputs did not settle")
    return found
