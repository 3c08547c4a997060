"""What the reference drives, told apart from the noise that a controller feeds back.

In ``u = S r - C S v`` the second part is nearly known once a model gives the noise ``v``: operators
on it, weighed beside those on the reference, take it out of the fit of ``u`` as a model of the
controller would (`beside_noise`). What a model ``G`` leaves of the output is ``v`` itself where the
controller works on samples. A continuous one moves the input between the samples; taken as held,
the part ``u_v`` of the input that the noise makes gives

    e  =  y - G u_M - G held(u - u_M)  =  v + G (u_v - held(u_v))  =  v + q * v,            (1)

with ``u_v = sum_i w_i W_i(p) v`` for the weights ``w`` of the operators on the noise. So the
residual is coloured by ``1 + q``, which depends on ``w``, and ``w`` are found by a fit on ``v``:
`apart_from_noise` finds the two in turn. Equation (1) is solved for ``v`` by one division of
Fourier transforms, as ``q`` is a convolution that fades: its response to one sample of noise is
simulated once for each weight. The colour itself is left to the model of the noise, whose whitening
is then that of instruments and residual alike.

The noise counts as held over each interval, as a sensor's is that the controller reads as often as
the record does; of what noise does faster the samples tell nothing.

References: P. Van den Hof & R. Schrama, Automatica 29 (1993) 1523-1527, on the sensitivity from
reference and noise; U. Forssell & L. Ljung, Automatica 35 (1999) 1215-1241, sec. 6.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.driven import (
    Driven,
    fitted,
    near,
    operators,
    starting,
    widest,
)
from tridentify.estimation.closed_loop.unstable import autoregressive
from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array
from tridentify.numerics.extrapolation import extrapolated
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction

FEWEST_ON_NOISE = 4
"""Operators on the noise at least: a plant and a controller of second order."""
SAMPLES_EACH = 5
"""Samples for every weight at least; with fewer the noise is not told from the response."""
TURNS = 40
"""Times that noise and weights are found in turn, at most."""
SETTLED = 1e-4
"""Share of the noise that a turn still moves: well below the errors of the weights."""
MEMORY = 5
"""Turns from which the next one is extrapolated: the map has few slow directions."""
PART = 0.5
"""Of the change that a turn asks for, taken: whole steps overshoot in loops of high gain."""


def beside_noise(part: Driven, noise: Array) -> Driven:
    """The same operators, weighed beside what is known of the noise.

    Parameters
    ----------
    part : Driven
    noise : (n_samples, n_outputs) array
        Residuals of the outputs; ``nan`` counts as zero.
    """
    beside = _Turn.of(part, np.ascontiguousarray(np.nan_to_num(noise)))
    return part if beside is None else replace(beside.part, noise=None)


def apart_from_noise(loop: Loop, model: TransferFunction, left: Array) -> Driven:
    """What the reference drives, where a continuous controller feeds the noise back.

    All operators that the samples show between them count, as the noise no longer hides what the
    last ones add; and of their rates the one counts that leaves least of the input. Where the part
    of the loop was found so already, rate and number stay, and its noise is where the turns begin.

    Parameters
    ----------
    loop : Loop
        With a part that was fitted.
    model : TransferFunction
    left : (n_samples, n_outputs) array
        Residuals of this loop and model; ``nan`` counts as zero.
    """
    part = loop.fitted
    assert isinstance(part, Driven)
    given = np.ascontiguousarray(np.nan_to_num(left))
    if part.noise is not None:
        again = _Turn.of(part, part.noise)
        found = None if again is None else _settled(loop, model, given, again)
        return part if found is None else found.part
    most = _most_beside_noise(part.record)
    own = [part] if part.about and part.order <= most else []
    begun = own or [widest(part.record, part.rate, part.before, most)]
    first = _Turn.of(begun[0], given)
    if loop.record.dt is None or first is None:
        return beside_noise(part, given)
    found = _settled(loop, model, given, first)
    if found is None:
        return beside_noise(part, given)
    among = [*own, *near(part, most)]
    others = [turn for one in among if (turn := _Turn.of(one, found.noise)) is not None]
    best = min(others, key=lambda one: one.criterion)
    return (_settled(loop, model, given, best) or found).part


def _settled(loop: Loop, model: TransferFunction, left: Array, turn: _Turn) -> _Turn | None:
    """Noise and weights that agree with each other, for one rate; None where they run apart."""
    colour = _Colour.of(replace(loop, driven=turn.part), model, turn.order)
    all_of_it = left + made(loop, model)
    at: list[Array] = []
    asked: list[Array] = []
    for _ in range(TURNS):
        e = all_of_it - made(replace(loop, driven=turn.part), model)
        change = PART * (colour.noise(e - e.mean(axis=0), turn.on_noise) - turn.noise)
        if not np.isfinite(change).all() or np.abs(change).max() > np.abs(left).max():
            return None
        at.append(turn.noise)
        asked.append(change)
        following = _Turn.of(turn.part, _mixed(at[-MEMORY:], asked[-MEMORY:]))
        assert following is not None
        turn = following
        if np.linalg.norm(change) <= SETTLED * np.linalg.norm(turn.noise):
            break
    return turn


def _mixed(at: list[Array], asked: list[Array]) -> Array:
    """The next place, from the last ones and the changes that were asked for there."""
    places, steps = (np.stack([one.ravel() for one in some], axis=1) for some in (at, asked))
    step = extrapolated(np.diff(places, axis=1), steps)
    return at[-1] + step.reshape(at[-1].shape)


@dataclass(frozen=True, eq=False)
class _Turn:
    """A noise, and what the references drive beside it.

    Attributes
    ----------
    part : Driven
    noise : (n_samples, n_outputs) array
    on_noise : (n_outputs * (order + 1), n_inputs) array
        Weights of the noise and of its operators.
    order : int
        Operators on the noise.
    criterion : float
        AICc of the inputs.
    """

    part: Driven
    noise: Array
    on_noise: Array
    order: int
    criterion: float

    @classmethod
    def of(cls, part: Driven, noise: Array) -> _Turn | None:
        """Weights beside a noise; None where the record is too short for them."""
        own = _of_noise(part, noise)
        if own is None:
            return None
        columns, n_inputs = np.hstack([part.columns, own]), part.record.n_inputs
        weights = fitted(columns, np.column_stack([part.record.u, part.record.y]))
        rest = part.record.u - columns @ weights[:, :n_inputs]
        n, count = columns.shape
        level = np.log(np.mean(rest**2, axis=0) + 1e-300)
        price = 2.0 * count * n_inputs * n / max(n - count - 2.0, 1.0)
        width = part.columns.shape[1]
        return cls(
            replace(part, weights=weights[:width], noise=noise),
            noise,
            weights[width:, :n_inputs],
            own.shape[1] // noise.shape[1] - 1,
            float(n * level.sum() + price),
        )


def colour(loop: Loop, model: TransferFunction) -> Array | None:
    """(n_samples, n_outputs, n_outputs) what is left of each output of one sample of its noises.

    ``1 + q`` of (1); None where the driven input was not found apart from the noise, or where the
    noise itself is not white: models of it and of what is left do not agree in short records.

    Parameters
    ----------
    loop : Loop
    model : TransferFunction
    """
    part = loop.driven
    if not isinstance(part, Driven) or part.noise is None:
        return None
    turn = _Turn.of(part, part.noise)
    if turn is None or any(autoregressive([own]).size for own in part.noise.T):
        return None
    seen = _Colour.of(loop, model, turn.order)
    return np.asarray(
        np.fft.irfft(seen.full(turn.on_noise), seen.length, axis=0)[: len(part.noise)]
    )


def made(loop: Loop, model: TransferFunction) -> Array:
    """(n_samples, n_outputs) what a model makes of the input, as the loop knows it."""
    return np.asarray(simulate(model, loop.instrument) + loop.beside(model))


@dataclass(frozen=True, eq=False)
class _Colour:
    """What one sample of noise leaves beside itself, for every weight on the noise.

    Attributes
    ----------
    spectra : (n_frequencies, n_outputs, order + 1, n_inputs) array
        Transforms of the responses: output, operator, input.
    length : int
        Of the transforms.
    """

    spectra: np.ndarray
    length: int

    @classmethod
    def of(cls, loop: Loop, model: TransferFunction, order: int) -> _Colour:
        record, part = loop.record, loop.driven
        assert isinstance(part, Driven)
        length = 2 * record.n_samples
        responses = np.zeros((record.n_samples, record.n_outputs, order + 1, record.n_inputs))
        pulse = np.zeros((record.n_samples, 1))
        pulse[1] = 1.0
        quiet = np.zeros((record.n_samples, record.n_inputs))
        start = Record(quiet, np.zeros_like(record.y), dt=record.dt, reference=pulse)
        states = operators(starting(start, np.zeros(1)), part.repeated(order))
        columns = np.hstack([np.ones_like(pulse), pulse, states])
        # every operator by itself through one input after the other
        for j in range(record.n_inputs):
            for k in range(order + 1):
                weights = np.zeros((order + 2, record.n_inputs + record.n_outputs))
                weights[1 + k, j] = 1.0
                alone = Driven(start, part.repeated(order), np.zeros(1), weights, columns)
                responses[:-1, :, k, j] = Loop(alone, loop.sampling).moved_between(model)[1:]
        return cls(np.fft.rfft(responses, length, axis=0), length)

    def noise(self, e: Array, weights: Array) -> Array:
        """(n_samples, n_outputs) ``v`` of (1).

        Parameters
        ----------
        e : (n_samples, n_outputs) array
        weights : (n_outputs * (order + 1), n_inputs) array
            The noise itself first, then its operators, those of one output after the other.
        """
        seen = np.fft.rfft(e, self.length, axis=0)
        found = np.linalg.solve(self.full(weights), seen[:, :, None])[:, :, 0]
        return np.asarray(np.fft.irfft(found, self.length, axis=0)[: len(e)])

    def full(self, weights: Array) -> np.ndarray:
        """(n_frequencies, n_outputs, n_outputs) transform of ``1 + q``; weights as in `noise`."""
        count = self.spectra.shape[1]
        own = weights[count:].reshape(count, -1, weights.shape[1]).swapaxes(0, 1)
        table = np.concatenate([weights[None, :count], own])
        return np.asarray(np.eye(count) + np.einsum("fokj,knj->fon", self.spectra, table))


def _most_beside_noise(record: Record) -> int:
    """Operators on each reference, of which as many on the noise are told apart."""
    n_references, n_outputs = record.n_references, record.n_outputs
    left = record.n_samples // SAMPLES_EACH - 2 * (1 + n_references) - n_outputs
    return max(1, left // (2 * n_references + n_outputs))


def _of_noise(part: Driven, v: Array) -> Array | None:
    """The noise and its operators as columns; None where the record is too short for them."""
    order = max(part.order, FEWEST_ON_NOISE)
    unknown = 2 * part.columns.shape[1] + v.shape[1] * (order + 1)
    if unknown * SAMPLES_EACH > part.record.n_samples:
        return None
    start = starting(part.record, part.before)
    own = operators(replace(start, u=v, intersample="zoh"), part.repeated(order))
    return np.hstack([v, own])
