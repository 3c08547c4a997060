"""What is to be estimated: the orders of the model and the nuisance terms estimated along with it.

For one channel the model is ``y = b(p)/a(p) u(t - delay)`` with ``p = d/dt``,
``a(p) = p^n + a_{n-1} p^{n-1} + ... + a_0`` and ``b(p) = b_m p^m + ... + b_0``, ``m <= n``.
A `Structure` says ``n`` (poles) and ``m`` (zeros) for every channel, and it alone knows the order
of the coefficients in the parameter vector ``theta``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Literal, cast

from tridentify.errors import (
    BoundsError,
    ChannelCountError,
    OptionError,
    OrderError,
    ParameterNameError,
    StaticGainError,
    shown,
)
from tridentify.record.checks.orders import (
    Bounds,
    Equality,
    Gain,
    Matrix,
    checked_bounds,
    checked_choice,
    checked_delays,
    checked_drift,
    checked_equalities,
    checked_fixed,
    checked_gain,
    checked_orders,
    checked_priors,
    is_pair,
)
from tridentify.record.checks.values import made_from
from tridentify.structure.orders import Orders

Choice = bool | Literal["auto"]
Drift = bool | int | Literal["auto"]
InitialState = Literal["free", "rest", "equilibrium", "auto"]

_PARAMETER = re.compile(r"([ab])([0-9]{1,4})(\[.+\])?|delay(\[.+\])?")
_DEFAULT = (("u",), ("y",))


@dataclass(frozen=True)
class AutoStructure:
    """Orders left open: what `Structure.auto` makes and `identify` understands.

    Attributes
    ----------
    max_poles : int, optional
        Most poles that are tried; left out, 4, and up to 8 where the record clearly asks for them.
    template : Structure
        Delay, offset, drift and initial state of all candidates; its orders do not count.
    """

    max_poles: int | None = None
    template: Structure = field(default_factory=lambda: Structure(1, 0))

    def __post_init__(self) -> None:
        if self.max_poles is None:
            return
        most = checked_orders("max_poles", self.max_poles, lowest=1)
        if not isinstance(most, int):
            raise OrderError(
                f"found max_poles={shown(self.max_poles)}; expected one whole number; write for "
                "example Structure.auto(max_poles=4)"
            )


@dataclass(frozen=True)
class Structure(Orders):
    """Orders, delay, nuisance terms and constraints of a model.

    Parameters
    ----------
    poles : int or nested sequence of int
        Degree n >= 1 of the denominator. A number means one denominator shared by all channels;
        nested ``poles[output][input]`` means a denominator for each channel; of a single channel
        both are the same.
    zeros : int or nested sequence of int
        Degree m of the numerators, 0 <= m <= n; nested ``zeros[output][input]`` where they differ.
    delay : float, nested sequence of float, or "free"
        Known dead time of each input [s], nested ``delay[output][input]``; "free" to estimate it.
    offset : bool or "auto"
        Whether a constant is estimated along on every output. "auto" lets the data decide.
    drift : bool, int or "auto"
        Whether a slope in time is, too, or a polynomial in time of some degree. Where nothing is
        said there is none, but behind one integrator (``fixed={"a0": 0}``), where a constant error
        of the input makes a ramp, it is "auto": the data decide.
    initial_state : {"auto", "free", "rest", "equilibrium"}
        "rest": every state is zero at the first sample, for the input as recorded. "equilibrium":
        the steady state under the first input value (a trimmed aircraft); the input counts from
        that value and the offset carries the trim. "free": any state. "auto" lets the data decide.
    fixed : mapping of str to float, optional
        Coefficients that are known, by name. ``{"a0": 0.0}`` (with ``"a1": 0.0``, ...) says that
        the model has an integrator (two, ...): poles at the origin.
    bounds : mapping of str to (float or None, float or None), optional
        Lowest and highest value of coefficients, by name; None for no limit.
    equalities : sequence of (mapping of str to float, float), optional
        Linear equalities: weights by coefficient, and the value of the weighted sum.
        ``({"b0": 1.0, "a0": -2.0}, 0.0)`` says ``b0 = 2 a0``.
    priors : mapping of str to (float, float), optional
        What is known before the record: mean and standard deviation of a Gaussian, by coefficient.
    static_gain : float or nested sequence of (float or None), optional
        Known static gain b0 / a0, nested ``static_gain[output][input]`` with None where it is
        unknown; a number holds for all channels.

    Raises
    ------
    OrderError
        Poles or zeros are no whole numbers in range.
    ChannelCountError
        Nested entries are not ``[output][input]`` or do not fit each other.
    OptionError
        `delay`, `offset`, `drift` or `initial_state` has a value that is not offered.
    ParameterNameError
        `fixed`, `bounds`, `equalities` or `priors` name no coefficient of this structure.
    BoundsError, EqualityError, PriorError, StaticGainError
        What is known holds no sensible numbers, or is no mapping of coefficients.

    Notes
    -----
    Which of these a method can honour is for the method to say: it refuses the others with
    `UnsupportedError`.

    Examples
    --------
    >>> from tridentify import Structure
    >>> Structure(2, 1).names(["elevator"], ["q"])
    ('a1', 'a0', 'b1', 'b0')
    >>> Structure(2, [[1], [0]]).names(["elevator"], ["q", "alpha"])
    ('a1', 'a0', 'b1[q,elevator]', 'b0[q,elevator]', 'b0[alpha,elevator]')
    """

    _: KW_ONLY
    offset: Choice = "auto"
    drift: Drift | None = None
    initial_state: InitialState = "auto"
    fixed: Mapping[str, float] | None = field(default=None, hash=False)
    bounds: Mapping[str, Bounds] | None = field(default=None, hash=False)
    equalities: Sequence[Equality] | None = field(default=None, hash=False)
    priors: Mapping[str, tuple[float, float]] | None = field(default=None, hash=False)
    static_gain: float | Sequence[Sequence[float | None]] | None = None

    @staticmethod
    def auto(
        max_poles: int | None = None,
        *,
        delay: float | Sequence[Sequence[float]] | Literal["free"] = 0.0,
        offset: Choice = "auto",
        drift: Drift = False,
        initial_state: InitialState = "auto",
    ) -> AutoStructure:
        """A structure whose orders `identify` chooses, as `select_structure` recommends them.

        Parameters
        ----------
        max_poles : int, optional
            Most poles that are tried (left out: 4, and up to 8 where the record clearly asks for
            them), with one denominator for all channels and every number of zeros below that of
            the poles; as many zeros as poles too, where an output follows an input at once.
        delay, offset, drift, initial_state
            As for a `Structure`; of all candidates.

        Returns
        -------
        AutoStructure

        Raises
        ------
        OrderError
            `max_poles` is no whole number from 1 on.
        OptionError
            An option has a value that is not offered.

        Examples
        --------
        >>> Structure.auto(max_poles=3).max_poles
        3
        """
        template = Structure(
            1, 0, delay=delay, offset=offset, drift=drift, initial_state=initial_state
        )
        return AutoStructure(max_poles, template)

    def __post_init__(self) -> None:
        if self.zeros is None and is_pair(self.poles):
            raise OrderError(
                f"found Structure({shown(self.poles)}) without zeros; expected poles and zeros; "
                "write Structure(2, 1), or the pair (2, 1) where identify or select_structure "
                "takes one"
            )
        clean: dict[str, object] = {
            "poles": checked_orders("poles", self.poles, lowest=1),
            "zeros": checked_orders("zeros", self.zeros, lowest=0),
            "delay": checked_delays(self.delay),
            "offset": checked_choice("offset", self.offset),
            "drift": self._default_drift() if self.drift is None else checked_drift(self.drift),
            "fixed": MappingProxyType(checked_fixed(self.fixed)),
            "bounds": MappingProxyType(checked_bounds(self.bounds)),
            "equalities": checked_equalities(self.equalities),
            "priors": MappingProxyType(checked_priors(self.priors)),
            "static_gain": checked_gain(self.static_gain),
        }
        for key, value in clean.items():
            object.__setattr__(self, key, value)
        state: object = self.initial_state
        if not isinstance(state, str) or state not in ("free", "rest", "equilibrium", "auto"):
            raise OptionError(
                f"found initial_state={shown(self.initial_state)}; expected 'free', 'rest', "
                "'equilibrium' or 'auto'; choose one"
            )
        self._check_shapes()
        self._check_constraints()

    def _default_drift(self) -> Drift:
        """Behind one integrator a constant error of the input is a ramp of the output.

        Behind two it is a parabola, and a ramp is the free response of a rate at the beginning.
        """
        fixed = self.fixed if isinstance(self.fixed, Mapping) else {}
        zero = {str(name) for name in fixed if fixed[name] == 0}
        once = any(name.startswith("a0") and f"a1{name[2:]}" not in zero for name in zero)
        return "auto" if once and self.initial_state != "equilibrium" else False

    @property
    def drift_degree(self) -> int:
        """Highest degree of a drift that may be estimated along; 0 for none."""
        return 1 if isinstance(self.drift, str) else int(self.drift or 0)

    def _check_shapes(self) -> None:
        nested = {
            key: cast("Matrix[float]", value)
            for key, value in (("poles", self.poles), ("zeros", self.zeros), ("delay", self.delay))
            if isinstance(value, tuple)
        }
        shapes = {key: (len(value), len(value[0])) for key, value in nested.items()}
        if len(set(shapes.values())) > 1:
            found = ", ".join(f"{key} for {o} x {i}" for key, (o, i) in shapes.items())
            raise ChannelCountError(
                f"found {found} (outputs x inputs); expected the same numbers; nest them alike"
            )
        n_outputs, n_inputs = next(iter(shapes.values()), (1, 1))
        if isinstance(self.static_gain, tuple) and shapes:
            self.gain_matrix(n_outputs, n_inputs)
        poles = self.poles_matrix(n_outputs, n_inputs)
        zeros = self.zeros_matrix(n_outputs, n_inputs)
        for row_n, row_m in zip(poles, zeros, strict=True):
            for n, m in zip(row_n, row_m, strict=True):
                if m > n:
                    raise OrderError(
                        f"found {m} zeros with {n} poles; expected no more zeros than poles; "
                        "lower zeros or raise poles"
                    )

    def _check_constraints(self) -> None:
        highest = {"a": _largest(self.poles) - 1, "b": _largest(self.zeros)}
        for name in self.known:
            match = _PARAMETER.fullmatch(name)
            missing = match is None or (match[1] and int(match[2]) > highest[match[1]])
            if missing or (name.startswith("delay") and self.delay != "free"):
                raise ParameterNameError(
                    f"found {shown(name)} among what is known; expected a coefficient such as "
                    f"{_listed(self.names())}; correct the name"
                )
        for name in self._fixed.keys() & self._bounds.keys():
            raise BoundsError(
                f"found {shown(name)} both fixed and bounded; expected one of the two; drop one"
            )

    @property
    def _fixed(self) -> Mapping[str, float]:
        return self.fixed or {}

    @property
    def _bounds(self) -> Mapping[str, Bounds]:
        return self.bounds or {}

    @property
    def known(self) -> tuple[str, ...]:
        """Names of the coefficients of which something is said, kind by kind; may repeat."""
        named = [name for weights, _ in self.equalities or () for name in weights]
        return (*self._fixed, *self._bounds, *named, *(self.priors or {}))

    @property
    def constrained(self) -> bool:
        """Whether anything is known of the coefficients."""
        return bool(self.known) or self.static_gain is not None

    @property
    def unconstrained(self) -> Structure:
        """The same with nothing known of the coefficients."""
        return replace(
            self, fixed=None, bounds=None, equalities=None, priors=None, static_gain=None
        )

    def gain_matrix(self, n_outputs: int, n_inputs: int) -> tuple[tuple[float | None, ...], ...]:
        """Give the known static gain of every channel.

        Parameters
        ----------
        n_outputs, n_inputs : int
            Numbers of channels of the record.

        Returns
        -------
        tuple of tuple of (float or None), ``[output][input]``
            None where it is unknown.

        Raises
        ------
        StaticGainError
            The nested gains are for other numbers of channels.

        Examples
        --------
        >>> Structure(2, 0, static_gain=[[1.5, None]]).gain_matrix(1, 2)
        ((1.5, None),)
        """
        gain = cast("Gain | None", self.static_gain)
        if not isinstance(gain, tuple):
            return ((gain,) * n_inputs,) * n_outputs
        if (len(gain), len(gain[0])) != (n_outputs, n_inputs):
            raise StaticGainError(
                f"found static_gain for {len(gain)} outputs x {len(gain[0])} inputs; expected "
                f"{n_outputs} x {n_inputs}; nest it as static_gain[output][input]"
            )
        return gain

    def names(
        self, input_names: Sequence[str] = ("u",), output_names: Sequence[str] = ("y",)
    ) -> tuple[str, ...]:
        """Name every coefficient, in the order of the parameter vector.

        Parameters
        ----------
        input_names, output_names : sequence of str
            Names of the channels of the record.

        Returns
        -------
        tuple of str, length n_parameters
            A shared denominator comes first, descending powers, then each numerator, outputs in the
            outer loop; separate denominators come before their numerators. A name carries
            ``[output,input]`` where there are several channels. Free delays come last.

        Raises
        ------
        ChannelCountError
            Nested orders are for other numbers of channels.
        ParameterNameError
            A coefficient of which something is known does not exist.

        Examples
        --------
        >>> Structure([[2, 1]], 0).names(["e", "r"], ["q"])
        ('a1[q,e]', 'a0[q,e]', 'b0[q,e]', 'a0[q,r]', 'b0[q,r]')
        """
        poles = self.poles_matrix(len(output_names), len(input_names))
        zeros = self.zeros_matrix(len(output_names), len(input_names))
        channels = tuple(input_names), tuple(output_names)
        names = _named(poles, zeros, self.shared, self.delay == "free", *channels)
        existing = set(names)
        for name in self.known:
            # without channels at hand (the default names) a bracketed name cannot be judged
            if name not in existing and not (
                "[" in name and (input_names, output_names) == _DEFAULT
            ):
                raise ParameterNameError(
                    f"found {shown(name)} among what is known; expected one of {_listed(names)}; "
                    "correct the name"
                )
        return names

    def to_dict(self) -> dict[str, Any]:
        """Give plain numbers, text and lists, ready for JSON.

        Returns
        -------
        dict

        Examples
        --------
        >>> Structure.from_dict(Structure(2, 1).to_dict()) == Structure(2, 1)
        True
        """

        def plain(value: object) -> object:
            return [list(row) for row in value] if isinstance(value, tuple) else value

        return {
            "poles": plain(self.poles),
            "zeros": plain(self.zeros),
            "delay": plain(self.delay),
            "offset": self.offset,
            "drift": self.drift,
            "initial_state": self.initial_state,
            "fixed": dict(self._fixed),
            "bounds": {name: list(pair) for name, pair in self._bounds.items()},
            "equalities": [[dict(weights), value] for weights, value in self.equalities or ()],
            "priors": {name: list(pair) for name, pair in (self.priors or {}).items()},
            "static_gain": plain(self.static_gain),
        }

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Structure:
        """Undo `to_dict`.

        Parameters
        ----------
        content : mapping
            What `to_dict` gave.

        Returns
        -------
        Structure

        Raises
        ------
        StructureError
            Keys are missing or unknown, or the values make no structure.

        Examples
        --------
        >>> Structure.from_dict({"poles": 2, "zeros": 1}).poles
        2
        """
        return made_from(cls, content, "poles", "zeros")

    def __reduce__(self) -> tuple[Any, ...]:
        return Structure.from_dict, (self.to_dict(),)


@lru_cache(maxsize=64)
def _named(
    poles: Matrix[int],
    zeros: Matrix[int],
    shared: bool,
    late: bool,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
) -> tuple[str, ...]:
    """`Structure.names` of orders, whether or not the denominator is shared and delays are free."""
    several = len(outputs) * len(inputs) > 1
    names = [f"a{k}" for k in reversed(range(poles[0][0]))] if shared else []
    for i, output in enumerate(outputs):
        for j, source in enumerate(inputs):
            where = f"[{output},{source}]" if several else ""
            if not shared:
                names += [f"a{k}{where}" for k in reversed(range(poles[i][j]))]
            names += [f"b{k}{where}" for k in reversed(range(zeros[i][j] + 1))]
    if late:
        names += ["delay"] if len(inputs) == 1 else [f"delay[{source}]" for source in inputs]
    return tuple(names)


def _largest(orders: int | Sequence[Sequence[int]]) -> int:
    return orders if isinstance(orders, int) else max(max(row) for row in orders)


def _listed(names: Sequence[str]) -> str:
    return shown(", ".join(names), 300)[1:-1]
