"""The model that an on-line estimator begins with: the off-line search on the first samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tridentify.errors import OptionError, TridentifyError, shown
from tridentify.estimation.answer.assemble import Request, assemble
from tridentify.estimation.answer.estimate import Estimate, Status, Trace
from tridentify.estimation.likelihood.answer import Ending, solved_at
from tridentify.estimation.likelihood.choose_nuisance import deciding
from tridentify.estimation.likelihood.question import Question
from tridentify.estimation.methods.base import check
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.estimation.search.following import Search
from tridentify.estimation.search.gross_outliers import outlier_slices
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.realization import sort_poles
from tridentify.numerics.slices import Slices
from tridentify.online.kernels.slots import LARGEST
from tridentify.online.layout import Setting
from tridentify.record.checks.scales import MOST_STEPS, check_filter
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

VAGUE = 0.5
"""Standard error over value of the denominator's coefficients from which a search is not
certain."""
SUSPICIOUS = 10.0
"""Largest bend over the median one from which gross outliers are looked for: the largest of a
thousand Gaussian ones is five."""
LEAST_FAR = 0.005
"""Share of the samples below which a few are left for the estimator to refuse."""
GROWTH = 1.3
"""Samples after which is searched again, over those of the search before: all searches together
cost about four times the last one."""
STARTS, FEW_STARTS = 4, 2
"""Starts of a thorough search, and of one while samples come in."""
USABLE = (Status.CONVERGED, Status.AT_STABILITY_LIMIT, Status.POSTERIOR_MEAN)


class FoundPoles(NamedTuple):
    """Poles to begin with, the noise, and whether they are known well enough to go on."""

    poles: Complex
    noise_std: Array
    certain: bool
    estimate: Estimate


def far_off(setting: Setting, samples: Array) -> Slices[Array]:
    """The samples without outputs that are far from all others, before there is a model.

    Only where second differences are spread far beyond their median is a robust parallel model
    asked (`search.gross_outliers`). At both ends it cannot judge: there nothing is left out.

    Parameters
    ----------
    setting : Setting
    samples : (n, n_inputs + n_outputs + 1) array

    Returns
    -------
    array of the same shape
        The same array where nothing is far off.
    """
    m, n = setting.n_inputs, len(samples)
    y = samples[:, 1 + m :]
    bends = np.abs(np.diff(np.where(np.abs(y) < LARGEST, y, np.nan), 2, axis=0))
    if not np.all(np.isfinite(bends).any(axis=0)):
        return samples
    usual = np.nanmedian(bends, axis=0)
    if not np.any(np.nanmax(bends, axis=0) > SUSPICIOUS * usual):
        return samples
    try:
        far = (yield from outlier_slices([record_of(setting, samples)], setting.structure))[0]
    except (TridentifyError, np.linalg.LinAlgError):
        return samples
    edge = 2 * setting.n_poles + 2
    far[:edge] = False
    far[n - edge :] = False
    if far.sum() < max(1.0, LEAST_FAR * n):
        return samples
    kept = samples.copy()
    kept[:, 1 + m :][far] = np.nan
    return kept


TRIED, DOUBTED = 3, 12  # times a first search's samples: a suspicion is tried, and dropped


def first_try(setting: Setting) -> int:
    """Samples after which a search is worth while."""
    unknowns = len(setting.names) + setting.n_outputs * (setting.n_poles + 2)
    return max(30, 6 * unknowns)


def next_try(count: int) -> int:
    """Samples after which to search again."""
    return int(np.ceil(GROWTH * count))


def searching(
    setting: Setting, samples: Array, begun_anew: bool, *, thorough: bool = False
) -> Slices[FoundPoles | None]:
    """Identify the model from the samples that were kept; None if they do not tell.

    The off-line search and its end, for white noise, a slice at a time.

    Parameters
    ----------
    setting : Setting
    samples : (n, n_inputs + n_outputs + 1) array
        Interval, inputs, outputs.
    begun_anew : bool
        Whether they begin in the middle, from any state.
    thorough : bool
        Whether to look everywhere although coloured noise may be all that is left to explain.
    """
    structure = setting.structure
    if begun_anew:
        structure = Structure(
            structure.poles, structure.zeros, delay=structure.delay, offset=structure.offset,
            drift=structure.drift, initial_state="free",
        )  # fmt: skip
    try:
        record = record_of(setting, samples)
        found = yield from _maximum(record, structure, thorough)
    except (TridentifyError, np.linalg.LinAlgError):
        return None
    return judged_poles(found, setting)


def clean_search(
    setting: Setting, samples: Array, begun_anew: bool
) -> Slices[tuple[FoundPoles | None, Array]]:
    """What is found in the samples without those that are far off, and the samples left."""
    kept = yield from far_off(setting, samples)
    found = yield from searching(setting, kept, begun_anew)
    return found, kept


def _maximum(record: Record, structure: Structure, thorough: bool) -> Slices[Estimate]:
    """The maximum of the likelihood for white noise (`methods.three_model`)."""
    records = [record]
    check(records, structure, "the search", ThreeModel().capabilities)
    question = Question.of(records, structure)
    search = Search(STARTS) if thorough else Search(FEW_STARTS, further=("discrete",))
    yield from search.running(question.base, question.variants)
    best = (yield from deciding(question, search.seeds)).best
    if best.status is not Status.CONVERGED:
        variant = question.variant_of(best.nuisances)
        poles = yield from search.trying_again(question.base, variant, best.point.poles)
        other = (yield from deciding(question, [poles])).best
        best = other if other.criterion < best.criterion else best
    yield
    ending = Ending(best.point, best.nuisances, best.status, best.criterion, Trace(()))
    solved = solved_at(ending, records, structure, judged=False)
    return assemble(Request.of(records, structure, "the search"), solved)


def judged_poles(found: Estimate, setting: Setting) -> FoundPoles | None:
    """The poles of an estimate, and whether they are certain; None if they are no numbers."""
    den = found.model.den[0][0]
    poles = np.roots(den).astype(np.complex128)
    if not np.all(np.isfinite(poles)):
        return None
    sizes = np.abs(found.theta[: setting.n_poles])
    certain = found.status in USABLE and bool(np.all(found.std[: setting.n_poles] < VAGUE * sizes))
    return FoundPoles(sort_poles(poles), np.sqrt(found.noise_variance), certain, found)


def record_of(setting: Setting, samples: Array) -> Record:
    """The samples that were kept as a record."""
    m = setting.n_inputs
    intervals, u, y = samples[:, 0], samples[:, 1 : 1 + m], samples[:, 1 + m :]
    uniform = bool(np.all(np.abs(intervals[1:] - setting.dt) <= 1e-9 * setting.dt))
    t = None if uniform else np.concatenate([[0.0], np.cumsum(intervals[1:])])
    y = np.where(np.abs(y) < LARGEST, y, np.nan)
    return Record(
        u, y, dt=setting.dt if uniform else None, t=t,
        intersample="foh" if setting.intersample == "foh" else "zoh",
        input_names=list(setting.input_names), output_names=list(setting.output_names),
        units=dict(setting.units),
    )  # fmt: skip


def poles_of_start(start: object, setting: Setting) -> Complex:
    """The poles of a model that was given.

    Raises
    ------
    OptionError
        It has other orders, or poles that are not stable.
    ScaleError
        It has poles that the samples cannot show.
    """
    model = start.model if isinstance(start, Estimate) else start
    assert isinstance(model, TransferFunction)
    den = np.asarray(model.den[0][0], dtype=np.float64)
    poles = np.roots(den).astype(np.complex128)
    if poles.size != setting.n_poles or np.any(poles.real >= 0):
        raise OptionError(
            f"found a start with the poles {np.round(poles, 6).tolist()}; expected "
            f"{setting.n_poles} with negative real parts; give another model, or leave start out"
        )
    check_rates(poles, "a start", setting)
    return sort_poles(poles)


def filter_poles(filter_: tuple[float, ...], setting: Setting) -> Complex:
    """The poles of a filter that was given.

    Raises
    ------
    OptionError
        There are fewer than the model has.
    ScaleError
        It has poles that the samples cannot show.
    """
    poles = sort_poles(np.roots(filter_).astype(np.complex128))
    if poles.size < setting.n_poles:
        raise OptionError(
            f"found filter={filter_} of degree {poles.size} with {setting.n_poles} poles; expected "
            "a degree of at least the number of poles; raise the degree"
        )
    check_rates(poles, "a filter", setting)
    return poles


def check_rates(poles: Complex, what: str, setting: Setting) -> None:
    """Refuse poles that no stream of these samples, however long, can show.

    Raises
    ------
    ScaleError
    """
    check_filter(poles, what, setting.dt, MOST_STEPS * setting.dt)


def checked_start(start: object) -> TransferFunction | None:
    """The model to start from.

    Raises
    ------
    OptionError
        It is no model.
    """
    if start is None or isinstance(start, TransferFunction):
        return start
    if isinstance(start, Estimate):
        return start.model
    raise OptionError(
        f"found start={shown(start)}; expected a TransferFunction or an Estimate; leave it out to "
        "have the first samples searched"
    )
