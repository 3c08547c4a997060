"""One model for a fleet by adding triangles: the joint estimate of all records on one machine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fleets
from tridentify import Record, Structure, ThreeModel, TransferFunction, fleet, identify, simulate
from tridentify.errors import DataError, IdentifiabilityError, OptionError, UnsupportedError
from tridentify.fleet.local import local_pieces

pytestmark = pytest.mark.unjudged

STRUCTURES = {
    "at rest": Structure(2, 0, offset=False, initial_state="rest"),
    "free, with offsets": Structure(2, 1, offset=True, initial_state="free"),
    "open": Structure(2, 0),
    "a direct path and a drift": Structure(1, 1, offset=True, drift=True, initial_state="free"),
    "delayed": Structure(2, 0, delay=0.05, offset=False, initial_state="rest"),
}


def by_one_machine(records: list[Record], structure: Structure):
    """The joint estimate, taken as far as rounding lets it."""
    method = ThreeModel(noise="white", finish="likelihood", tolerance=1e-20)
    return identify(records, structure, method, throw=False)


def two_outputs(rng: np.random.Generator) -> Record:
    """Two inputs and two outputs, missing samples and uneven time among them."""
    t = np.cumsum(rng.uniform(0.05, 0.15, 90))
    u = np.sign(rng.standard_normal((90, 2)))
    model = TransferFunction(
        [[[0.5], [1.0, 0.3]], [[0.2, 1.0], [0.4]]], [[[1.0, 1.0, 3.0]] * 2] * 2
    )
    y = simulate(model, Record(u, np.zeros((90, 2)), t=t, intersample="foh"))
    y = y + 0.05 * rng.standard_normal(y.shape)
    y[rng.random(y.shape) < 0.05] = np.nan
    return Record(u, y, t=t, intersample="foh")


@pytest.mark.parametrize("name", STRUCTURES)
def test_pieces_of_units_add_up_to_that_of_all(name: str) -> None:
    """Near any point, and to rounding."""
    structure, records = STRUCTURES[name], list(fleets.units(5).values())
    n = len(structure.names())
    theta = np.array([1.1, 2.8, 0.4, 0.3])[:n] if n > 3 else np.array([1.1, 2.8, 0.4])
    parts = [local_pieces([record], structure, theta) for record in records]
    whole = local_pieces(records, structure, theta)
    for choice in whole:
        total = parts[0][choice]
        for part in parts[1:]:
            total = total + part[choice]
        one, other = total.triangles[0], whole[choice].triangles[0]
        np.testing.assert_allclose(
            one.T @ one, other.T @ other, rtol=1e-10, atol=1e-12 * float(np.sum(other**2))
        )
        assert total.counts == whole[choice].counts
        assert total.own == whole[choice].own


def test_derivatives_are_those_of_the_cost() -> None:
    """By central differences, where outputs, inputs and missing samples are several."""
    records = [two_outputs(np.random.default_rng(k)) for k in range(2)]
    structure = Structure(2, ((0, 1), (1, 0)), offset=True, initial_state="free")
    theta = np.array([1.2, 2.7, 0.45, 0.9, 0.35, 0.25, 1.1, 0.5])

    def rss(at: np.ndarray) -> np.ndarray:
        return next(iter(local_pieces(records, structure, at).values())).rss

    piece = next(iter(local_pieces(records, structure, theta).values()))
    step = 1e-6
    for k in range(theta.size):
        change = step * np.eye(theta.size)[k]
        slope = (rss(theta + change) - rss(theta - change)) / (2.0 * step)
        gradient = [-2.0 * one[:, k] @ one[:, -1] for one in piece.triangles]
        np.testing.assert_allclose(gradient, slope, rtol=1e-5, atol=1e-6)


@pytest.mark.slow
def test_a_fleet_of_two_inputs_and_outputs(tmp_path: Path) -> None:
    records = {str(k): two_outputs(np.random.default_rng(k)) for k in range(4)}
    structure = Structure(2, ((0, 1), (1, 0)), offset=True, initial_state="free")
    run = fleet.fit(records, structure, out=tmp_path, judge=False, progress=False)
    found = run.together()
    compare(found, by_one_machine(list(records.values()), structure), list(records.values()))


@pytest.mark.parametrize("name", ["free, with offsets", "open"])
@pytest.mark.fast("free, with offsets")
def test_the_joint_estimate(name: str, tmp_path: Path) -> None:
    structure, records = STRUCTURES[name], fleets.units(8, n=80)
    run = fleet.fit(records, structure, out=tmp_path, judge=False, progress=False, workers=2)
    found = run.together()
    alone = by_one_machine(list(records.values()), structure)
    compare(found, alone, list(records.values()))
    assert found.n_units == 8
    assert found.n_samples == alone.n_samples
    assert alone.nuisance[0].initial_state in found.nuisance
    assert "one model for 8 units" in found.summary()
    assert (tmp_path / "together.json").exists()


def compare(found: fleet.Together, alone, records: list[Record]) -> None:
    """Equal to 1e-10.

    `identify` ends where rounding hides what is left to gain, a millionth of a standard error away:
    what is compared is that end, and where two steps more of the same machine lead from there.
    """
    assert np.max(np.abs(found.theta - alone.theta) / alone.std) < 1e-6
    theta = alone.theta
    for _ in range(2):
        (piece,) = local_pieces(records, alone.structure, theta).values()
        weights = np.sqrt(piece.counts / piece.rss)[:, None, None]
        rows = np.vstack(piece.triangles * weights)
        theta = theta + np.linalg.lstsq(rows[:, :-1], rows[:, -1], rcond=None)[0]
    assert np.max(np.abs(found.theta - theta) / alone.std) < 1e-8
    np.testing.assert_allclose(found.theta, theta, rtol=1e-10)
    np.testing.assert_allclose(found.noise_variance, alone.noise_variance, rtol=1e-8)
    np.testing.assert_allclose(found.fit, alone.fit, rtol=1e-8)
    np.testing.assert_allclose(found.std, alone.std, rtol=1e-5)


def test_units_that_cannot_be_read_are_left_out_and_named(tmp_path: Path) -> None:
    records: dict[str, object] = dict(fleets.units(4, n=80))
    structure = STRUCTURES["at rest"]
    good = list(fleets.units(4, n=80).values())
    alone = by_one_machine(good, structure)
    run = fleet.fit(
        records | {"absent": "no/such.csv"}, structure, out=tmp_path, judge=False, progress=False
    )
    found = run.together()
    compare(found, alone, good)
    assert list(found.left_out) == ["absent"]
    assert "bad input" in found.left_out["absent"]
    assert "1 left out" in found.summary()


def test_what_cannot_be_added_up_is_refused(tmp_path: Path) -> None:
    records = fleets.units(2, n=80)
    quiet = {"judge": False, "progress": False}
    free = fleet.fit(records, Structure(2, 0, delay="free"), out=tmp_path / "a", **quiet)
    with pytest.raises(UnsupportedError, match="found delays that are to be estimated"):
        free.together()
    known = fleet.fit(records, Structure(2, 0, fixed={"a0": 3.0}), out=tmp_path / "b", **quiet)
    with pytest.raises(UnsupportedError, match="found knowledge of coefficients"):
        known.pool()
    none = fleet.fit({"absent": "no/such.csv"}, (2, 0), out=tmp_path / "c", **quiet)
    with pytest.raises(IdentifiabilityError, match="found no unit with an estimate"):
        none.together()


@pytest.mark.slow
def test_records_of_a_loop_are_not_added_up_as_if_it_were_open(tmp_path: Path) -> None:
    plain = fleets.units(2, n=80)
    loops = {
        key: Record(one.u, one.y, dt=0.1, intersample="zoh", reference=one.u)
        for key, one in plain.items()
    }
    quiet = {"judge": False, "progress": False}
    run = fleet.fit(loops, (2, 0), out=tmp_path / "a", **quiet)
    with pytest.raises(IdentifiabilityError, match=r"found references \(r\)"):
        run.together()
    with pytest.raises(UnsupportedError, match=r"found references \(set\)"):
        fleet.fit(plain, (2, 0), out=tmp_path / "b", references=["set"], pool=True, **quiet)


@pytest.mark.slow
@pytest.mark.judged
def test_units_without_a_response_are_told_with_what_comes_without_them(tmp_path: Path) -> None:
    """They count, as asked for, and their noise counts as that of all."""
    records = fleets.units(30, seed=5, n=200)
    rng = np.random.default_rng(6)
    for key in ("u0003", "u0011"):
        records[key] = records[key].with_outputs(rng.standard_normal((200, 1)))
    structure = STRUCTURES["at rest"]
    run = fleet.fit(records, structure, out=tmp_path / "out", workers=None, progress=False)
    found = run.together()
    assert found.without is not None
    assert set(found.without.units) == {"u0003", "u0011"}
    others = [record for key, record in records.items() if key not in found.without.units]
    joint = by_one_machine(others, structure)
    np.testing.assert_allclose(found.without.theta, joint.theta, atol=1e-6 * joint.std.max())
    assert np.all(found.std > 1.5 * found.without.std)
    assert "without 2 units that show no response" in found.summary()
    assert found.to_dict()["without"]["units"]["u0011"] == "no-response"


def test_what_is_refused_leaves_no_folder(tmp_path: Path) -> None:
    """Nor does a pattern that no file fits."""
    out = tmp_path / "out"
    for workers in (0, True, "nowhere", 1.5):
        with pytest.raises(OptionError):
            fleet.fit(fleets.units(1), (2, 0), out=out, workers=workers)
    with pytest.raises(DataError):
        fleet.fit(str(tmp_path / "*.csv"), (2, 0), out=out)
    assert not out.exists()
