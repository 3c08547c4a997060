"""What follows from the coefficients of an estimate, with its uncertainty and its unit."""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from tridentify.errors import UnknownParameterError
from tridentify.estimation.answer.content import Content
from tridentify.estimation.answer.parameter import Parameter
from tridentify.numerics import delta_method
from tridentify.numerics.arrays import Array
from tridentify.numerics.quantiles import ONE_SIGMA, around
from tridentify.numerics.root_draws import pole_values
from tridentify.record.checks.names import check_channel
from tridentify.writing.layout import unit_ratio

Row = tuple[str, float, float, str]
HELD = 1e-17
"""A derived error below this share of its value is no error: a tenth of the rounding of a
double."""


class _ByName(dict[str, Parameter]):
    """Coefficients by name; one that is not there is told those that are."""

    def __missing__(self, name: object) -> Parameter:
        raise UnknownParameterError.found(
            "the coefficient ", name, f"one of {', '.join(self)}", "see estimate.names"
        )


class Derived(Content):
    """The quantities of an `Estimate`."""

    @property
    def std(self) -> Array:
        """Standard errors of ``theta``, shape (n_parameters,)."""
        std: Array = np.sqrt(np.maximum(np.diag(self.cov), 0.0))
        return std

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """Name -> `Parameter`, in the order of ``names``.

        Another name raises `UnknownParameterError`, which is a KeyError, too.
        """
        rows = zip(self.names, self.theta.tolist(), self.std.tolist(), strict=True)
        table = _ByName(
            (name, Parameter(name, v, std, self._unit(name), self.draws[:, k]))
            for k, (name, v, std) in enumerate(rows)
        )
        return MappingProxyType(table)

    def channel(self, output: int, input_: int) -> tuple[Array, Array, Array]:
        """Numerator, denominator and covariance of one channel.

        Parameters
        ----------
        output, input_ : int
            Positions of the channel.

        Returns
        -------
        num, den : ndarray
            Descending powers, ``den`` monic.
        cov : ndarray, shape (n + m + 2, n + m + 2)
            Of ``(a_{n-1}, ..., a_0, b_m, ..., b_0, delay)``; zero for what was not estimated.

        Raises
        ------
        ChannelNumberError
            There is no such channel; it is an IndexError, too.
        """
        check_channel(output, input_, self.output_names, self.input_names)
        den, num = self.model.den[output][input_], self.model.num[output][input_]
        label = f"[{self.output_names[output]},{self.input_names[input_]}]"
        position = {name: k for k, name in enumerate(self.names)}
        wanted = [f"a{k}" for k in range(len(den) - 2, -1, -1)]
        wanted += [f"b{k}" for k in range(len(num) - 1, -1, -1)]
        places = [position.get(name + label, position.get(name, -1)) for name in wanted]
        delay = f"delay[{self.input_names[input_]}]"
        places.append(position.get(delay, position.get("delay", -1)))
        where = np.array(places)
        free = where >= 0
        return num, den, np.where(free[:, None] & free, self.cov[np.ix_(where, where)], 0.0)

    def derived_rows(self) -> tuple[Row, ...]:
        """(name, value, std, unit) of poles, dampings and static gains, to first order."""
        shared = self.structure.shared
        several = len(self.input_names) * len(self.output_names) > 1
        rows: list[Row] = []
        gains: list[Row] = []
        for i, output in enumerate(self.output_names):
            for j, input_ in enumerate(self.input_names):
                num, den, cov = self.channel(i, j)
                label = f"[{output},{input_}]" if several else ""
                # what has no room in a float is shown as infinite or nan
                with np.errstate(all="ignore"):
                    gain = delta_method.dc_gain(num, den, cov)
                    n, where = len(den) - 1, "" if shared else label
                    if not shared or (i, j) == (0, 0):
                        poles = delta_method.pole_quantities(den, cov[:n, :n])
                        rows += [(row[0] + where, *row[1:]) for row in poles]
                unit = self._ratio_unit(output, input_, 0)
                gains.append(("dc gain" + label, *gain, unit))
        # below the rounding of the value there is no error, as of a frequency that is held
        return tuple(
            (name, value, 0.0 if std <= HELD * abs(value) else std, unit)
            for name, value, std, unit in rows + gains
        )

    def channel_draws(self, theta: Array, output: int, input_: int) -> tuple[Array, Array, Array]:
        """Polynomials of one channel for many coefficient vectors.

        Parameters
        ----------
        theta : ndarray, shape (n_draws, n_parameters)
        output, input_ : int
            Positions of the channel.

        Returns
        -------
        num : ndarray, shape (n_draws, m + 1)
        den : ndarray, shape (n_draws, n + 1)
        delay : ndarray, shape (n_draws,)
            [s].
        """
        source = self.input_names[input_]
        label = f"[{self.output_names[output]},{source}]"
        position = {name: k for k, name in enumerate(self.names)}

        def column(names: tuple[str, ...], known: float) -> Array:
            found = next((position[name] for name in names if name in position), None)
            return np.full(len(theta), known) if found is None else theta[:, found]

        def polynomial(letter: str, values: Array) -> Array:
            powers = range(len(values) - 1, -1, -1)
            columns = [
                column((f"{letter}{k}{label}", f"{letter}{k}"), v)
                for k, v in zip(powers, values.tolist(), strict=True)
            ]
            return np.stack(columns, axis=1)

        delay = column((f"delay[{source}]", "delay"), float(self.model.delay[output, input_]))
        num, den = self.model.num[output][input_], self.model.den[output][input_]
        return polynomial("b", num), polynomial("a", den), delay

    def derived_values(self, theta: Array) -> Array:
        """`derived_rows` of many coefficient vectors, shape (n_draws, n_quantities)."""
        blocks: list[Array] = []
        gains: list[Array] = []
        for i in range(len(self.output_names)):
            for j in range(len(self.input_names)):
                num, den, _ = self.channel_draws(theta, i, j)
                if not self.structure.shared or (i, j) == (0, 0):
                    blocks.append(pole_values(den, self.model.den[i][j]))
                with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                    gains.append(num[:, -1] / den[:, -1])
        return np.hstack([*blocks, np.stack(gains, axis=1)])

    def derived(self) -> tuple[Parameter, ...]:
        """Poles, dampings and static gains with standard errors and intervals.

        The values are always those of the model. Errors and intervals of a posterior mean are those
        of its draws, with half the width of the interval of 68.27 % in place of a standard error,
        which is finite where their tails have no variance; else to first order.
        """
        rows = self.derived_rows()
        if not len(self.draws):
            return tuple(Parameter(*row) for row in rows)
        values = self.derived_values(np.asarray(self.draws))
        low, high = around(values, np.array([row[1] for row in rows]), ONE_SIGMA)
        with np.errstate(invalid="ignore"):
            spread = (0.5 * (high - low)).tolist()
        return tuple(
            Parameter(name, value, spread[k], unit, values[:, k])
            for k, (name, value, _, unit) in enumerate(rows)
        )

    def _unit(self, name: str) -> str:
        match = re.fullmatch(r"([ab])(\d+)(?:\[(.*)\])?", name)
        if match is None:
            return "s" if name.startswith("delay") else ""
        i, j = 0, 0
        for row, output in enumerate(self.output_names):
            for column, input_ in enumerate(self.input_names):
                if match[3] == f"{output},{input_}":
                    i, j = row, column
        power = len(self.model.den[i][j]) - 1 - int(match[2])
        if match[1] == "a":
            return unit_ratio("", "", power)
        return self._ratio_unit(self.output_names[i], self.input_names[j], power)

    def _ratio_unit(self, output: str, input_: str, power: int) -> str:
        if output not in self.units or input_ not in self.units:
            return ""
        return unit_ratio(self.units[output], self.units[input_], power)
