"""Every way in which tridentify refuses to answer, one class for each kind of bad input.

All errors derive from `TridentifyError`; the five families beneath it also derive from the built-in
exception that a caller would expect (`ValueError`, `ArithmeticError`, ...). A message is one line:
what was found, what was expected, what to do.

Examples
--------
>>> from tridentify.errors import DataError, ZeroInputError
>>> issubclass(ZeroInputError, DataError) and issubclass(ZeroInputError, ValueError)
True
"""

from __future__ import annotations

from typing import Self


def shown(value: object, limit: int = 40) -> str:
    r"""Quote foreign text on one line, shortened, so that a message stays one clear line.

    Parameters
    ----------
    value : object
        What was found.
    limit : int
        Longest text that is shown in full, in characters.

    Returns
    -------
    str
        The representation of `value`, line breaks escaped, the middle left out when it is long.

    Examples
    --------
    >>> shown("two\nlines")
    "'two\\nlines'"
    >>> len(shown("x" * 1000)) <= 43
    True
    """
    text = repr(value).replace("\n", "\\n")
    if len(text) <= limit + 2:
        return text
    half = limit // 2
    return f"{text[:half]}...{text[-half:]}"


class TridentifyError(Exception):
    """Base of every exception that tridentify raises on purpose."""

    @classmethod
    def found(cls, what: str, value: object, expected: str, remedy: str = "correct it") -> Self:
        """The error about a value: what it was called, what was expected, and what to do.

        Parameters
        ----------
        what : str
            What stands before the value in the message, as ``dt=`` or ``--unit``.
        value : object
            Shown in quotes, shortened.
        expected, remedy : str

        Examples
        --------
        >>> print(OptionError.found("level=", 2.0, "a probability between 0 and 1", "write 0.95"))
        found level=2.0; expected a probability between 0 and 1; write 0.95
        """
        return cls(f"found {what}{shown(value)}; expected {expected}; {remedy}")


# --- the data ------------------------------------------------------------------------------------


class DataError(TridentifyError, ValueError):
    """The record or the file cannot be used as it is."""


class ShapeError(DataError):
    """An array is neither (n_samples,) nor (n_samples, n_channels), or has no channel."""


class SampleTypeError(DataError):
    """Samples are complex, text, dates, objects or ragged instead of real numbers."""


class LengthMismatchError(DataError):
    """Inputs, outputs and time do not have the same number of samples."""


class NotFiniteError(DataError):
    """An input or the time is nan or infinite, or an output is infinite."""


class EmptyChannelError(DataError):
    """An output channel holds no sample but nan."""


class SamplingError(DataError):
    """The sampling is not stated, stated twice, or no positive number of seconds."""


class TimeNotIncreasingError(DataError):
    """Time stands still or runs backwards between two samples."""


class NonUniformTimeError(DataError):
    """Time is jittered or has gaps where a uniform step is stated or needed."""


class TooFewSamplesError(DataError):
    """There are fewer samples than a record, or the unknowns of a structure, need."""


class EmptyRangeError(DataError):
    """A stretch of time holds fewer than two samples."""


class ResampleError(DataError):
    """The asked step is not a whole multiple of the record's uniform step."""


class ChannelNameError(DataError):
    """Channel names are repeated, blank, unknown or not as many as the channels."""


class UnitError(DataError):
    """A unit belongs to no channel, is no text, or is no unit of time where one is needed."""


class UnitMismatchError(UnitError):
    """Units of a channel differ between records, or do not go with those of a physical model."""


class ZeroInputError(DataError):
    """An input is zero throughout, so that it says nothing about the system."""


class ZeroOutputError(DataError):
    """An output is zero throughout, so that there is nothing to explain."""


class ConstantOutputError(DataError):
    """An output never changes, so that there is no response to explain."""


class ScaleError(DataError):
    """The numbers are so large or so small that their squares leave the range of a float."""


class UnreadableFileError(DataError, OSError):
    """The file is missing, a directory, not permitted, damaged, or not of a known format."""

    def __new__(cls, *args: object) -> UnreadableFileError:
        """An `OSError` from the start: what unpickles exceptions elsewhere calls this by itself."""
        return OSError.__new__(cls, *args)


class FileTooLargeError(DataError):
    """The samples of the file would fill the memory."""


class EmptyFileError(DataError):
    """The file has no content, or a header and no row."""


