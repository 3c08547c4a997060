"""Where the power of an input belongs, for the coefficients that matter.

In the steady state the information per sample is a sum over the lines of the input's spectrum, each
in proportion to its power (`tridentify.excitation.frequency`), so the best spectrum within a limit
of power is the solution of a convex problem, and can be certified (`tridentify.excitation.design`).
Few lines are needed, mostly as many as there are poles. Offsets, drifts and initial states lie at
other frequencies or die out, and do not matter here; what they cost on a record of finite length
is said by `precision`.

What an actuator limits is the amplitude, not the power. The spectrum is therefore turned into a
signal of the given amplitude in one of two ways: a multisine of low crest factor, which has exactly
these lines, or its sign (Van den Bos & Krol 1979), which has crest factor one and keeps about four
fifths of its power in them. `Spectrum.compare` works out what each gives, beside the usual inputs
of the same amplitude; the best spectrum for a limit of power need not win among signals under a
limit of amplitude.

References: R. K. Mehra, IEEE Trans. Automatic Control 19 (1974) 753-768. G. C. Goodwin & R. L.
Payne, *Dynamic System Identification*, Academic Press 1977, chapter 6. R. Pintelon & J. Schoukens,
*System Identification: A Frequency Domain Approach*, 2nd ed., Wiley 2012, chapter 5. V. Klein & E.
A. Morelli, *Aircraft System Identification*, AIAA 2006, chapter 9. A. van den Bos & R. G. Krol,
International Journal of Control 30 (1979) 969-984.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from tridentify.errors import OptionError, ParameterNameError, TridentifyError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.trace import freeze_arrays
from tridentify.estimation.knowledge.affine import known_of
from tridentify.excitation.checks import count, positive, samples_of, vector
from tridentify.excitation.design import Criterion, SpectralLines, best_powers
from tridentify.excitation.frequency import candidates, response_gradient
from tridentify.excitation.information import coefficients_of, model_from
from tridentify.excitation.multisine import multisine
from tridentify.excitation.precise import asked, noise_of, precision
from tridentify.excitation.precision_result import Precision
from tridentify.excitation.signal import Excitation
from tridentify.excitation.usual import usual_inputs
from tridentify.numerics.arrays import Array
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction
from tridentify.uncertainty.sampled import sample
from tridentify.writing.layout import format_table, html_table

Shape = Literal["multisine", "binary"]

SHOWN = 1e-2
"""Share of an input's power from which a line is worth a row of the table."""
LINES_KEPT = 2e-3
"""Share of a candidate that belongs to a line: what the iteration leaves between lines is
smaller."""
PER_PERIOD = 20.0
"""Samples in the period of the fastest line: held steps then are a delay of a fortieth of it."""
PERIODS = 10.0
"""Of the slowest line in a record: its power does not leak into the neighbours."""


