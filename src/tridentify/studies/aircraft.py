"""The paper's aircraft, over many noise draws.

The plant is the short-period motion of an aircraft,

    y'' + a1 y' + a0 y = b0 x,        a1 = 1 / s, a0 = 3 / s^2, b0 = 0.5 / s^2   (the paper's b),

at rest, driven by a unit step at the first sample. The noise is white and Gaussian, with a
standard deviation of `ratio` times the root mean square of ``y*`` over the record. Every noisy
record goes through three estimators:

- *Step 2 alone*: the series-parallel model on the recorded output (`studies.step_2_alone`), with
  the paper's filter ``c = p^3 + 5 p^2 + 6 p + 7``;
- *Steps 1-4*: ``ThreeModel.paper`` with three operators of eq. (4) and the same filter;
- *ThreeModel()*: the strategy with the changes that make it efficient.

All of them know that the record starts at rest and has no offset. What the paper leaves open:

*gamma* is not printed. Here it is the geometric mean of the corner frequencies of the printed
filter, ``7^(1/3) = 1.91 rad/s``: a value of the order of the filter's bandwidth that uses neither
the true coefficients nor the results. It hardly matters: at noise ratio 1, with 200 draws of seed
0, gamma between 1 and 4 rad/s gave medians of a1 from 0.78 to 0.80 on the short records and from
0.69 to 0.85 on the long ones, all with about the same spread. `AircraftStudy` takes another one.

*The noise-to-signal ratio* is not defined; see above for the reading that is used.

*The record*: 5 s at 0.02 s are 250 samples, not 100. Here it is 100 samples at 0.05 s, and, where
the averages are to be seen behind the noise, 1000 samples over 50 s.

Each noise draw has a random generator of its own, spawned from the seed by its place (record,
ratio, draw): the result depends neither on the number of processes nor on how draws are dealt out,
and the first draws of a long study are those of a short one.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass

import numpy as np

from tridentify.errors import OptionError, TridentifyError
from tridentify.estimation.answer.trace import Status
from tridentify.estimation.methods.base import Method
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.identify import search
from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.studies.aircraft_result import (
    COEFFICIENTS,
    ESTIMATORS,
    FAILED,
    FLAGGED,
    AircraftResult,
    Condition,
    Event,
)
from tridentify.studies.base import Count
from tridentify.studies.cramer_rao import information_factor, output_sensitivities
from tridentify.studies.processes import run_batches
from tridentify.studies.step_2_alone import step_2_alone
from tridentify.transfer_function import TransferFunction

PLANT = TransferFunction([0.5], [1.0, 1.0, 3.0], input_names=["x"], output_names=["y"])
STRUCTURE = Structure(2, 0, offset=False, initial_state="rest")
FILTER = (1.0, 5.0, 6.0, 7.0)
"""Of the paper's Step 2 alone: ``c(p)``, descending powers."""
BATCH = 5
"""Noise draws that a process takes at a time: short enough for progress and for Ctrl-C."""


@dataclass(frozen=True)
class _Batch:
    """Draws ``first .. last - 1`` at one ratio and record length."""

    study: AircraftStudy
    seed: int
    length: int
    level: int
    first: int
    last: int


@dataclass(frozen=True)
class _AircraftOutcome:
    """Coefficients (n_estimators, n_draws, 3), ``nan`` where an estimator failed, and events."""

    theta: Array
    events: tuple[Event, ...]


