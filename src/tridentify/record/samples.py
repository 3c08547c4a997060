"""What a record holds, and what is derived of it: the fields of a `Record`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Self
from weakref import WeakKeyDictionary

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.numerics.interpolation import FEWEST
from tridentify.record.checks.references import settled_reference
from tridentify.record.checks.samples import (
    Behaviour,
    Intersample,
    check_band_limited,
    check_intersample,
    check_outputs,
    is_switched,
    looks_measured,
)
from tridentify.record.checks.times import uniform_step

_ON_ITS_TIMES: WeakKeyDictionary[Samples, Any] = WeakKeyDictionary()
"""Records on the step that their instants have on the mean, as long as these are there."""


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Samples:
    """Samples and their times, what they are called, and what the input does between them."""

    u: Array
    y: Array
    dt: float | None
    t: Array
    intersample: Intersample
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    units: Mapping[str, str]
    name: str
    # of the class, so that records that were pickled before there were references have none
    reference: Array | None = None
    reference_names: tuple[str, ...] = ()
    reference_intersample: Intersample | None = None
    # no field, as users replace fields; set by the estimators: the noise of each output over that
    # of all experiments together
    _noise_scale: ClassVar[Array | None] = None

    def _set(self, **fields: object) -> None:
        for key, value in fields.items():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
            object.__setattr__(self, key, value)

    def _derive(self, **changes: object) -> Self:
        """Make a record that differs in fields which are known to be sound, without a copy."""
        record = object.__new__(type(self))
        record._set(**{**self.__dict__, **changes})
        if "y" in changes:
            check_outputs(record.y, record.output_names)
        return record

    def _weighed(self, scale: Array | None) -> Self:
        """The same samples with a noise level: they count for less where it is high.

        Parameters
        ----------
        scale : (n_outputs,) array or None
            Standard deviation of the noise over that of all experiments together; None for one.
        """
        mine = self._noise_scale
        if scale is mine or (
            scale is not None and mine is not None and np.array_equal(scale, mine)
        ):
            return self
        return self._derive(_noise_scale=None if scale is None else np.array(scale))

    @property
    def _loop(self) -> dict[str, Any]:
        """The reference as `Record` takes it, for a record that is made of this one."""
        return {
            "reference": self.reference,
            "reference_names": self.reference_names,
            "reference_intersample": self.reference_intersample,
        }

    @property
    def _units_of_a_model(self) -> dict[str, str]:
        """Units without those of references, which are no channels of a model."""
        alone = set(self.reference_names) - set(self.input_names)
        return {k: unit for k, unit in self.units.items() if k not in alone}

    def _on_its_times(self, u: Array) -> Self:
        """The same record with another input, and the step that its instants have on the mean."""
        if u is not self.u:
            return self._derive(u=u, dt=uniform_step(self.t))
        known = _ON_ITS_TIMES.get(self)
        if known is None:
            known = _ON_ITS_TIMES[self] = self._derive(dt=uniform_step(self.t))
        return known

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "units": dict(self.units)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._set(**{**state, "units": MappingProxyType(state["units"])})

    @property
    def behaviour(self) -> Behaviour:
        """What the input is taken to do between its samples.

        As stated; where that is left open, what the samples suggest: an input that moves at most
        samples, and mostly on in the direction in which it moved before, was measured ("foh"); any
        other was set and held ("zoh"), and so are all where one is switched: it loses more where it
        is joined by lines than a smooth one beside it where it is held.

        Examples
        --------
        >>> from tridentify import Record
        >>> Record([0, 1, 1, 1], [0, 1, 2, 3], dt=0.1, intersample="auto").behaviour
        'zoh'
        """
        if self.intersample != "auto":
            return self.intersample
        return "foh" if looks_measured(self.u) and not is_switched(self.u) else "zoh"

    @property
    def reference_behaviour(self) -> Behaviour | None:
        """What the reference is taken to do between its samples; None without one.

        As stated; where that is left open, what its samples suggest, as with `behaviour`.

        Examples
        --------
        >>> from tridentify import Record
        >>> r, u = [0, 1, 1, 1], [0, 0.5, 0.8, 0.9]
        >>> measured = Record(u, [0, 1, 2, 3], dt=0.1, intersample="auto", reference=r)
        >>> measured.behaviour, measured.reference_behaviour
        ('foh', 'zoh')
        """
        return settled_reference(self.reference_intersample, self.reference)

    def between(self, intersample: Intersample) -> Self:
        """The same samples with another behaviour of the input between them.

        A reference keeps its own.

        Parameters
        ----------
        intersample : {"zoh", "foh", "band-limited", "auto"}

        Raises
        ------
        OptionError, NonUniformTimeError, TooFewSamplesError
            There is no such behaviour, or the record does not allow it.

        Examples
        --------
        >>> from tridentify import Record
        >>> Record([0, 1, 1, 1], [0, 1, 2, 3], dt=0.1).between("foh").intersample
        'foh'
        """
        check_intersample(intersample)
        if intersample == "band-limited":
            check_band_limited(self.dt, self.n_samples)
        return self._derive(intersample=intersample)

    def settled(self, behaviour: str) -> Self:
        """The record with a behaviour of its input where that was left open, else itself.

        Examples
        --------
        >>> from tridentify import Record
        >>> Record([0, 1, 1, 1], [0, 1, 2, 3], dt=0.1).settled("foh").intersample
        'zoh'
        """
        if self.intersample != "auto":
            return self
        if behaviour == "band-limited" and (self.dt is None or self.n_samples < FEWEST):
            behaviour = "foh"
        return self.between(behaviour)  # type: ignore[arg-type]

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return int(self.u.shape[0])

    @property
    def n_inputs(self) -> int:
        """Number of input channels."""
        return int(self.u.shape[1])

    @property
    def n_outputs(self) -> int:
        """Number of output channels."""
        return int(self.y.shape[1])

    @property
    def n_references(self) -> int:
        """Number of references; 0 where none is known."""
        return 0 if self.reference is None else int(self.reference.shape[1])

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return float(self.t[-1] - self.t[0])