@dataclass(frozen=True, eq=False, repr=False)
class Spectrum:
    """The best distribution of an input's power over frequencies.

    Attributes
    ----------
    omega : (n_omega,) array
        Candidate lines [rad/s].
    power : (n_omega, n_inputs) array
        Mean squares in each line [input units squared]; each column adds up to ``limit**2``.
    slopes : (n_omega, n_inputs) array
        The certificate: at most one for an optimal spectrum, one where there is power.
    efficiency : float
        What is reached for certain of the best criterion, as a ratio of errors: of variances for
        "A", of the geometric mean of variances for "D".
    criterion : {"A", "D"}
    coefficients : tuple of str
        Those of interest.
    limit : (n_inputs,) array
    relative_per_sample : (s,) array
        Relative standard errors of these coefficients for one sample, were the root mean square
        at the limit: over ``sqrt(n_samples)``, times the crest factor, for a long record.
    model : TransferFunction
    structure : Structure
    noise_std : (n_outputs,) array
    n_models : int
        Models over which the criterion is averaged.
    """

    omega: Array
    power: Array
    slopes: Array
    efficiency: float
    criterion: Criterion
    coefficients: tuple[str, ...]
    limit: Array
    relative_per_sample: Array
    model: TransferFunction
    structure: Structure
    noise_std: Array
    n_models: int

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def support(self) -> tuple[tuple[float, int, float], ...]:
        """Lines that matter: angular frequency [rad/s], input, share of that input's power.

        Neighbours on the grid of candidates are taken together.
        """
        found: list[tuple[float, int, float]] = []
        for j in range(self.power.shape[1]):
            share = self.power[:, j] / self.power[:, j].sum()
            kept = np.flatnonzero(share > LINES_KEPT)
            for run in np.split(kept, np.flatnonzero(np.diff(kept) > 1) + 1):
                total = float(share[run].sum())
                if total > SHOWN:
                    found.append((float(share[run] @ self.omega[run] / total), j, total))
        return tuple(found)

    def excitation(
        self,
        duration: float | None = None,
        dt: float | None = None,
        *,
        shape: Shape = "multisine",
        periods: int = 1,
        seed: int = 0,
    ) -> Excitation:
        """A signal of this spectrum at the limit of amplitude.

        Parameters
        ----------
        duration : float, optional
            Of one period [s], rounded to whole samples: the lines are multiples of ``2 pi /
            duration``. By default ten periods of the slowest line.
        dt : float, optional
            Sampling interval [s]; by default a twentieth of the fastest line's period.
        shape : {"multisine", "binary"}
            A sum of sines of low crest factor, or its sign.
        periods : int
        seed : int
            Of the search for phases.

        Returns
        -------
        Excitation

        Raises
        ------
        OptionError
            The fastest line lies beyond half the sampling rate, or the duration holds no period of
            any line.
        """
        if shape not in ("multisine", "binary"):
            raise OptionError.found("shape=", shape, "'multisine' or 'binary'", "choose one")
        duration, dt = self._sampling(duration, dt)
        n = samples_of("duration", duration, dt)
        harmonics, powers = self._harmonics(n, 2.0 * np.pi / (n * dt))
        plan = multisine(
            n * dt,
            dt=dt,
            harmonics=harmonics,
            power=powers,
            amplitude=self.limit,
            periods=periods,
            seed=seed,
        )
        u = np.where(plan.u < 0, -self.limit, self.limit) if shape == "binary" else plan.u
        sort = "multisine" if shape == "multisine" else "binary signal"
        names = self.model.input_names
        what = f"optimal {sort} ({self.criterion}) for {', '.join(self.coefficients)}"
        return Excitation(u, dt, "zoh", what, n, names)

    def _sampling(self, duration: float | None, dt: float | None) -> tuple[float, float]:
        lines = [omega for omega, _, _ in self.support]
        if duration is None:
            duration = PERIODS * 2.0 * np.pi / min(lines)
        if dt is None:
            dt = 2.0 * np.pi / (PER_PERIOD * max(lines))
        return positive("duration", duration), positive("dt", dt)

    def _harmonics(self, n: int, base: float) -> tuple[list[list[int]], list[list[float]]]:
        """Every line that matters on the nearest free multiple of the base frequency.

        On two multiples each, with the mean in the right place, it would beat: a crest factor
        larger by ``sqrt(2)``.
        """
        taken: set[int] = set()
        harmonics, powers = [], []
        for j in range(self.power.shape[1]):
            own: dict[int, float] = {}
            for omega, source, share in self.support:
                if source == j:
                    k = _free(max(round(omega / base), 1), taken)
                    own[k] = own.get(k, 0.0) + share
            if 2 * max(own) >= n:
                raise OptionError(
                    f"found a line at {max(own) * base:.4g} rad/s and {n} samples a period; "
                    "expected a sampling rate above twice the fastest line; sample faster"
                )
            taken |= own.keys()
            harmonics.append(sorted(own))
            powers.append([own[k] for k in sorted(own)])
        return harmonics, powers

    def compare(
        self, duration: float | None = None, dt: float | None = None
    ) -> tuple[tuple[Excitation, Precision], ...]:
        """The precision of this spectrum's signals beside usual ones of amplitude and length alike.

        Parameters
        ----------
        duration, dt : float, optional
            As for `excitation`.

        Returns
        -------
        tuple of (Excitation, Precision)
            Optimal multisine, its sign, a PRBS, a multisine with equal power in the band of the
            candidates, a 3-2-1-1 and a doublet for the mean natural frequency; those that cannot be
            made at this length, or do not determine the coefficients, are left out.
        """
        duration, dt = self._sampling(duration, dt)
        fastest = max(omega for omega, _, _ in self.support)
        band = (float(self.omega[0]), float(self.omega[-1]))
        plans = [self.excitation(duration, dt), self.excitation(duration, dt, shape="binary")]
        plans += usual_inputs(self.model, self.limit, fastest, band, duration, dt)
        found = []
        for plan in plans:
            try:
                ahead = precision(self.model, plan, self.structure, noise_std=self.noise_std)
            except TridentifyError:
                continue
            found.append((plan, ahead))
        return tuple(found)

    def _lines(self) -> list[tuple[str, ...]]:
        names = self.model.input_names
        return [
            (names[j], f"{omega:.4g}", f"{100 * share:.1f} %", "")
            for omega, j, share in self.support
        ]

    def summary(self, duration: float | None = None, dt: float | None = None) -> str:
        """Text: the lines, the certificate, and the precision beside that of usual inputs.

        Parameters
        ----------
        duration, dt : float, optional
            Of the signals that are compared, as for `excitation`.
        """
        duration, dt = self._sampling(duration, dt)
        n_models = f", averaged over {self.n_models} models" if self.n_models > 1 else ""
        lines = [
            f"Optimal spectrum ({self.criterion}) for {', '.join(self.coefficients)}{n_models}",
            f"certified: at least {100 * self.efficiency:.2f} % of the best for its power; largest "
            f"slope {self.slopes.max():.4f} (1 where optimal)",
            "",
            *format_table(("input", "rad/s", "power", ""), self._lines()),
            "",
            f"Relative standard errors at the same amplitude, {duration:.4g} s at {dt:.4g} s:",
            "",
            *format_table(("signal", *self.coefficients, "crest"), self._table(duration, dt)),
        ]
        return "\n".join(lines)

    def _table(self, duration: float, dt: float) -> list[tuple[str, ...]]:
        rows = []
        for plan, ahead in self.compare(duration, dt):
            places = [ahead.names.index(name) for name in self.coefficients]
            errors = [f"{100 * ahead.relative[k]:.3g} %" for k in places]
            what = plan.what.split(" for ")[0]
            rows.append((what, *errors, f"{plan.crest_factor.max():.2f}"))
        return rows

    def _repr_html_(self) -> str:
        caption = f"Optimal spectrum ({self.criterion}) for {', '.join(self.coefficients)}"
        return html_table(("input", "rad/s", "power"), [row[:-1] for row in self._lines()], caption)

    def __repr__(self) -> str:
        lines = ", ".join(f"{omega:.4g} rad/s: {100 * s:.0f} %" for omega, _, s in self.support)
        return f"Spectrum({self.criterion} for {', '.join(self.coefficients)}; {lines})"


