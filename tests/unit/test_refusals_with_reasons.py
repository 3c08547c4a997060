"""What is handed over in the wrong place is told in one line, by an exception of ours."""

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tridentify import (
    Estimate,
    Record,
    Structure,
    TransferFunction,
    TridentifyError,
    find_manoeuvres,
    frequency_response,
    from_options,
    identify,
    plots,
    read_record,
    select_structure,
    simulate,
)
from tridentify.errors import (
    ChannelNumberError,
    DataWarning,
    OptionError,
    SampleTypeError,
    UnknownParameterError,
)
from tridentify.uncertainty import bootstrap

PLANT = TransferFunction([2.0], [1.0, 4.0])
U = np.repeat(np.random.default_rng(5).choice([-1.0, 1.0], 20), 5)
CLEAN = simulate(PLANT, Record(U, U, dt=0.05))[:, 0]
RECORD = Record(U, CLEAN + 0.01 * np.random.default_rng(6).standard_normal(U.size), dt=0.05)
ESTIMATE = identify(RECORD, Structure(1, 0))
ANY: Any = 3

CALLS: dict[str, tuple[Callable[[], object], type[Exception], str]] = {
    "identify progress": (
        lambda: identify(RECORD, (1, 0), progress=ANY),
        OptionError,
        "progress=3",
    ),
    "bootstrap progress": (
        lambda: bootstrap(ESTIMATE, RECORD, progress=ANY),
        OptionError,
        "progress=3",
    ),
    "select executor": (
        lambda: select_structure(RECORD, [Structure(1, 0)], executor=ANY),
        OptionError,
        "executor=3",
    ),
    "bootstrap executor": (
        lambda: bootstrap(ESTIMATE, RECORD, executor=ANY),
        OptionError,
        "executor=3",
    ),
    "coefficient": (lambda: ESTIMATE.parameters["a7"], UnknownParameterError, "a0, b0"),
    "save": (lambda: ESTIMATE.save(ANY), OptionError, "name of a file"),
    "output of a model": (lambda: PLANT.channel(3, 0), ChannelNumberError, "0 to 0 (y)"),
    "input of an estimate": (lambda: ESTIMATE.channel(0, 1), ChannelNumberError, "0 to 0 (u)"),
    "channel by name": (lambda: ESTIMATE.channel("y", 0), ChannelNumberError, "'y'"),  # type: ignore[arg-type]
    "frequencies": (lambda: plots.plot_bode(ESTIMATE, [-1.0, 2.0]), OptionError, "omega=-1.0"),
    "manoeuvres": (lambda: find_manoeuvres(ANY), SampleTypeError, "int in place of a record"),
    "manoeuvres of two": (lambda: find_manoeuvres([RECORD, RECORD]), SampleTypeError, "2 records"),  # type: ignore[arg-type]
    "response": (lambda: frequency_response(ANY), SampleTypeError, "int in place of a record"),
    "options": (lambda: from_options(ANY), OptionError, "the options 3"),
}


@pytest.mark.parametrize("call", CALLS)
def test_wrong_argument_is_told_in_one_line(call: str) -> None:
    wrong, kind, words = CALLS[call]
    with pytest.raises(kind) as caught:
        wrong()
    message = str(caught.value)
    assert isinstance(caught.value, TridentifyError)
    assert words in message
    assert "\n" not in message
    assert message.count(";") >= 2


def test_lookups_that_ask_whether_a_coefficient_is_there_still_do() -> None:
    assert "a7" not in ESTIMATE.parameters
    assert ESTIMATE.parameters.get("a7") is None
    with pytest.raises(KeyError):
        ESTIMATE.parameters["a7"]
    assert isinstance(ESTIMATE, Estimate)


def test_step_that_is_not_that_of_the_files_time_is_told(tmp_path: Any) -> None:
    rows = "\n".join(f"{0.025 * k:.3f},{k % 2},{k}" for k in range(9))
    (tmp_path / "log.csv").write_text(f"t,u,y\n{rows}\n")
    with pytest.warns(DataWarning, match=r"mean step is 0\.025 s, not 1 s"):
        read_record(tmp_path / "log.csv", inputs=["u"], outputs=["y"], dt=1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_record(tmp_path / "log.csv", inputs=["u"], outputs=["y"], dt=0.025).dt == 0.025
