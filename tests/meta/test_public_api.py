"""What the package promises to its users is there, and says what it is."""

from __future__ import annotations

import dataclasses
import enum
import importlib.metadata
import inspect

import pytest

import tridentify

PROMISED = {
    "ConvergenceError",
    "DataError",
    "Estimate",
    "IdentifiabilityError",
    "MissingDependencyError",
    "Record",
    "Status",
    "Structure",
    "StructureError",
    "ThreeModel",
    "TransferFunction",
    "TridentifyError",
    "identify",
    "read_record",
    "simulate",
}
NOUNS = ("Estimate", "Record", "Structure", "TransferFunction")
NAMES = sorted(name for name in tridentify.__all__ if not name.startswith("__"))


def own_docstring(thing: object) -> str:
    """The docstring that was written for `thing`: not inherited, not the dataclass signature."""
    text = vars(thing).get("__doc__") if isinstance(thing, type) else inspect.getdoc(thing)
    if not text or (isinstance(thing, type) and text.startswith(f"{thing.__name__}(")):
        return ""
    return text


def test_the_promised_names_are_public() -> None:
    assert sorted(PROMISED.difference(tridentify.__all__)) == []


def test_no_name_is_listed_twice_and_dir_knows_all() -> None:
    assert len(set(tridentify.__all__)) == len(tridentify.__all__)
    assert set(tridentify.__all__) <= set(dir(tridentify))


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = tridentify.no_such_name


def test_version_is_the_installed_one() -> None:
    assert tridentify.__version__ == importlib.metadata.version("tridentify")


def test_the_package_says_what_it_is() -> None:
    assert own_docstring(tridentify)


@pytest.mark.parametrize("name", NAMES)
def test_public_name_has_a_docstring(name: str) -> None:
    thing = getattr(tridentify, name)
    if inspect.isclass(thing) or inspect.isroutine(thing):
        assert own_docstring(thing).strip()


@pytest.mark.parametrize("name", NAMES)
def test_public_members_have_docstrings(name: str) -> None:
    thing = getattr(tridentify, name)
    if not inspect.isclass(thing):
        pytest.skip("not a class")
    bare = [
        member
        for member, value in vars(thing).items()
        if not member.startswith("_")
        and (inspect.isroutine(value) or isinstance(value, property | classmethod | staticmethod))
        and not inspect.getdoc(value)
    ]
    assert bare == []


@pytest.mark.parametrize("name", NOUNS)
def test_nouns_are_frozen_and_compare_by_identity(name: str) -> None:
    noun = getattr(tridentify, name)
    assert dataclasses.is_dataclass(noun)
    assert noun.__dataclass_params__.frozen
    if name != "Structure":  # it holds no arrays, so that its equality is well defined
        assert not noun.__dataclass_params__.eq


@pytest.mark.parametrize(
    "name", [name for name in NAMES if name.endswith("Error") and name != "OutputError"]
)
def test_every_error_is_a_tridentify_error(name: str) -> None:
    assert issubclass(getattr(tridentify, name), tridentify.TridentifyError)


def test_every_status_says_what_happened_and_what_to_do() -> None:
    assert issubclass(tridentify.Status, enum.Enum)
    for status in tridentify.Status:
        assert status.message
        assert status.remedy or status is tridentify.Status.CONVERGED
        assert isinstance(status.ok, bool)


def test_the_command_is_installed() -> None:
    (command,) = [
        entry
        for entry in importlib.metadata.entry_points(group="console_scripts")
        if entry.name == "tridentify"
    ]
    assert command.value == "tridentify.cli:main"
    assert callable(command.load())


def test_star_import_works() -> None:
    names: dict[str, object] = {}
    exec("from tridentify import *", names)
    assert set(tridentify.__all__) <= set(names)