def optimal_spectrum(
    model: TransferFunction | Estimate,
    structure: Structure | None = None,
    coefficients: Sequence[str] | None = None,
    *,
    band: tuple[float, float] | None = None,
    lines: ArrayLike | None = None,
    limit: ArrayLike = 1.0,
    noise_std: ArrayLike | None = None,
    criterion: Criterion = "A",
    n_models: int = 20,
    seed: int = 0,
) -> Spectrum:
    """Find the spectrum whose power tells the coefficients of interest best.

    Parameters
    ----------
    model : TransferFunction or Estimate
        What is known of the plant. Of an `Estimate` the criterion is averaged over draws of its
        coefficients, so that the spectrum is right for all the plants that it may be.
    structure : Structure, optional
        What will be asked; by default that of the estimate, or the orders of the model. Nuisance
        terms and priors play no part.
    coefficients : sequence of str, optional
        Those of interest, all that are free by default. The others are estimated along.
    band : (float, float), optional
        Lowest and highest candidate [rad/s]; by default from a tenth of the slowest to ten times
        the fastest corner of the model.
    lines : (n_omega,) array_like, optional
        The candidates themselves [rad/s], rising, in place of `band`.
    limit : float or (n_inputs,) array_like
        Of the amplitude of each input.
    noise_std : float or (n_outputs,) array_like, optional
        Standard deviation of white noise; by default that of the estimate. With one output it has
        no influence on the spectrum and may be left out.
    criterion : {"A", "D"}
        "A": the sum of the squares of the relative errors; "D": the volume of the confidence
        ellipsoid.
    n_models : int
        Draws of an estimate, unstable ones left out; 1 for the estimate alone.
    seed : int
        Of the draws.

    Returns
    -------
    Spectrum

    Raises
    ------
    ParameterNameError
        There is no such coefficient, or it is known.
    OptionError
        A criterion that is not offered; a limit or lines that are not positive; a relative error of
        a coefficient that is zero.
    UndeterminedError
        The candidates do not determine the coefficients.

    Examples
    --------
    One pole: the line lies near the corner frequency.

    >>> from tridentify import TransferFunction
    >>> best = optimal_spectrum(TransferFunction([2.0], [1.0, 2.0]), criterion="D")
    >>> [(round(omega, 1), round(share, 2)) for omega, _, share in best.support]
    [(1.2, 1.0)]
    """
    like = model.model if isinstance(model, Estimate) else model
    structure = asked(model, like, structure)
    if criterion not in ("A", "D"):
        raise OptionError(f"found criterion={shown(criterion)}; expected 'A' or 'D'; choose one")
    theta = coefficients_of(like, structure)
    names = structure.names(like.input_names, like.output_names)
    directions = _directions(structure, like, theta)
    wanted = _wanted(coefficients, names, theta, directions)
    omega = candidates(like, band, lines)
    limits = vector("limit", limit)
    if limits.size not in (1, like.n_inputs) or np.any(limits <= 0):
        raise OptionError.found(
            "limit=", limit, f"a positive number, or one for each of {like.n_inputs} inputs"
        )
    limits = np.broadcast_to(limits, (like.n_inputs,)).astype(np.float64)
    if noise_std is None and not isinstance(model, Estimate) and like.n_outputs == 1:
        noise_std = 1.0
    noise = noise_of(model, noise_std, [], like.n_outputs)[0]
    models = _models(model, structure, like, theta, count("n_models", n_models), seed)
    points = _points(models, structure, like, omega, limits, noise, wanted)
    design = best_powers(points, criterion)
    shape = (omega.size, limits.size)
    outer = points.wanted @ points.factor(design.power)
    return Spectrum(
        omega,
        design.power.reshape(shape) * limits**2,
        design.slopes.reshape(shape),
        design.efficiency,
        criterion,
        tuple(names[k] for k in wanted),
        limits,
        np.sqrt(np.mean(np.sum(outer**2, axis=2), axis=0)),
        like,
        structure,
        noise,
        len(models),
    )


