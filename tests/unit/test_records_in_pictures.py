"""Pictures, tables and reports of records as they are: gaps, outliers, delays, draws, knowledge."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, plots, simulate
from tridentify.estimation.answer.estimate import Status
from tridentify.plots.style import MAX_POINTS, course
from tridentify.report import write_report
from tridentify.report.settings import settings_table
from tridentify.uncertainty import derived, sample, sampled_derived, sampled_response_band

pytestmark = pytest.mark.unjudged

DT = 0.02
SYSTEM = TransferFunction([2.0, 3.0], [1.0, 3.0, 9.0])
UNITS = {"elevator": "rad", "q": "rad/s"}


def flown(t, *, noise=1e-3, model=SYSTEM, seed=0, name="flight", edit=None):
    """A record of random steps with noise; `edit` changes its outputs."""
    rng = np.random.default_rng(seed)
    u = 0.05 * np.repeat(np.sign(rng.standard_normal(len(t) // 25 + 1)), 25)[: len(t)]
    channels = {"input_names": ["elevator"], "output_names": ["q"], "units": UNITS}
    y = simulate(model, Record(u, u, t=t)) + noise * rng.standard_normal((len(t), 1))
    if edit is not None:
        edit(y)
    return Record(u, y, t=t, name=name, **channels)


@pytest.fixture(scope="module")
def gapped():
    """Uneven time with a gap of two seconds, and a free delay."""
    t = DT * np.arange(500) + DT * np.random.default_rng(1).uniform(-0.4, 0.4, 500)
    t[250:] += 2.0
    late = TransferFunction([2.0, 3.0], [1.0, 3.0, 9.0], delay=0.15)
    record = flown(t, model=late)
    return record, identify(record, Structure(2, 1, delay="free"), throw=False)


@pytest.fixture(scope="module")
def spiky():
    def spikes(y):
        y[50:550:25] += 0.08 * (-1.0) ** np.arange(20)[:, None]

    record = flown(DT * np.arange(600), edit=spikes)
    return record, identify(record, Structure(2, 1), ThreeModel(loss="student"))


@pytest.fixture(scope="module")
def vague():
    u = np.repeat([0.0, 1.0, -1.0, 1.0, -1.0], 20)
    y = simulate(TransferFunction([3.0], [1.0, 1.0, 3.0]), Record(u, u, dt=0.05))
    noise = 0.6 * np.random.default_rng(0).standard_normal(y.shape)
    record = Record(u, y + noise, dt=0.05)
    estimate = identify(record, Structure(2, 0))
    assert estimate.status is Status.POSTERIOR_MEAN
    return record, estimate


# ------------------------------------------------------------------------------------------- gaps
@pytest.mark.slow
def test_no_line_is_drawn_across_a_gap(gapped):
    record, estimate = gapped
    fit = plots.plot_fit(estimate, record)[0].get_lines()
    residual = plots.plot_residual(estimate, record)[0].get_lines()[-1]
    for line in (*fit, residual, plots.plot_record(record)[0].get_lines()[0]):
        broken = np.isnan(line.get_ydata())
        assert line.get_xdata()[broken] == pytest.approx([record.t[249]])


def test_single_missing_samples_are_bridged_so_that_slow_outputs_are_seen():
    t = 0.01 * np.arange(3000)
    values = np.where(np.arange(3000) % 5 == 0, np.sin(t), np.nan)
    shown_t, shown = course(t, values)
    assert shown_t == pytest.approx(t[::5])
    assert np.isfinite(shown).all()


def test_a_long_course_keeps_its_gaps():
    t = 0.01 * np.arange(50_000)
    t[20_000:] += 30.0
    shown_t, shown = course(t, np.sin(t))
    assert shown.size <= MAX_POINTS + 1
    (gap,) = np.flatnonzero(np.isnan(shown))
    assert shown_t[gap - 1] <= 200.0 < 229.9 < shown_t[gap + 1]


def test_a_channel_that_is_missing_altogether_in_a_picture_is_no_fault():
    t, values = course(np.arange(4.0), np.full(4, np.nan))
    assert t.size == values.size == 0


# --------------------------------------------------------------------------------------- outliers
def test_outliers_are_marked_and_do_not_squeeze_the_rest(spiky):
    record, estimate = spiky
    ax = plots.plot_fit(estimate, record)[0]
    marked = ax.get_lines()[-1]
    assert marked.get_label() == "outlier"
    where = np.sort(estimate.outliers[:, 2]).astype(int)
    assert set(range(50, 550, 25)) <= set(where.tolist())
    assert np.sort(marked.get_xdata()) == pytest.approx(record.t[where])
    series, correlogram = plots.plot_residual(estimate, record)
    assert series.get_ylim()[1] < 0.02
    up, down = series.get_lines()[-2:]
    assert up.get_xdata().size + down.get_xdata().size == len(where)
    assert np.all(np.abs(up.get_ydata()) < series.get_ylim()[1])
    assert series.get_legend().get_texts()[0].get_text() == f"{len(where)} outliers"
    assert np.abs(np.array(correlogram.get_ylim())).max() < 0.5


# ---------------------------------------------------------------------------------- posterior mean
def test_summary_tables_and_draws_tell_the_same(vague):
    _, estimate = vague
    drawn = sampled_derived(sample(estimate, n_draws=len(estimate.draws)))
    text = estimate.summary()
    for item, other in zip(derived(estimate), drawn, strict=True):
        assert item.value == other.value
        assert item.interval() == pytest.approx((other.low, other.high))
        assert item.std == pytest.approx(other.spread, rel=0.1)
        line = next(line for line in text.splitlines() if line.startswith(item.name))
        numbers = [float(n) for n in re.findall(r"-?[\d.]+(?:e[-+]\d+)?", line)][:4]
        assert numbers == pytest.approx(
            [item.value, item.std, *item.interval()], abs=0.06 * item.std
        )


def test_without_draws_derived_quantities_are_those_to_first_order(gapped):
    _, estimate = gapped
    found = [(p.name, p.value, p.std, p.unit) for p in estimate.derived()]
    assert found == list(estimate.derived_rows())


def test_figures_of_a_posterior_mean_show_its_draws(vague):
    _, estimate = vague
    omega = np.array([0.5, 1.0, 2.0])
    band = plots.plot_bode(estimate, omega=omega)[0].collections[0].get_paths()[0].vertices
    expected = sampled_response_band(sample(estimate), omega).magnitude_high[:, 0, 0]
    assert set((20 * np.log10(expected)).round(9)) <= set(band[:, 1].round(9))
    (ax,) = plots.plot_pole_zero(estimate)
    assert max(len(line.get_xdata()) for line in ax.get_lines()) >= 500
    assert not ax.patches[:-1]  # no ellipse, only the grey half-plane


def test_ellipses_lie_within_the_frame_of_poles_and_zeros():
    u = np.sign(np.sin(np.arange(200) ** 1.5))
    y = simulate(TransferFunction([3.0], [1.0, 1.0, 3.0]), Record(u, u, dt=0.1))
    y = y + 0.3 * np.random.default_rng(0).standard_normal(y.shape)
    estimate = identify(Record(u, y, dt=0.1), Structure(2, 0), ThreeModel(finish="likelihood"))
    (ax,) = plots.plot_pole_zero(estimate)
    low, high = ax.get_ylim()
    ellipses = [line.get_ydata() for line in ax.get_lines() if len(line.get_xdata()) > 50]
    assert len(ellipses) == 2
    assert all(low < curve.min() <= curve.max() < high for curve in ellipses)


# --------------------------------------------------------------------------------------- the words
def test_a_delay_is_told_with_its_standard_error(gapped):
    record, estimate = gapped
    assert re.search(r"exp\(-\(0\.1\d+ \+/- 0\.00\d+\) s\) x", estimate.model_text())
    rows = dict(settings_table(estimate, [record]))
    assert re.fullmatch(r"estimated: delay = 0\.1\d+ \+/- 0\.00\d+ s", rows["delay"])
    assert "not uniform" in rows["record"]


@pytest.mark.slow
@pytest.mark.undrawn
def test_settings_name_loss_outliers_experiments_and_channels(spiky, tmp_path):
    record, estimate = spiky
    rows = dict(settings_table(estimate, [record]))
    assert rows["loss"].startswith("student; outliers beyond four standard deviations: q: 2")
    records = [flown(DT * np.arange(n), seed=n, name=f"run {n}") for n in (400, 300)]
    both = identify(records, Structure(2, 1, fixed={"a0": 9.0}, bounds={"b1": (None, 1.8)}))
    rows = dict(settings_table(both, records))
    assert rows["experiment 1"].startswith("run 400: 0 s to 7.98 s (400 samples), step 0.02 s")
    assert rows["experiment 2"].startswith("run 300: 0 s to 5.98 s (300 samples)")
    assert rows["fixed"] == "a0 = 9"
    assert rows["bounds"] == "b1 <= 1.8"
    page = write_report(both, records, tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<h1>q from elevator</h1>" in page
    assert "run 400, run 300" in page
    assert "2 experiments \N{MIDDLE DOT} 700 samples every 0.02 s" in page
    for said in ("fixed", "at bound"):
        assert f"<td>{said}</td>" in page
        assert re.search(rf"\s{said}\s", both.summary())
    cells = re.findall(r"<td[^>]*>(.*?)</td>", page)
    assert "nan" not in cells


def test_orders_of_each_channel_are_named():
    u = np.random.default_rng(0).choice([-1.0, 1.0], (40, 2)).repeat(10, axis=0)
    model = TransferFunction([[[2.0], [5.0]]], [[[1.0, 3.0, 9.0], [1.0, 2.0]]])
    y = simulate(model, Record(u, u[:, 0], dt=0.05))
    y = y + 1e-3 * np.random.default_rng(1).standard_normal(y.shape)
    record = Record(u, y, dt=0.05, input_names=["e", "r"], output_names=["q"])
    rows = dict(settings_table(identify(record, Structure([[2, 1]], 0)), [record]))
    assert rows["poles"] == "q / e: 2, q / r: 1"


def test_passes_before_a_delay_is_estimated_along_are_drawn_and_listed(gapped):
    from dataclasses import replace

    from tridentify.report.tables import course_tables

    _, estimate = gapped
    last = estimate.trace.passes[-1]
    early = replace(last, number=0, theta=estimate.theta[:-1] * 1.1)
    changed = replace(estimate, trace=replace(estimate.trace, passes=(early, last)))
    lines = {
        line.get_label(): line.get_ydata() for line in plots.plot_convergence(changed)[0].lines
    }
    assert all(np.isfinite(lines[name][0]) for name in ("a1", "a0", "b1", "b0"))
    table = next(t for t in course_tables(changed) if t.heading.startswith("Coefficients after"))
    assert {len(row) for row in table.rows} == {len(table.titles)}
    assert table.rows[0][-2] == ""