@dataclass(frozen=True)
class AircraftStudy:
    """The paper's study of noise levels, as distributions over noise draws.

    Parameters
    ----------
    ratios : tuple of float
        Noise standard deviation over the root mean square of the noise-free output.
    lengths : tuple of (int, float)
        Records: number of samples, and step [s].
    gamma : float
        Of the paper's operators [rad/s].
    passes : int
        Most repetitions of the paper's Steps 2 to 4.

    Examples
    --------
    >>> AircraftStudy().name
    'aircraft'
    """

    ratios: tuple[float, ...] = (0.0, 0.5, 1.0, 2.0, 3.0)
    lengths: tuple[tuple[int, float], ...] = ((100, 0.05), (1000, 0.05))
    gamma: float = 7.0 ** (1.0 / 3.0)
    passes: int = 20

    @property
    def name(self) -> str:
        """``"aircraft"``."""
        return "aircraft"

    @property
    def description(self) -> str:
        """What it shows."""
        return "the paper's aircraft at five noise levels, next to the Cramer-Rao bound"

    def run(
        self,
        *,
        draws: int = 200,
        seed: int = 0,
        workers: int | None = None,
        progress: Count | None = None,
    ) -> AircraftResult:
        """Estimate the coefficients from every noisy record.

        Parameters
        ----------
        draws : int
            Noise draws at each ratio and record length; without noise there is one record.
        seed : int
            Of all draws, 0 or more.
        workers : int, optional
            Processes; by default as many as there are processors.
        progress : callable, optional
            Called with the number of records that are done and the number of all records.

        Returns
        -------
        AircraftResult

        Raises
        ------
        OptionError
            For numbers that make no sense.
        TridentifyError
            A process died.

        Notes
        -----
        The processes are spawned: a script calls this below ``if __name__ == "__main__":``.
        """
        processes = (os.cpu_count() or 1) if workers is None else workers
        for what, value, lowest in (
            ("draws", draws, 1),
            ("seed", seed, 0),
            ("workers", processes, 1),
        ):
            if value < lowest:
                raise OptionError(f"found {what}={value}; expected at least {lowest}; raise it")
        counts = [draws if ratio else 1 for ratio in self.ratios]
        batches = [
            _Batch(self, seed, length, level, first, min(first + BATCH, count))
            for length in range(len(self.lengths))
            for level, count in enumerate(counts)
            for first in range(0, count, BATCH)
        ]
        sizes = [batch.last - batch.first for batch in batches]
        done, total = 0, sum(sizes)

        def finished(number: int) -> None:
            nonlocal done
            done += sizes[number]
            if progress is not None:
                progress(done, total)

        if progress is not None:
            progress(0, total)
        outcomes = run_batches(_estimate, batches, workers=processes, finished=finished)
        return self._result(draws, seed, batches, outcomes)

    def _result(
        self, draws: int, seed: int, batches: list[_Batch], outcomes: list[_AircraftOutcome]
    ) -> AircraftResult:
        conditions = []
        for length, (n_samples, dt) in enumerate(self.lengths):
            clean = noise_free_record(n_samples, dt)
            factor = information_factor(output_sensitivities(PLANT, clean.u[:, 0], dt))
            rms = root_mean_square(clean)
            for level, ratio in enumerate(self.ratios):
                parts = [
                    outcome
                    for batch, outcome in zip(batches, outcomes, strict=True)
                    if (batch.length, batch.level) == (length, level)
                ]
                theta = np.concatenate([part.theta for part in parts], axis=1)
                events = tuple(event for part in parts for event in part.events)
                example = self.record(seed, length, level, draw=0)
                conditions.append(Condition(example, ratio, ratio * rms, factor, theta, events))
        return AircraftResult(seed, draws, self.gamma, self.passes, tuple(conditions))

    def record(self, seed: int, length: int, level: int, draw: int) -> Record:
        """One of the noisy records of the study.

        Parameters
        ----------
        seed : int
        length, level : int
            Places in ``lengths`` and ``ratios``.
        draw : int
            Number of the noise draw, from 0.

        Returns
        -------
        Record

        Examples
        --------
        >>> AircraftStudy().record(0, length=1, level=2, draw=0).n_samples
        1000
        """
        clean = noise_free_record(*self.lengths[length])
        own = np.random.SeedSequence(seed, spawn_key=(length, level, draw))
        noise = np.random.default_rng(own).standard_normal(clean.y.shape)
        y = clean.y + self.ratios[level] * root_mean_square(clean) * noise
        return _record(clean.u, y, self.lengths[length][1])


def noise_free_record(n_samples: int, dt: float) -> Record:
    """The plant's response to a unit step.

    Parameters
    ----------
    n_samples : int
    dt : float
        Step [s].

    Returns
    -------
    Record

    Examples
    --------
    >>> noise_free_record(1000, 0.05).y[-1].round(6)
    array([0.166667])
    """
    x = np.ones(n_samples)
    return _record(x, simulate(PLANT, _record(x, x, dt)), dt)


def _record(x: Array, y: Array, dt: float) -> Record:
    return Record(x, y, dt=dt, input_names=PLANT.input_names, output_names=PLANT.output_names)


def root_mean_square(record: Record) -> float:
    """Root mean square of a record's output, to which the noise is scaled."""
    return float(np.sqrt(np.mean(record.y**2)))


def _estimate(batch: _Batch) -> _AircraftOutcome:
    """All estimators on all records of a batch."""
    numbers = range(batch.first, batch.last)
    theta = np.full((len(ESTIMATORS), len(numbers), len(COEFFICIENTS)), np.nan)
    events = []
    for k, draw in enumerate(numbers):
        record = batch.study.record(batch.seed, batch.length, batch.level, draw)
        for j in range(len(ESTIMATORS)):
            # overflow in a failing estimate is counted as a failure, not printed by a process
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")
                theta[j, k], event = _attempt(batch.study, j, record, draw)
            if event is not None:
                events.append(event)
    return _AircraftOutcome(theta, tuple(events))


def _attempt(
    study: AircraftStudy, estimator: int, record: Record, draw: int
) -> tuple[Array, Event | None]:
    """Coefficients, or ``nan`` with the reason."""
    nothing = np.full(len(COEFFICIENTS), np.nan)
    try:
        theta, status = _apply(study, estimator, record)
    except (TridentifyError, ArithmeticError, ValueError) as error:
        reason = f"{type(error).__name__}: {error}"
        return nothing, Event(ESTIMATORS[estimator], draw, FAILED, reason)
    if not np.all(np.isfinite(theta)):
        return nothing, Event(ESTIMATORS[estimator], draw, FAILED, "coefficients are not finite")
    if status is not None and status is not Status.CONVERGED:
        return theta, Event(ESTIMATORS[estimator], draw, FLAGGED, status.value)
    return theta, None


def _apply(study: AircraftStudy, estimator: int, record: Record) -> tuple[Array, Status | None]:
    if estimator == 0:
        return step_2_alone(record, 2, 0, FILTER), None
    method: Method = ThreeModel()
    if estimator == 1:
        method = ThreeModel.paper(study.gamma, 3, FILTER, study.passes)
    estimate = search(record, STRUCTURE, method).estimate
    return estimate.theta, estimate.status