def _directions(structure: Structure, like: TransferFunction, theta: Array) -> Array:
    """(p, k) free directions of the relative coefficients."""
    sizes = np.where(theta != 0, np.abs(theta), 1.0)
    if not structure.constrained:
        return np.eye(theta.size)
    known = known_of(structure, like.input_names, like.output_names, sizes)
    return np.asarray(known.directions / sizes[:, None])


def _wanted(
    coefficients: Sequence[str] | None, names: tuple[str, ...], theta: Array, directions: Array
) -> list[int]:
    free = [k for k in range(theta.size) if np.any(directions[k])]
    if coefficients is None:
        found = [k for k in free if theta[k] != 0]
    else:
        given = [coefficients] if isinstance(coefficients, str) else list(coefficients)
        bad = [name for name in given if name not in names or names.index(name) not in free]
        if bad or not given:
            offered = ", ".join(names[k] for k in free)
            raise ParameterNameError(
                f"found the coefficients {shown(given)}; expected some of {offered}; correct them"
            )
        found = [names.index(name) for name in dict.fromkeys(given)]
    for k in found:
        if theta[k] == 0:
            raise OptionError(
                f"found {names[k]} = 0 among the coefficients of interest; expected values other "
                "than zero, since errors are taken relative to them; leave it out"
            )
    return found


def _models(
    model: TransferFunction | Estimate,
    structure: Structure,
    like: TransferFunction,
    theta: Array,
    n_models: int,
    seed: int,
) -> list[Array]:
    """Coefficients for which the spectrum is to be good."""
    if not isinstance(model, Estimate) or n_models == 1 or not np.all(np.isfinite(model.cov)):
        return [theta]
    if model.names != structure.names(like.input_names, like.output_names):
        return [theta]
    draws = sample(model, n_models, seed).theta
    return [one for one in draws if _is_stable(model_from(one, structure, like))] or [theta]


def _is_stable(model: TransferFunction) -> bool:
    """Whether all poles but those at the origin are in the open left half plane."""
    dens = (np.trim_zeros(den, "b") for row in model.den for den in row)
    return all(bool(np.all(np.roots(den).real < 0)) for den in dens)


def _points(
    models: list[Array],
    structure: Structure,
    like: TransferFunction,
    omega: Array,
    limits: Array,
    noise: Array,
    wanted: list[int],
) -> SpectralLines:
    """What each line tells about each input, with each model."""
    rows, selectors = [], []
    for theta in models:
        directions = _directions(structure, like, theta)
        slope = response_gradient(model_from(theta, structure, like), structure, omega)
        slope = slope * (limits[:, None] / noise[:, None, None])
        both = np.concatenate([slope.real, slope.imag], axis=1)
        own = np.swapaxes(both, 1, 2).reshape(omega.size * limits.size, -1, theta.size)
        rows.append(own @ directions)
        selectors.append(directions[wanted])
    owner = np.tile(np.arange(limits.size), omega.size)
    return SpectralLines(np.array(rows), owner, np.array(selectors))


def _free(k: int, taken: set[int]) -> int:
    """The nearest multiple that no other input has."""
    step = 0
    while k + step in taken or k + step < 1:
        step = -step if step > 0 else 1 - step
    return k + step