class MissingHeaderError(DataError):
    """The first line of the file holds numbers instead of the names of the columns."""


class DuplicateColumnError(DataError):
    """A column name occurs twice, or fits several columns."""


class MissingColumnError(DataError):
    """The file has no column of that name."""


class TextInColumnError(DataError):
    """A cell of a column that is needed is not a number."""


class ThousandsSeparatorError(DataError):
    """Numbers are grouped, as in 1,234.5, so that the decimal sign cannot be told for sure."""


class ForeignObjectError(DataError):
    """A channel is an object of another program's own class, or of Python's pickle."""


class RaggedRowError(DataError):
    """A row has more or fewer cells than the header: a damaged or truncated file."""


# --- the model that is asked for -----------------------------------------------------------------


class StructureError(TridentifyError, ValueError):
    """The model that is asked for, or given, makes no sense."""


class OrderError(StructureError):
    """A number of poles or zeros is not a whole number in its range."""


class ChannelCountError(StructureError):
    """Nested orders, delays or coefficients do not fit the number of outputs and inputs."""


class ChannelNumberError(ChannelCountError, IndexError):
    """There is no output or input of that number."""


class OptionError(StructureError, TypeError):
    """An option has a value that is not one of those offered."""


class ParameterNameError(StructureError):
    """A coefficient that is fixed, bounded or known otherwise does not exist in the structure."""


class UnknownParameterError(ParameterNameError, KeyError):
    """An estimate has no coefficient of that name."""

    def __str__(self) -> str:
        return str(self.args[0])


class CandidateError(StructureError):
    """There is no candidate to select from, or one of them is no structure."""


class BoundsError(StructureError):
    """A bound is not a pair (low, high) with low < high, or a fixed value is not finite."""


class DelayError(StructureError):
    """A delay leaves no output sample that a recorded input could explain."""


class EqualityError(StructureError):
    """A linear equality is not a pair (weights by coefficient, value) of finite numbers."""


class PriorError(StructureError):
    """A prior is not a pair (mean, standard deviation) with a positive standard deviation."""


class StaticGainError(StructureError):
    """A known static gain is no finite number, or is nested for other channels."""


class ContradictoryConstraintsError(StructureError):
    """Constraints contradict one another, or leave no stable model or nothing to estimate."""


class CoefficientError(StructureError):
    """Coefficients of a transfer function are empty, not finite, or a denominator is zero."""


class CoefficientMapError(StructureError):
    """A map from physical parameters fails, or does not give the coefficients of its structure."""


class PhysicalParameterError(StructureError):
    """A physical parameter has no usable name, guess or known value, or does not exist."""


class ImproperModelError(StructureError):
    """A numerator has a higher degree than its denominator."""


class UnsupportedError(StructureError):
    """A method or a conversion cannot do what the structure or the model asks."""


class StepNotTakenError(UnsupportedError):
    """An estimate came about without the step that is asked for."""


class UnstablePlantError(UnsupportedError):
    """A plant that is not stable is asked for what its predictor cannot be told."""


# --- what the data can tell ----------------------------------------------------------------------


class IdentifiabilityError(TridentifyError, ArithmeticError):
    """The data cannot determine what is asked of them, however they are treated."""


class ConstantInputError(IdentifiabilityError):
    """An input never changes while the initial state is free: its effect cannot be told apart."""


class ConstantReferenceError(IdentifiabilityError):
    """A reference is asked for that moves in no record: nothing is driven by it."""


class DependentInputsError(IdentifiabilityError):
    """Inputs are linear combinations of each other: their effects cannot be told apart."""


class UndeterminedError(IdentifiabilityError):
    """A physical parameter that the coefficients do not determine by itself was asked for."""


class UnsupportedOrderError(IdentifiabilityError):
    """The data do not support so many poles or zeros."""


# --- the rest ------------------------------------------------------------------------------------


class ConvergenceError(TridentifyError, RuntimeError):
    """No usable estimate was reached."""


class MissingDependencyError(TridentifyError, ImportError):
    """An optional package that this needs is not installed."""


class OutputPathError(TridentifyError, OSError):
    """A result cannot be written where it was asked for."""


class DataWarning(UserWarning):
    """The data are usable, with a caution that the message states."""


__all__ = ["shown", *(name for name in list(globals()) if name.endswith(("Error", "Warning")))]
