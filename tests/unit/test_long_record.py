"""Records that are read in parts: the same numbers as in memory, whatever the parts are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import tridentify as tri
from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate
from tridentify.errors import (
    MissingColumnError,
    NonUniformTimeError,
    NotFiniteError,
    OptionError,
    SampleTypeError,
    UnreadableFileError,
    UnsupportedError,
)
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.likelihood.cost import evaluate
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import coefficients
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build
from tridentify.estimation.methods.long_record import Readings, poles_of_seed

pytestmark = pytest.mark.unjudged

DT = 0.01
SAME = 1e-6
"""Standard errors."""
WHITE = ThreeModel(noise="white")
Saved = Callable[[Record], Path]


def single(n: int, intersample: str = "zoh", delay: float = 0.0, seed: int = 3) -> Record:
    """One input, one output, white noise, a trim value and a start that is not at rest."""
    rng = np.random.default_rng(seed)
    u = 1.0 + np.repeat(rng.standard_normal(n // 50 + 1), 50)[:n]
    model = TransferFunction([2.0, 3.0], [1, 1.2, 9.0], delay=delay)
    y = simulate(model, Record(u, u, dt=DT, intersample=intersample))
    return Record(u, y + 0.5 * rng.standard_normal((n, 1)) + 0.7, dt=DT, intersample=intersample)


def several(n: int) -> Record:
    """Two inputs and two outputs, samples of either missing."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.standard_normal((n // 40 + 1, 2)), 40, axis=0)[:n]
    model = TransferFunction(
        [[[2.0, 3.0], [1.0, 0.3]], [[0.2, 5.0], [4.0]]], [[[1.0, 1.2, 9.0]] * 2] * 2
    )
    y = simulate(model, Record(u, np.zeros((n, 2)), dt=DT)) + 0.3 * rng.standard_normal((n, 2))
    y[rng.random(y.shape) < 0.05] = np.nan
    return Record(u, y, dt=DT)


@pytest.fixture
def saved(tmp_path: Path) -> Saved:
    def save(record: Record) -> Path:
        path = tmp_path / "run.npy"
        np.save(path, np.column_stack([record.u, record.y]))
        return path

    return save


def opened(path: Path, chunk: int) -> tri.LongRecord:
    return tri.open_record(path, inputs=["x[0]"], outputs=["x[1]"], dt=DT, chunk=chunk)


def in_parts(path: Path, record: Record, structure: Structure, chunk: int = 1000) -> Estimate:
    m, n = record.n_inputs, record.n_inputs + record.n_outputs
    opened = tri.open_record(
        path,
        inputs=[f"x[{k}]" for k in range(m)],
        outputs=[f"x[{k}]" for k in range(m, n)],
        dt=DT,
        intersample=record.intersample,
        chunk=chunk,
        stretch=4000,
    )
    return identify(opened, structure, WHITE)


def apart(estimate: Estimate, record: Record, structure: Structure) -> float:
    """Largest difference from the stationary point in memory [standard errors]."""
    found = estimate.structure
    choice = Nuisances(found.initial_state, bool(found.offset), bool(found.drift))
    problem = build([record], structure, choice)
    poles = problem.admissible(poles_of_seed(estimate))[0]
    for _ in range(4):
        point = evaluate(problem, poles)
        poles = point.step(0.0).poles
    return float(np.max(np.abs(coefficients(evaluate(problem, poles)) - estimate.theta)
                        / estimate.std))  # fmt: skip


