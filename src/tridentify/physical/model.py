"""A declared map from physical parameters to the coefficients of a transfer function.

``theta = g(phi)``: the parameters ``phi`` are masses, resistances, aerodynamic derivatives; the
coefficients ``theta`` are those of `Structure`, by name. The map is plain Python; its derivatives
are those that are given with it, or central differences with one step of Richardson's
extrapolation,

    g' = (4 D(h/2) - D(h)) / 3 + O(h^4),    D(h) = (g(z + h) - g(z - h)) / (2 h),

in the coordinates ``z``: the logarithm of a parameter that is positive, else the parameter over the
size of its guess. So units have no part in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import CoefficientMapError, PhysicalParameterError, shown
from tridentify.numerics.arrays import Array
from tridentify.record.checks.names import LONGEST_NAME, check_units, is_plain
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

Values = Mapping[str, float]
CoefficientMap = Callable[[Values], Values]
Derivatives = Callable[[Values], Mapping[str, Values]]

DIFFERENCE_STEP = 2e-3
"""Of the logarithm of a parameter: differences of fourth order then err by 1e-11 and round by
1e-13."""
AGREES = 1e-5
"""Relative difference of stated and numerical derivatives that is none."""


@dataclass(frozen=True)
class PhysicalParameter:
    """One physical parameter.

    Parameters
    ----------
    name : str
    unit : str
    description : str
    guess : float
        Typical value with its sign, not zero [unit]: where the search begins, and the scale of
        the parameter. The right power of ten is good enough.
    positive : bool
        Whether the parameter can only be positive, such as a mass.

    Raises
    ------
    PhysicalParameterError
        The name is blank, not printable or too long, or the guess is of no use.
    UnitError
        The unit is not printable or too long.

    Examples
    --------
    >>> PhysicalParameter("m", "kg", "mass", guess=2.0, positive=True).guess
    2.0
    """

    name: str
    unit: str = ""
    description: str = ""
    guess: float = 1.0
    positive: bool = False

    def __post_init__(self) -> None:
        if not (is_plain(self.name, LONGEST_NAME) and self.name.strip()):
            raise PhysicalParameterError(
                f"found the name {shown(self.name)}; expected printable text of at most "
                f"{LONGEST_NAME} characters; name the parameter"
            )
        check_units({self.name: self.unit})
        usable = isinstance(self.guess, (int, float)) and math.isfinite(self.guess)
        if not usable or self.guess == 0 or (self.positive and self.guess < 0):
            wanted = "a positive number" if self.positive else "a finite number other than zero"
            raise PhysicalParameterError(
                f"found guess={shown(self.guess)} of {self.name}; expected {wanted}; give a "
                "typical value"
            )


@dataclass(frozen=True, eq=False)
class PhysicalModel:
    """Physical parameters and what they make of the coefficients of a structure.

    Parameters
    ----------
    name : str
    parameters : sequence of PhysicalParameter
    structure : Structure
    coefficients : callable
        Gives the coefficients, name -> value, for parameters, name -> value. Every name of
        ``structure.names(input_names, output_names)`` and no other.
    input_names, output_names : sequence of str
        Channels in the order of the structure.
    start : callable, optional
        Gives approximate parameters for coefficients (both name -> value); the search begins there
        and at the guesses. Names may be missing.
    derivatives : callable, optional
        For parameters, name -> value, gives coefficient name -> (parameter name -> derivative);
        what is missing is zero. Checked against differences when the model is made.
    combinations : mapping of str to callable, optional
        Quantities made of the parameters that are of interest by themselves, such as
        ``{"R C": lambda p: p["R"] * p["C"]}``.

    Raises
    ------
    PhysicalParameterError
        There is no parameter, or a name occurs twice.
    CoefficientMapError
        The map fails at the guesses, gives other names than the structure has, or its derivatives
        are wrong.

    Examples
    --------
    >>> from tridentify import Structure
    >>> rc = PhysicalModel(
    ...     "RC low pass",
    ...     [PhysicalParameter("tau", "s", guess=0.1, positive=True), PhysicalParameter("gain")],
    ...     Structure(1, 0),
    ...     lambda p: {"a0": 1 / p["tau"], "b0": p["gain"] / p["tau"]},
    ... )
    >>> rc.theta({"tau": 0.5, "gain": 3.0}).tolist()
    [2.0, 6.0]
    >>> rc.transfer_function({"tau": 0.5, "gain": 3.0}).dc_gain
    array([[3.]])
    """

    name: str
    parameters: Sequence[PhysicalParameter]
    structure: Structure
    coefficients: CoefficientMap
    _: KW_ONLY
    input_names: Sequence[str] = ("u",)
    output_names: Sequence[str] = ("y",)
    start: CoefficientMap | None = None
    derivatives: Derivatives | None = None
    combinations: Mapping[str, Callable[[Values], float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        clean: dict[str, object] = {
            "parameters": tuple(self.parameters),
            "input_names": tuple(self.input_names),
            "output_names": tuple(self.output_names),
            "combinations": MappingProxyType(dict(self.combinations)),
        }
        for key, value in clean.items():
            object.__setattr__(self, key, value)
        twice = {name for name in self.names if self.names.count(name) > 1}
        if not self.parameters or twice:
            raise PhysicalParameterError(
                f"found {'the names ' + ', '.join(sorted(twice)) + ' twice' if twice else 'none'}; "
                "expected one or more parameters of different names; correct the list"
            )
        self.theta(dict(zip(self.names, self.guess.tolist(), strict=True)))
        if self.derivatives is not None:
            self._check_derivatives()

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)

    @cached_property
    def units(self) -> dict[str, str]:
        """Parameter name -> unit."""
        return {p.name: p.unit for p in self.parameters}

    @cached_property
    def guess(self) -> Array:
        """(n_parameters,) guesses."""
        return np.array([p.guess for p in self.parameters], dtype=np.float64)

    @cached_property
    def positive(self) -> NDArray[np.bool_]:
        """(n_parameters,) which parameters are positive."""
        return np.array([p.positive for p in self.parameters])

    @cached_property
    def coefficient_names(self) -> tuple[str, ...]:
        """Names of the coefficients, in the order of ``theta``."""
        return self.structure.names(self.input_names, self.output_names)

    def theta(self, values: Values) -> Array:
        """Coefficients in the order of `coefficient_names`, for parameters by name.

        Parameters
        ----------
        values : mapping of str to float

        Returns
        -------
        (n_coefficients,) array

        Raises
        ------
        CoefficientMapError
            The map raises, gives other names than the structure has, or no finite numbers.
        """
        try:
            found = self.coefficients(values)
            given = dict(found)
        except Exception as error:
            raise CoefficientMapError(
                f"found {type(error).__name__} ({error}) from the map of {self.name} at "
                f"{_listed(values)}; expected coefficients by name; correct the map"
            ) from error
        expected = self.coefficient_names
        if given.keys() != set(expected):
            raise CoefficientMapError(
                f"found the coefficients {', '.join(map(str, given))} from the map of {self.name}; "
                f"expected {', '.join(expected)} as in its structure; correct the map"
            )
        try:
            theta = np.array([given[name] for name in expected], dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise CoefficientMapError(
                f"found {shown(given, 80)} from the map of {self.name}; expected real numbers; "
                "correct the map"
            ) from error
        if theta.shape != (len(expected),) or not np.all(np.isfinite(theta)):
            raise CoefficientMapError(
                f"found {shown(given, 80)} from the map of {self.name} at {_listed(values)}; "
                "expected finite numbers; correct the map or the guesses"
            )
        return theta

    def transfer_function(self, values: Values) -> TransferFunction:
        """The model with these parameters.

        Parameters
        ----------
        values : mapping of str to float

        Returns
        -------
        TransferFunction

        Raises
        ------
        CoefficientMapError
            The map does not give its coefficients.
        """
        return model_of(self.structure, self.theta(values), self.input_names, self.output_names)

    def at(self, z: Array) -> dict[str, float]:
        """Parameters by name, for coordinates."""
        return dict(zip(self.names, self.values(z).tolist(), strict=True))

    def values(self, z: Array) -> Array:
        """Parameters for coordinates: both (n_parameters,)."""
        with np.errstate(over="ignore"):
            grown = np.exp(np.where(self.positive, z, 0.0))
        return np.where(self.positive, grown, z * np.abs(self.guess))

    def coordinates(self, values: Array) -> Array:
        """Coordinates for parameters: both (n_parameters,)."""
        logs = np.log(np.where(self.positive, values, 1.0))
        return np.where(self.positive, logs, values / np.abs(self.guess))

    def slope(self, z: Array) -> Array:
        """(n_parameters,) derivatives of the parameters with respect to their coordinates."""
        return np.where(self.positive, self.values(z), np.abs(self.guess))

    def theta_at(self, z: Array) -> Array:
        """Coefficients for coordinates; ``nan`` where the map gives none."""
        try:
            return self.theta(self.at(z))
        except CoefficientMapError:
            return np.full(len(self.coefficient_names), np.nan)

    def jacobian(self, z: Array) -> Array:
        """(n_coefficients, n_parameters) derivatives with respect to the coordinates."""
        if self.derivatives is None:
            return self._differences(z)
        given = self.derivatives(self.at(z))
        table = [[given.get(c, {}).get(p, 0.0) for p in self.names] for c in self.coefficient_names]
        return np.array(table, dtype=np.float64) * self.slope(z)

    def _differences(self, z: Array) -> Array:
        step = DIFFERENCE_STEP * np.where(self.positive, 1.0, np.maximum(np.abs(z), 1.0))
        return differences(self.theta_at, z, step)

    def _check_derivatives(self) -> None:
        z = self.coordinates(self.guess)
        ours = self._differences(z)
        theirs = self.jacobian(z)
        scale = np.maximum(np.abs(ours).max(axis=1, keepdims=True), np.abs(theirs))
        wrong = np.argwhere(~(np.abs(ours - theirs) <= AGREES * scale))
        if wrong.size:
            i, j = wrong[0]
            slope = self.slope(z)[j]
            raise CoefficientMapError(
                f"found d {self.coefficient_names[i]} / d {self.names[j]} = "
                f"{theirs[i, j] / slope:.6g} from the derivatives of {self.name}; expected "
                f"{ours[i, j] / slope:.6g} as in its map; correct one of the two"
            )


def differences(function: Callable[[Array], Array], z: Array, step: Array) -> Array:
    """Derivatives (n_values, n) by central differences with steps (n,), extrapolated once."""
    columns = []
    for j in range(z.size):
        found = []
        for h in (step[j], 0.5 * step[j]):
            above, below = z.copy(), z.copy()
            above[j] += h
            below[j] -= h
            found.append((function(above) - function(below)) / (above[j] - below[j]))
        columns.append((4.0 * found[1] - found[0]) / 3.0)
    return np.stack(columns, axis=1)


def model_of(
    structure: Structure, theta: Array, inputs: Sequence[str], outputs: Sequence[str]
) -> TransferFunction:
    """The transfer function that has these coefficients."""
    num, den = structure.split(theta, len(outputs), len(inputs))
    delay = np.array(structure.delay_matrix(len(outputs), len(inputs)), dtype=np.float64)
    if structure.delay == "free":
        delay = np.tile(theta[-len(inputs) :], (len(outputs), 1))
    return TransferFunction(num, den, delay=delay, input_names=inputs, output_names=outputs)


def _listed(values: Values) -> str:
    return ", ".join(f"{name}={value:.6g}" for name, value in values.items())
