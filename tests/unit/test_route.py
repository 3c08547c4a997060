"""What is made of a controller that may have been running: options, the field of the estimate."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tridentify import (
    DataError,
    Estimate,
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    identify,
    simulate,
)
from tridentify.errors import OptionError

PLANT = TransferFunction([2.0], [1.0, 1.0, 4.0])


@pytest.fixture(scope="module")
def record() -> Record:
    """An open-loop record with white noise."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.choice([-1.0, 1.0], 80), 5)
    clean = simulate(PLANT, Record(u, u, dt=0.1))[:, 0]
    return Record(u, clean + 0.1 * rng.standard_normal(400), dt=0.1)


@pytest.fixture(scope="module")
def direct(record: Record) -> Estimate:
    """By the direct route."""
    return identify(record, Structure(2, 0), ThreeModel(route="direct"))


def test_a_record_without_a_controller_is_fitted_open_loop(record):
    auto = identify(record, Structure(2, 0))
    open_loop = identify(record, Structure(2, 0), ThreeModel(route="open-loop"))
    assert auto.route == open_loop.route == "open-loop"
    np.testing.assert_array_equal(auto.theta, open_loop.theta)
    assert "route" not in auto.summary()


def test_the_direct_route_models_the_noise_though_it_is_white(direct):
    assert direct.route == "direct"
    assert direct.noise_model[0].size >= 1
    assert "direct route" in " ".join(direct.summary().split())
    assert direct.call == "ThreeModel(route='direct')"


def test_the_route_is_saved_where_it_is_not_open_loop(record, direct, tmp_path):
    again = Estimate.load(direct.save(tmp_path / "direct.json"))
    assert again.route == "direct"
    plain = identify(record, Structure(2, 0)).save(tmp_path / "plain.json")
    assert "route" not in json.loads(plain.read_text())
    assert Estimate.load(plain).route == "open-loop"


def test_a_file_with_another_route_is_refused(direct, tmp_path):
    path = direct.save(tmp_path / "model.json")
    path.write_text(json.dumps(json.loads(path.read_text()) | {"route": "sideways"}))
    with pytest.raises(DataError, match="found route='sideways'; expected one of open-loop"):
        Estimate.load(path)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"route": "closed"}, "found route='closed'; expected 'auto', 'open-loop'"),
        ({"route": "direct", "noise": "white"}, "found route='direct' with noise='white'"),
        ({"route": "direct", "loss": "huber"}, "found route='direct' with loss='huber'"),
    ],
)
def test_wrong_options_are_refused(options, said):
    with pytest.raises(OptionError, match=said):
        ThreeModel(**options)


def test_the_reference_route_wants_a_reference(record):
    with pytest.raises(OptionError, match="'reference' and a record without a reference"):
        identify(record, Structure(2, 0), ThreeModel(route="reference"))