CASES = {
    "held": (single(20_000), Structure(2, 1)),
    "joined by lines": (single(20_000, "foh"), Structure(2, 1)),
    "delayed by whole samples": (single(20_000, delay=0.05), Structure(2, 1, delay=0.05)),
    "delayed, held": (single(20_000, delay=0.037), Structure(2, 1, delay=0.037)),
    "delayed, lines": (
        single(20_000, "foh", 0.037),
        Structure(2, 1, delay=0.037, initial_state="rest", drift=True),
    ),
    "direct path": (single(20_000), Structure(2, 2, offset=True, initial_state="free")),
    "several channels with gaps": (several(20_000), Structure(2, 1)),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.fast("held", "delayed, lines", "several channels with gaps")
def test_numbers_are_those_in_memory(name: str, saved: Saved) -> None:
    """Coefficients, errors, fit, nuisance terms and fingerprint, from tiny parts."""
    record, structure = CASES[name]
    found = in_parts(saved(record), record, structure)
    held = identify(record, structure, WHITE)
    assert apart(found, record, structure) < SAME
    np.testing.assert_allclose(found.std, held.std, rtol=1e-4)
    np.testing.assert_allclose(found.cov, held.cov, rtol=1e-3, atol=1e-3 * held.cov.max())
    np.testing.assert_allclose(found.fit, held.fit, atol=1e-3)
    np.testing.assert_allclose(found.noise_variance, held.noise_variance, rtol=1e-6)
    np.testing.assert_allclose(found.nuisance[0].offset, held.nuisance[0].offset, atol=1e-4)
    np.testing.assert_allclose(
        found.nuisance[0].input_reference, held.nuisance[0].input_reference, atol=1e-12
    )
    assert found.structure == held.structure
    assert found.record_fingerprint == held.record_fingerprint
    assert found.n_samples == record.n_samples


@pytest.mark.slow
@pytest.mark.parametrize("chunk", [617, 4096, 50_000])
def test_the_size_of_the_parts_does_not_show(chunk: int, saved: Saved) -> None:
    record, structure = single(20_000, "foh", 0.137), Structure(2, 1, delay=0.137)
    path = saved(record)
    one, other = (in_parts(path, record, structure, size) for size in (10_000, chunk))
    assert np.max(np.abs(one.theta - other.theta) / one.std) < SAME
    np.testing.assert_allclose(one.cov, other.cov, rtol=1e-8)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_million_samples(saved: Saved) -> None:
    record, structure = single(1_000_000), Structure(2, 1)
    found = in_parts(saved(record), record, structure, 100_000)
    assert apart(found, record, structure) < SAME


@pytest.mark.slow
def test_coloured_noise_is_whitened_by_the_model_of_the_stretch(saved: Saved) -> None:
    plain, rng = single(20_000), np.random.default_rng(5)
    noise = np.zeros(20_000)
    for k, e in enumerate(rng.standard_normal(19_999)):
        noise[k + 1] = 0.9 * noise[k] + 0.2 * e
    record = Record(plain.u, plain.y + noise[:, None], dt=DT)
    opened = tri.open_record(
        saved(record), inputs=["x[0]"], outputs=["x[1]"], dt=DT, intersample="zoh", chunk=900,
        stretch=10_000,
    )  # fmt: skip
    found, held = identify(opened, (2, 1)), identify(record, (2, 1))
    assert found.noise_model[0].size
    np.testing.assert_allclose(found.std, held.std, rtol=0.1)
    np.testing.assert_allclose(found.noise_variance, held.noise_variance, rtol=1e-3)
    assert np.max(np.abs(found.theta - held.theta) / held.std) < 0.3


def test_parquet_and_time_in_the_file(tmp_path: Path) -> None:
    pl = pytest.importorskip("polars")
    record = single(20_000)
    path = tmp_path / "run.parquet"
    columns = {"t [ms]": 3e5 + 10.0 * np.arange(20_000), "u [V]": record.u[:, 0]}
    pl.DataFrame({**columns, "y": record.y[:, 0]}).write_parquet(path, row_group_size=3000)
    opened = tri.open_record(
        path, inputs=["u"], outputs=["y"], intersample="zoh", chunk=1700, stretch=4000
    )
    found = identify(opened, (2, 1), WHITE)
    assert (opened.t0, opened.dt) == pytest.approx((300.0, DT))
    assert found.units["u"] == "V"
    assert apart(found, record, Structure(2, 1)) < SAME
    part = opened.part(5_000, 5_010)
    assert part.t[0] == pytest.approx(350.0)
    assert np.array_equal(part.u, record.u[5_000:5_010])


@pytest.mark.slow
def test_what_was_judged_is_said(saved: Saved) -> None:
    record = CASES["several channels with gaps"][0]
    found = in_parts(saved(record), record, Structure(2, 1))
    (said,) = [one for one in found.findings if one.code == "judged-on-stretch"]
    assert "samples 0 to 3999" in said.message
    (missing,) = [one for one in found.findings if one.code == "missing-samples"]
    assert str(int(np.isnan(record.y).sum())) in missing.message


def test_a_stretch_that_moves_is_taken_where_the_beginning_does_not(saved: Saved) -> None:
    quiet = single(20_000)
    u, y = quiet.u.copy(), quiet.y.copy()
    u[:9_000] = 1.0
    y = simulate(TransferFunction([2.0, 3.0], [1, 1.2, 9.0]), Record(u, y, dt=DT))
    y += 0.1 * np.random.default_rng(0).standard_normal(y.shape)
    record = Record(u, y, dt=DT)
    found = in_parts(saved(record), record, Structure(2, 1, initial_state="rest"))
    assert "begun on samples 0 " not in found.trace.decisions[0]
    assert apart(found, record, Structure(2, 1, initial_state="rest")) < SAME


def test_progress_tells_the_time_that_remains(
    saved: Saved, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tridentify.estimation.methods.long_record.PAUSE", 0.0)
    said: list[str] = []
    opened = tri.open_record(
        saved(single(20_000)), inputs=["x[0]"], outputs=["x[1]"], dt=DT, stretch=4000, chunk=5000
    )
    identify(opened, (2, 1), WHITE, progress=said.append)
    assert any("reading 3 of the record (20,000 samples): 50 %" in one for one in said)
    assert all("left" in one for one in said if one.startswith("reading"))


# ------------------------------------------------------------------------------------ bad input
def test_a_file_that_was_cut_off_is_refused(saved: Saved, tmp_path: Path) -> None:
    path = saved(single(2_000))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(UnreadableFileError, match="cut off"):
        tri.open_record(path, inputs=["x[0]"], outputs=["x[1]"], dt=DT)
    pl = pytest.importorskip("polars")
    table = tmp_path / "cut.parquet"
    pl.DataFrame({"u": [0.0, 1.0] * 500, "y": [0.0, 1.0] * 500}).write_parquet(table)
    table.write_bytes(table.read_bytes()[:-40])
    with pytest.raises(UnreadableFileError, match="damaged"):
        tri.open_record(table, inputs=["u"], outputs=["y"], dt=DT)


def test_wrong_columns_and_options_are_refused(saved: Saved, tmp_path: Path) -> None:
    path = saved(single(2_000))
    with pytest.raises(MissingColumnError, match=r"x\[7\]"):
        tri.open_record(path, inputs=["x[7]"], outputs=["x[1]"], dt=DT)
    with pytest.raises(OptionError, match="chunk=0"):
        tri.open_record(path, inputs=["x[0]"], outputs=["x[1]"], dt=DT, chunk=0)
    with pytest.raises(OptionError, match="band-limited"):
        tri.open_record(path, inputs=["x[0]"], outputs=["x[1]"], dt=DT, intersample="band-limited")
    text = tmp_path / "run.csv"
    text.write_text("t,u,y\n0,0,0\n1,1,1\n")
    with pytest.raises(UnreadableFileError, match="parts"):
        tri.open_record(text, inputs=["u"], outputs=["y"])


def test_an_input_that_is_missing_deep_in_the_file_is_named_by_its_sample(tmp_path: Path) -> None:
    record = single(20_000)
    both = np.column_stack([record.u, record.y])
    both[13_579, 0] = np.nan
    np.save(tmp_path / "run.npy", both)
    opened = tri.open_record(
        tmp_path / "run.npy", inputs=["x[0]"], outputs=["x[1]"], dt=DT, chunk=1000, stretch=4000
    )
    with pytest.raises(NotFiniteError, match="sample 13579"):
        identify(opened, (2, 1))


def test_time_that_is_not_uniform_is_refused_where_it_is_not(tmp_path: Path) -> None:
    record = single(5_000)
    t = DT * np.arange(5_000)
    t[3_333:] += 0.5 * DT
    np.save(tmp_path / "run.npy", np.column_stack([t, record.u, record.y]))
    with pytest.raises(NonUniformTimeError, match="sample"):
        tri.open_record(
            tmp_path / "run.npy", inputs=["x[1]"], outputs=["x[2]"], time="x[0]", chunk=1000
        )


@pytest.mark.parametrize(
    ("structure", "method"),
    [
        (Structure(2, 1, delay="free"), ThreeModel()),
        (Structure(2, 1, fixed={"a0": 9.0}), ThreeModel()),
        (Structure(2, 1), ThreeModel(loss="huber")),
        (Structure(2, 1), tri.OutputError()),
    ],
)
def test_what_needs_memory_is_refused_in_one_line(
    structure: Structure, method: object, saved: Saved
) -> None:
    opened = tri.open_record(saved(single(5_000)), inputs=["x[0]"], outputs=["x[1]"], dt=DT)
    with pytest.raises(UnsupportedError, match="read in parts"):
        identify(opened, structure, method)  # type: ignore[arg-type]


def test_a_zarr_store(tmp_path: Path) -> None:
    zarr = pytest.importorskip("zarr", reason="zarr is not installed")
    record = single(20_000)
    store = zarr.open_group(str(tmp_path / "run.zarr"), mode="w")
    store.create_array("u", data=record.u[:, 0], chunks=(3000,))
    store.create_array("y", data=record.y[:, 0], chunks=(3000,))
    opened = tri.open_record(
        tmp_path / "run.zarr", inputs=["u"], outputs=["y"], dt=DT, intersample="zoh", stretch=4000
    )
    assert apart(identify(opened, (2, 1), WHITE), record, Structure(2, 1)) < SAME


def test_a_gap_of_time_is_told_where_it_is(tmp_path: Path) -> None:
    import polars as pl

    t = DT * np.delete(np.arange(50_000), np.arange(30_000, 30_100))
    path = tmp_path / "gap.parquet"
    pl.DataFrame({"t": t, "u": np.sin(t), "y": t}).write_parquet(path)
    for chunk in (7_000, 15_000, 1 << 18):
        with pytest.raises(
            NonUniformTimeError, match=r"step of time of 1\.01 s at row 3000\d"
        ) as e:
            tri.open_record(path, inputs=["u"], outputs=["y"], chunk=chunk)
        assert "where the others are 0.01 s" in str(e.value)


def test_time_that_drifts_without_a_gap_is_told(tmp_path: Path) -> None:
    import polars as pl

    t = DT * np.arange(50_000) ** 1.01
    path = tmp_path / "drift.parquet"
    pl.DataFrame({"t": t, "u": np.sin(t), "y": t}).write_parquet(path)
    with pytest.raises(NonUniformTimeError, match="time that drifts or scatters"):
        tri.open_record(path, inputs=["u"], outputs=["y"])


def test_the_name_of_a_channel_may_stand_alone(tmp_path: Path) -> None:
    import polars as pl

    path = tmp_path / "run.parquet"
    pl.DataFrame({"elevator": np.sin(np.arange(50.0)), "rate": np.arange(50.0)}).write_parquet(path)
    record = tri.open_record(path, inputs="elevator", outputs="rate", dt=DT)
    assert record.input_names == ("elevator",)
    assert record.output_names == ("rate",)


def test_what_needs_samples_in_memory_says_so(saved: Saved) -> None:
    record = opened(saved(single(5_000)), chunk=1_000)
    estimate = identify(record.part(0, 3_000), poles=2, zeros=1)
    for call in (tri.advise, tri.frequency_response, lambda r: tri.validate(estimate, r)):
        with pytest.raises(UnsupportedError, match=r"record\.part\(0, 100000\)"):
            call(record)
    for call in (estimate.predict, estimate.residual, tri.frame_from_record):
        with pytest.raises(SampleTypeError, match=r"found LongRecord .*record\.part\(a, b\)"):
            call(record)
    with pytest.raises(OptionError, match=r"found 10\.0 as the number of a sample"):
        record.part(10.0, 50)  # type: ignore[arg-type]


def test_the_time_that_remains_is_that_of_reading(
    saved: Saved, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    said: list[str] = []
    readings = Readings(opened(saved(single(4_000)), chunk=1_000), said.append)

    def once() -> None:
        for _ in readings.parts():
            clock[0] += 2.0

    once()
    clock[0] += 10_000.0  # the search on the stretch
    said.clear()
    once()
    assert said
    assert all(line.endswith(" s left") for line in said), said
