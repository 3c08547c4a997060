"""MATLAB files: what is found in their variables, in version 5 and 7.3 alike; what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tridentify import errors, list_channels, read_record

pytestmark = pytest.mark.unisolated

N = 6
T = 0.5 * np.arange(N)
U, Y = np.array([0.0, 1, 1, 0, 0, 1]), np.arange(N) ** 2.0


def column(values: np.ndarray) -> np.ndarray:
    return values[:, np.newaxis]


VARIABLES = {
    "t": column(T),
    "u": U[np.newaxis, :],
    "y": np.column_stack([Y, -Y]),
    "g": 9.81,
    "note": "a flight",
    "log": {"imu": {"q": column(Y)}},
    "z": {
        "u": column(U),
        "y": np.column_stack([Y, -Y]),
        "Ts": 500.0,
        "Tstart": 1000.0,
        "InputName": ["elevator"],
        "OutputName": ["q", "alpha"],
        "InputUnit": ["deg"],
        "OutputUnit": ["deg/s", "deg"],
        "TimeUnit": "milliseconds",
    },
    "height": {"Time": column(T + 1), "Data": column(Y), "DataInfo": {"Units": "m"}},
    "cube": {"Time": column(T), "Data": Y.reshape(1, 1, N)},
    "out": {"time": column(T), "signals": {"values": column(Y), "label": "speed"}},
}


@pytest.fixture(scope="module", params=["5", "7.3"])
def path(request: pytest.FixtureRequest, write, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("matlab") / "flight.mat"
    variables = dict(VARIABLES)
    if request.param == "7.3":
        pytest.importorskip("h5py", reason="needs h5py, of the extra tridentify[matlab]")
        variables.pop("cube")  # the test's writer of 7.3 turns matrices only
        return write.matlab73(target, variables)
    return write.matlab5(target, variables)


def test_what_is_found(path: Path) -> None:
    found = {c.header: (c.name, c.unit, c.clock, c.samples) for c in list_channels(path)}
    assert found.pop("cube", ("cube", "", "cube", N)) == ("cube", "", "cube", N)
    assert found == {
        "t": ("t", "", "", N),
        "u": ("u", "", "", N),
        "y(1)": ("y(1)", "", "", N),
        "y(2)": ("y(2)", "", "", N),
        "log.imu.q": ("log.imu.q", "", "", N),
        "z.elevator": ("elevator", "deg", "z", N),
        "z.q": ("q", "deg/s", "z", N),
        "z.alpha": ("alpha", "deg", "z", N),
        "height": ("height", "m", "height", N),
        "out.speed": ("speed", "", "out", N),
    }


def test_plain_arrays(path: Path) -> None:
    record = read_record(path, time="t", inputs=["u"], outputs=["y(2)", "log.imu.q"])
    np.testing.assert_array_equal(record.u[:, 0], U)
    np.testing.assert_array_equal(record.y, np.column_stack([-Y, Y]))
    assert record.dt == 0.5


def test_a_struct_like_iddata_has_time_names_and_units(path: Path) -> None:
    record = read_record(path, inputs=["elevator"], outputs=["q", "z.alpha"])
    np.testing.assert_allclose(record.t, 1.0 + T)
    np.testing.assert_array_equal(record.u[:, 0], U)
    np.testing.assert_array_equal(record.y, np.column_stack([Y, -Y]))
    assert dict(record.units) == {"elevator": "deg", "q": "deg/s", "alpha": "deg"}


@pytest.mark.fast("7.3")
def test_timeseries_come_onto_one_time_base(path: Path) -> None:
    record = read_record(path, time="t", inputs=["u"], outputs=["height"])
    np.testing.assert_allclose(record.t, [0, 0.5, 1, 1.5, 2, 2.5])
    np.testing.assert_array_equal(record.y[:, 0], [np.nan, np.nan, *Y[:4]])
    assert read_record(path, time="t", inputs=["u"], outputs=["speed"]).y[2, 0] == 4.0


def test_samples_along_the_third_dimension(write, tmp_path: Path) -> None:
    path = write.matlab5(tmp_path / "a.mat", {"cube": VARIABLES["cube"], "u": VARIABLES["height"]})
    record = read_record(path, inputs=["u"], outputs=["cube"])
    np.testing.assert_allclose(record.t, [1, 1.5, 2, 2.5, 3, 3.5])
    np.testing.assert_array_equal(record.y[:, 0], [*Y[2:], np.nan, np.nan])


def test_complex_numbers_and_strange_units_are_refused(tmp_path: Path) -> None:
    from scipy import io

    io.savemat(
        tmp_path / "a.mat",
        {
            "c": column(U) * 1j,
            "y": column(Y),
            "w": {"Time": column(T), "Data": column(Y), "TimeUnit": "fortnights"},
        },
    )
    with pytest.raises(errors.TextInColumnError, match="complex128 in 'c'"):
        read_record(tmp_path / "a.mat", dt=1.0, inputs=["c"], outputs=["y"])
    with pytest.raises(errors.UnitError, match="'fortnights' of the time of 'w'"):
        read_record(tmp_path / "a.mat", time="y", inputs=["y"], outputs=["w"])
    with pytest.raises(errors.SamplingError, match=r"no time of 'y'.*name its column of time"):
        read_record(tmp_path / "a.mat", dt=1.0, inputs=["y"], outputs=["w"])


@pytest.mark.slow
@pytest.mark.isolated
def test_deep_nesting_ends_and_does_not_crash(write, tmp_path: Path) -> None:
    nested: dict[str, object] = {"y": column(Y)}
    for _ in range(25):
        nested = {"s": nested}
    path = write.matlab5(tmp_path / "deep.mat", {"u": column(U), "deep": nested})
    with pytest.raises(errors.MissingColumnError, match="expected one of u"):
        read_record(path, dt=1.0, inputs=["u"], outputs=["y"])


# ------------------------------------------------------------------------------- version 7.3 only
@pytest.fixture
def h5py():
    return pytest.importorskip("h5py", reason="needs h5py, of the extra tridentify[matlab]")


def test_a_struct_that_holds_itself_ends(write, h5py, tmp_path: Path) -> None:
    path = write.matlab73(tmp_path / "loop.mat", {"u": column(U), "s": {"y": column(Y)}})
    with h5py.File(path, "r+") as file:
        file["s"]["s"] = file["s"]
    names = [channel.header for channel in list_channels(path)]
    assert {"u", "s.y", "s.s.y"} <= set(names)
    assert len(names) < 20


def test_an_object_of_a_class_is_named_and_refused(write, h5py, tmp_path: Path) -> None:
    path = write.matlab73(tmp_path / "object.mat", {"u": column(U), "z": column(Y)})
    with h5py.File(path, "r+") as file:
        file["z"].attrs["MATLAB_class"] = np.bytes_("iddata")
    with pytest.raises(errors.ForeignObjectError, match=r"class 'iddata' as 'z'.*as a struct"):
        read_record(path, dt=1.0, inputs=["u"], outputs=["z"])


@pytest.mark.parametrize("kind", ["link", "external", "virtual"])
@pytest.mark.isolated
@pytest.mark.fast("virtual")
def test_nothing_outside_the_file_is_read(write, h5py, tmp_path: Path, kind: str) -> None:
    secret = tmp_path / "secret.bin"
    secret.write_bytes(Y.tobytes())
    other = tmp_path / "other.h5"
    with h5py.File(other, "w") as file:
        file["y"] = Y
    path = write.matlab73(tmp_path / "outside.mat", {"u": column(U)})
    with h5py.File(path, "r+") as file:
        if kind == "link":
            file["y"] = h5py.ExternalLink("other.h5", "/y")
        elif kind == "external":
            file.create_dataset("y", (N,), "f8", external=[(str(secret), 0, N * 8)])
        else:
            layout = h5py.VirtualLayout((N,), "f8")
            layout[:] = h5py.VirtualSource(str(other), "y", (N,))
            file.create_virtual_dataset("y", layout)
        assert kind == "link" or file["y"][1] == 1.0
    with pytest.raises(errors.ForeignObjectError, match="elsewhere' as 'y'"):
        read_record(path, dt=1.0, inputs=["u"], outputs=["y"])


@pytest.mark.isolated
def test_a_dataset_that_claims_more_than_memory_is_refused(write, h5py, tmp_path: Path) -> None:
    path = write.matlab73(tmp_path / "bomb.mat", {"u": column(U)})
    with h5py.File(path, "r+") as file:
        huge = file.create_dataset("y", (1, 2**40), "f8", chunks=(1, 2**16), compression="gzip")
        huge.attrs["MATLAB_class"] = np.bytes_("double")
    assert path.stat().st_size < 100_000
    with pytest.raises(errors.FileTooLargeError, match=r"8\.19e\+03 GiB of samples"):
        read_record(path, dt=1.0, inputs=["u"], outputs=["y"])


@pytest.mark.parametrize("version", ["matlab5", "matlab73"])
def test_a_reference_is_a_variable_beside_the_others(write, version: str, tmp_path: Path) -> None:
    if version == "matlab73":
        pytest.importorskip("h5py", reason="needs h5py, of the extra tridentify[matlab]")
    t, r = 0.1 * np.arange(5), np.array([0.0, 1, 1, 2, 2])
    variables = {"t": t, "u": t**2, "y": -t, "r": r}
    columns = {name: values[:, np.newaxis] for name, values in variables.items()}
    path = getattr(write, version)(tmp_path / "loop.mat", columns)
    record = read_record(path, inputs=["u"], outputs=["y"], references=["r"])
    assert record.reference_names == ("r",)
    np.testing.assert_array_equal(record.reference[:, 0], r)
