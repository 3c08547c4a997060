"""An `Estimate` from coefficients that were found sample by sample."""

from __future__ import annotations

from typing import cast

import numpy as np

from tridentify.estimation.answer.estimate import Estimate, Nuisance, Status, Trace
from tridentify.numerics.arrays import Array
from tridentify.online.kernels import slots
from tridentify.online.layout import Blueprint, Setting, watch_of
from tridentify.structure import InitialState, Structure
from tridentify.transfer_function import TransferFunction


def assembled(
    setting: Setting,
    blueprint: Blueprint,
    x: Array,
    theta: Array,
    cov: Array,
    noise_variance: Array,
    status: Status,
    trace: Trace,
    method: str,
    condition: float | None = None,
) -> Estimate:
    """The estimate of a method that has no output error of its own.

    Parameters
    ----------
    setting : Setting
    blueprint : Blueprint
    x : array
    theta, cov : (n,) and (n, n) arrays
    noise_variance : (n_outputs,) array
        Of the error that the method lowers.
    status : Status
    trace : Trace
    method : str
    condition : float, optional
    """
    p, m = setting.n_outputs, setting.n_inputs
    power = np.zeros(p)
    for i in range(p):
        w = watch_of(blueprint, i)
        power[i] = x[w + slots.SPREAD] / max(float(x[w + slots.WEIGHT]), 1.0)
    ratio = noise_variance / np.where(power > 0, power, np.inf)
    free = blueprint.nuisance.free
    n = setting.n_poles
    at = int(blueprint.ints[slots.AT_REFERENCE])
    unknown = np.full(p, np.nan)
    nuisance = Nuisance(
        input_reference=x[at : at + m],
        offset=unknown if blueprint.nuisance.offset else np.zeros(p),
        drift=np.zeros(p),
        free_response=np.full((p, n), np.nan) if free else np.zeros((p, n)),
        offset_std=unknown if blueprint.nuisance.offset else np.zeros(p),
        drift_std=np.zeros(p),
        initial_state="free" if free else setting.structure.initial_state,
    )
    structure = setting.structure
    taken = sum(x[watch_of(blueprint, i) + slots.WEIGHT] for i in range(p))
    return Estimate(
        model=model_of(setting, theta),
        structure=Structure(
            structure.poles,
            structure.zeros,
            delay=structure.delay,
            offset=blueprint.nuisance.offset,
            drift=False,
            initial_state=cast("InitialState", nuisance.initial_state),
        ),
        theta=theta,
        names=setting.names,
        cov=0.5 * (cov + cov.T),
        noise_variance=noise_variance,
        fit=100.0 * (1.0 - np.sqrt(ratio)),
        status=status,
        trace=trace,
        method=method,
        n_samples=int(x[slots.COUNT]),
        nuisance=(nuisance,),
        degrees_of_freedom=max(round(float(taken)) - blueprint.n_columns, 1),
        cost=float(np.mean(noise_variance)),
        aicc=np.nan,
        condition=np.nan if condition is None else condition,
        gradient=np.nan,
        input_names=setting.input_names,
        output_names=setting.output_names,
        units=dict(setting.units),
        intersample=setting.intersample,
        dt=setting.dt,
    )


def model_of(setting: Setting, theta: Array) -> TransferFunction:
    """The transfer function of a coefficient vector."""
    n, at = setting.n_poles, setting.n_poles
    den = np.concatenate([[1.0], theta[:n]])
    num = []
    for row in setting.zeros:
        own = []
        for m in row:
            own.append(theta[at : at + m + 1])
            at += m + 1
        num.append(own)
    delays = np.tile(setting.delays, (setting.n_outputs, 1))
    return TransferFunction(
        num,
        [[den] * setting.n_inputs for _ in range(setting.n_outputs)],
        delay=delays if np.any(delays) else 0.0,
        input_names=setting.input_names,
        output_names=setting.output_names,
    )
