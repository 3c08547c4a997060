"""What an estimation gives back: the model, its uncertainty, and how it was reached.

An `Estimate` is a value: it holds arrays, not the data. Its covariance is that of ``theta``, the
physical coefficients in the order of ``names``. What derives from them (natural frequency, damping,
gain, confidence bands) is propagated to first order, see `tridentify.numerics.delta_method`.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tridentify.errors import DataError, OptionError
from tridentify.estimation.answer.encoding import (
    check_covariance,
    check_draws,
    check_model,
    check_noise,
    check_nuisance,
    check_outliers,
    check_sampling,
    decode,
    load_document,
    save_document,
)
from tridentify.estimation.answer.in_words import EstimateInWords
from tridentify.estimation.answer.parameter import Nuisance, Parameter
from tridentify.estimation.answer.trace import Pass, Start, Status, Step, Trace
from tridentify.numerics.arrays import Array
from tridentify.record.checks.samples import checked_units
from tridentify.record.record import Record, in_memory
from tridentify.writing.layout import format_value
from tridentify.writing.views import EstimateViews

__all__ = ["Estimate", "Nuisance", "Parameter", "Pass", "Start", "Status", "Step", "Trace"]

_FOR_OTHER_ROOMS = frozenset(
    (
        "call",
        "decisions",
        "channel_draws",
        "derived_rows",
        "derived_values",
        "from_document",
        "held_note",
        "model_text",
        "noise_note",
        "nuisance_rows",
        "offset_note",
        "route_note",
    )
)
"""What tables, pages and files are made of: not offered to those who look an estimate over."""
SCHEMA = 2
"""Version of the file format: raised when a field is added, dropped or changes its meaning."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Estimate(EstimateInWords, EstimateViews):
    """An identified model with covariance, diagnostics and the trace of its estimation.

    Attributes
    ----------
    theta : ndarray, shape (n_parameters,)
        Coefficients in the order of ``names``; ``cov`` (n_parameters, n_parameters) is theirs.
    noise_variance, fit : ndarray, shape (n_outputs,)
        Variance of the residual [output units squared]; normalised fit (NRMSE) [percent].
    nuisance : tuple of Nuisance
        One per experiment.
    cost, gradient, condition : float
        Weighted mean-square output error, its relative gradient at the end, and the condition
        number of the scaled score columns; of the whitened output error where the noise has a
        model.
    noise_model : tuple of ndarray, one (p,) per output
        Autoregressive coefficients: ``v(k) + a_1 v(k-1) + ... + a_p v(k-p)`` is white. Empty for
        white noise.
    noise_levels : tuple of ndarray, one (n_outputs,) per experiment
        Standard deviation of the noise of each experiment [output units] where they differ, and
        its samples counted by it; empty where one level was taken for all.
    draws : ndarray, shape (n_draws, n_parameters)
        Equally likely coefficients where the estimate is a posterior mean (``status``), else empty.
    loss : str
        What was minimised: ``"squared"``, or a robust loss, ``"huber"`` or ``"student"``. With one
        of these ``noise_variance`` is the square of the noise's robust scale, and ``fit`` leaves
        the outliers out.
    outliers : ndarray, shape (n_outliers, 4)
        Samples beyond four standard deviations of the noise under a robust loss: position of the
        experiment, of the output and of the sample, and the weight that it had (at most 1).
    findings : tuple of Finding
        What a reader should know before using the numbers, what matters most first.
    errors : {"likelihood", "scores"}
        What the covariance comes from: the curvature of the likelihood, or the scatter of the
        scores over blocks where that is clearly larger (`likelihood.scores`).
    route : {"open-loop", "reference", "direct"}
        What was made of a controller that may have been running: nothing; the parts of input and
        output that follow the reference were fitted; or the noise got a model in any case.
    loop : LoopTaken or None
        What the reference route took the loop for, or how a plant that is not stable was
        estimated; else None.
    call : str
        The method with its options, as one writes it; empty if it was not called by `identify`.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, TransferFunction, identify, simulate
    >>> u = np.sign(np.sin(np.arange(200) ** 1.5))
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.02))
    >>> estimate = identify(Record(u, y, dt=0.02), Structure(poles=1, zeros=0))
    >>> estimate.names, estimate.theta.round(6).tolist(), estimate.status.value
    (('a0', 'b0'), [4.0, 2.0], 'converged')
    """

    def __dir__(self) -> list[str]:
        return sorted(set(super().__dir__()) - _FOR_OTHER_ROOMS)

    def __repr__(self) -> str:
        rows = self.parameters.values()
        values = ", ".join(f"{p.name}={format_value(p.value, p.told_to)}" for p in rows)
        return f"Estimate({self.method}: {self.status.value}; {values})"

    def predict(self, record: Record, *, experiment: int = 0) -> Array:
        """Fitted output: G (u - reference) + offset + drift (t - t0) + free response.

        Offset, drift and initial state are held as they were estimated. Those of another record are
        others: `tridentify.compare` fits them to it.

        Parameters
        ----------
        record : Record
            The identified record, or another one with the same channels.
        experiment : int
            Whose offset, drift and initial state are taken.

        Returns
        -------
        ndarray, shape (n_samples, n_outputs)
            [output units]; ``nan`` before the last delayed input has arrived, where the initial
            state is free: what came before the record is not known.
        """
        from tridentify.models.simulate import simulate

        record = in_memory(record)
        found = (record.n_inputs, record.n_outputs)
        expected = (len(self.input_names), len(self.output_names))
        if found != expected:
            raise DataError(
                f"found a record with {found[0]} inputs and {found[1]} outputs; expected "
                f"{expected[0]} and {expected[1]} as identified; select its channels first"
            )
        if not (isinstance(experiment, (int, np.integer)) and 0 <= experiment < len(self.nuisance)):
            raise OptionError(
                f"found experiment={experiment!r}; expected the number of one that was identified, "
                f"0 to {len(self.nuisance) - 1}; leave it out for the first"
            )
        record = record.settled(self.intersample)
        terms = self.nuisance[experiment]
        moved = np.any(terms.input_reference)
        shifted = record._on_its_times(record.u - terms.input_reference if moved else record.u)
        free = terms.free_response if np.any(terms.free_response) else None
        response = simulate(self.model, shifted, free_response=free, free_after=terms.free_after)
        if terms.free_after:
            response[record.t - record.t[0] < (1.0 - 1e-9) * terms.free_after] = np.nan
        return np.asarray(response + terms.constants(record.t))

    def residual(self, record: Record, *, experiment: int = 0) -> Array:
        """Recorded minus fitted output, shape (n_samples, n_outputs); nan where not recorded."""
        residual: Array = in_memory(record).y - self.predict(record, experiment=experiment)
        return residual

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the estimate as JSON: to a temporary name first, then renamed.

        Raises
        ------
        OutputPathError
            The file cannot be written.
        """
        return save_document(path, "schema", SCHEMA, self)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Estimate:
        """Read what `save` wrote.

        Raises
        ------
        UnreadableFileError
            There is no such file, or it is not JSON, or too large (128 MiB, four million values).
        DataError
            It is of another schema version, or damaged: a field is missing, unknown, not of its
            type, or does not go with the others.
        """
        return load_document(path, "schema", SCHEMA, cls.from_document, "estimate", "Estimate")

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> Estimate:
        """Build an estimate from what JSON holds of it, and refuse what does not belong together.

        Parameters
        ----------
        document : mapping
            The content of a file of `save`, without its schema.

        Returns
        -------
        Estimate

        Raises
        ------
        DataError, StructureError, ValueError
            A field is missing, unknown, not of its type, or does not go with the others.
        """
        made: Estimate = decode(cls, document)
        inputs, outputs = made.input_names, made.output_names
        checked_units(made.units, (*inputs, *outputs))
        check_model(made.model, made.structure, made.theta, inputs, outputs)
        check_covariance(made.cov)
        check_draws(made.draws, len(made.names))
        check_noise(made.noise_variance, made.fit, made.noise_model)
        check_nuisance(made.nuisance, made.model)
        check_outliers(made.outliers, len(made.nuisance), len(outputs), made.n_samples)
        check_sampling(
            made.n_samples, made.degrees_of_freedom, made.dt, made.intersample, made.loss
        )
        return made
