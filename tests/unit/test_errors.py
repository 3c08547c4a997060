"""The exception classes: families, built-in bases, one-line messages."""

from __future__ import annotations

import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tridentify import errors

FAMILIES = {
    errors.DataError: ValueError,
    errors.StructureError: ValueError,
    errors.IdentifiabilityError: ArithmeticError,
    errors.ConvergenceError: RuntimeError,
    errors.MissingDependencyError: ImportError,
    errors.OutputPathError: OSError,
}
CLASSES = [
    thing
    for name in errors.__all__
    if isinstance(thing := getattr(errors, name), type) and issubclass(thing, Exception)
]
PROMISED = {
    "ZeroInputError": errors.DataError,
    "ZeroOutputError": errors.DataError,
    "TooFewSamplesError": errors.DataError,
    "NonUniformTimeError": errors.DataError,
    "ConstantInputError": errors.IdentifiabilityError,
    "UnsupportedOrderError": errors.IdentifiabilityError,
    "UnsupportedError": errors.StructureError,
}


@pytest.mark.parametrize(("family", "builtin"), FAMILIES.items())
def test_a_family_is_also_the_built_in_error(family: type, builtin: type) -> None:
    assert issubclass(family, errors.TridentifyError)
    assert issubclass(family, builtin)


@pytest.mark.parametrize(("name", "family"), PROMISED.items())
def test_a_cause_belongs_to_its_family(name: str, family: type) -> None:
    assert issubclass(getattr(errors, name), family)


@pytest.mark.parametrize("cls", CLASSES)
def test_every_error_belongs_to_exactly_one_family(cls: type[Exception]) -> None:
    if cls in (errors.TridentifyError, errors.DataWarning):
        return
    assert sum(issubclass(cls, family) for family in FAMILIES) == 1


@pytest.mark.parametrize("cls", CLASSES)
def test_message_survives_another_process(cls: type[Exception]) -> None:
    error = pickle.loads(pickle.dumps(cls("found x; expected y; do z")))
    assert type(error) is cls
    assert str(error) == "found x; expected y; do z"


@pytest.mark.parametrize("cls", CLASSES)
def test_a_class_makes_its_instances_by_itself(cls: type[Exception]) -> None:
    """As what carries tracebacks between the processes of a cluster unpickles them."""
    assert str(cls.__new__(cls, "found x")) == "found x"


@pytest.mark.parametrize("cls", CLASSES)
def test_every_error_says_what_it_stands_for(cls: type[Exception]) -> None:
    assert vars(cls)["__doc__"].strip().endswith(".")
    assert cls.__name__ in errors.__all__


@given(st.text(max_size=200))
def test_foreign_text_is_shown_on_one_short_line(text: str) -> None:
    result = errors.shown(text)
    assert len(result.splitlines()) <= 1
    assert len(result) <= 43
