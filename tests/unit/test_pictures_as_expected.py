"""Pictures as people expect them: seen by pyplot, of one or several models, with clear refusals."""

from __future__ import annotations

import subprocess
import sys
import threading

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure

import tridentify
from tridentify import Record, TransferFunction, compare, plots, simulate, validate
from tridentify.errors import ChannelNameError, OptionError, SampleTypeError, TridentifyError
from tridentify.report import save_figures, write_report
from tridentify.writing.views import unseen

SEVERAL = {
    "bode": (plots.plot_bode, 2),
    "step": (plots.plot_step, 1),
    "impulse": (plots.plot_impulse, 1),
    "nyquist": (plots.plot_nyquist, 1),
    "pole_zero": (plots.plot_pole_zero, 1),
}


def of(case):
    """A stiffer plant of the same channels, with standard errors or without."""
    model = case.estimate.model
    den = model.den[0][0] * np.array([1.0, 1.0, 2.0])
    names = {"input_names": model.input_names, "output_names": model.output_names}
    return TransferFunction(model.num[0][0], den, **names)


# --------------------------------------------------------------------------------- pyplot
@pytest.mark.slow
@pytest.mark.parametrize(
    "draw",
    [
        lambda case: plots.plot_record(case.record),
        lambda case: plots.plot_fit(case.estimate, case.record),
        lambda case: plots.plot_residual(case.estimate, case.record),
        lambda case: plots.plot_convergence(case.estimate),
        lambda case: plots.plot_comparison([case.estimate]),
        lambda case: compare(case.estimate, case.record).plot(),
        *(lambda case, f=f: f(case.estimate) for f, _ in SEVERAL.values()),
    ],
)
def test_pyplot_has_the_figure(single, draw, tmp_path):
    assert plt.get_fignums() == []
    picture = draw(single)
    assert isinstance(picture, plots.Panels)
    assert plt.gcf() is picture.figure
    assert len(plt.get_fignums()) == 1
    plt.savefig(tmp_path / "a.png")
    picture.savefig(tmp_path / "b.png")
    one, other = (plt.imread(tmp_path / name) for name in ("a.png", "b.png"))
    # the layout settles by parts of a pixel
    assert one.shape == other.shape
    assert np.mean(one < 0.9) == pytest.approx(np.mean(other < 0.9), rel=0.05)
    assert np.ptp(one) > 0.5


def test_given_axes_open_no_figure(single):
    figure, axes = plt.subplots(2)
    picture = plots.plot_bode(single.estimate, axes=axes)
    assert list(picture) == list(axes)
    assert picture.figure is figure
    assert len(plt.get_fignums()) == 1
    part = Figure().subfigures(1, 2)[0]
    assert plots.plot_step(single.estimate, axes=part.subplots()).figure is part.figure


@pytest.mark.slow
@pytest.mark.undrawn
def test_what_goes_into_files_stays_out_of_pyplot(single, tmp_path):
    write_report(single.estimate, single.record, tmp_path / "r.html", figures=tmp_path)
    save_figures(single.estimate, single.record, tmp_path)
    with unseen():
        plots.plot_bode(single.estimate)
    assert plt.get_fignums() == []
    plots.plot_bode(single.estimate)
    assert len(plt.get_fignums()) == 1


def test_another_thread_opens_no_window(single):
    found = []
    thread = threading.Thread(target=lambda: found.append(plots.plot_bode(single.estimate)))
    thread.start()
    thread.join()
    assert len(found[0]) == 2
    assert plt.get_fignums() == []


NOTEBOOK = """
import matplotlib
matplotlib.use({backend!r})
from IPython.core.interactiveshell import InteractiveShell
from IPython.utils.capture import capture_output
shell = InteractiveShell.instance()
shell.run_cell("from tridentify import TransferFunction, plots")
if {inline}:
    from IPython.core.pylabtools import select_figure_formats
    from matplotlib_inline.backend_inline import flush_figures
    matplotlib.use("module://matplotlib_inline.backend_inline")
    matplotlib.interactive(True)
    select_figure_formats(shell, {{"png"}})
    shell.events.register("post_execute", flush_figures)
with capture_output() as caught:
    shell.run_cell("plots.plot_bode(TransferFunction([1.0], [1.0, 1.0]))")
pictures = [one for one in caught.outputs if any(k.startswith("image/") for k in one.data)]
shell.run_cell("import matplotlib.pyplot as plt; left = plt.get_fignums()")
print(len(pictures), len(caught.outputs), "Axes" in caught.stdout, shell.user_ns["left"])
"""


@pytest.mark.slow
@pytest.mark.parametrize(("backend", "inline"), [("Agg", False), ("Agg", True)])
def test_a_notebook_shows_the_picture_once_and_no_list(backend, inline):
    pytest.importorskip("IPython")
    done = subprocess.run(
        [sys.executable, "-c", NOTEBOOK.format(backend=backend, inline=inline)],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "1 1 False []", done.stdout + done.stderr


# --------------------------------------------------------------------------- one or several
@pytest.mark.parametrize("name", SEVERAL)
@pytest.mark.fast("step", "impulse", "pole_zero")
def test_several_models_have_names_and_colours_of_their_own(single, name):
    draw, count = SEVERAL[name]
    picture = draw({"found": single.estimate, "stiff": of(single)})
    assert len(picture) == count
    handles, labels = picture[0].get_legend_handles_labels()
    colours = {label: handle.get_color() for handle, label in zip(handles, labels, strict=True)
               if label in ("found", "stiff")}  # fmt: skip
    assert len(set(colours.values())) == 2
    listed = draw([single.estimate, of(single)], names=["found", "stiff"])
    assert listed[0].get_legend_handles_labels()[1] == labels
    picture.figure.draw_without_rendering()


@pytest.mark.parametrize("name", SEVERAL)
@pytest.mark.fast("impulse", "pole_zero", "bode")
def test_a_transfer_function_alone_is_drawn_without_a_band(single, name):
    draw, count = SEVERAL[name]
    model = single.estimate.model
    picture = draw(model)
    assert len(picture) == count
    assert not picture[0].collections
    if name in ("bode", "nyquist"):
        drawn, expected = (
            next(one for one in p[0].get_lines() if one.get_label() == "model").get_ydata()
            for p in (picture, draw(single.estimate))
        )
        near = np.isin(np.round(expected, 6), np.round(drawn, 6))
        assert np.mean(near) > 0.5
    roots = TransferFunction([1.0], [1.0, 2.0, 5.0])
    (ax,) = plots.plot_pole_zero(roots)
    assert sorted(ax.get_lines()[0].get_ydata()) == pytest.approx([-2.0, 2.0])


def test_steps_of_a_model_are_those_of_its_formula():
    t = np.linspace(0.0, 3.0, 7)
    (ax,) = plots.plot_step(TransferFunction([3.0], [1.0, 2.0], delay=0.5), t)
    expected = np.where(t >= 0.5, 1.5 * (1 - np.exp(-2.0 * np.maximum(t - 0.5, 0.0))), 0.0)
    line = next(one for one in ax.get_lines() if one.get_label() == "model")
    assert line.get_ydata() == pytest.approx(expected)


def test_models_of_different_channels_are_refused(single, double):
    with pytest.raises(ChannelNameError, match=r"found models of .*expected the same inputs"):
        plots.plot_bode([single.estimate, double.estimate])
    # a model whose channels have no names fits any of as many
    plots.plot_bode([single.estimate, TransferFunction([1.0], [1.0, 1.0])])


@pytest.mark.parametrize("name", ["bode", "step", "impulse"])
def test_a_second_call_on_the_same_axes_overlays(single, name):
    draw, _ = SEVERAL[name]
    axes = draw(single.estimate, names=["found"])
    before = axes[0].get_ylim()
    draw(of(single), names=["stiff"], axes=axes)
    handles, labels = axes[0].get_legend_handles_labels()
    colours = {label: handle.get_color() for handle, label in zip(handles, labels, strict=True)
               if label in ("found", "stiff")}  # fmt: skip
    assert len(set(colours.values())) == 2
    assert axes[0].get_ylim()[0] <= before[0]
    assert axes[0].get_ylim()[1] >= before[1]
    assert len(plt.get_fignums()) == 1


def test_phases_of_a_negative_gain_begin_alike(double):
    for _, phase in np.reshape(list(plots.plot_bode(double.estimate)), (2, 2)):
        start = phase.get_lines()[0].get_ydata()[0]
        assert -225.0 <= start < 135.0


def test_a_fit_on_another_record_says_what_is_held(single):
    other = Record(
        single.record.u, single.record.y + 1.0, dt=0.02, units=single.record.units,
        input_names=single.record.input_names, output_names=single.record.output_names,
    )  # fmt: skip
    title = plots.plot_fit(single.estimate, other)[0].get_title(loc="left")
    assert "held" in title
    assert "compare" in title
    estimate = tridentify.identify(single.record, tridentify.Structure(2, 0))
    assert "held" not in plots.plot_fit(estimate, single.record)[0].get_title(loc="left")
    labels = plots.plot_fit({"a": estimate, "b": single.estimate}, single.record)[0]
    assert labels.get_legend_handles_labels()[1] == ["recorded", "a", "b"]


# --------------------------------------------------------------------------------- refusals
@pytest.mark.parametrize(
    "call",
    [
        lambda e, r: plots.plot_fit(r, e),
        lambda e, r: plots.plot_fit(e.model, r),
        lambda e, r: plots.plot_fit(e, e),
        lambda e, r: plots.plot_fit(e, r, experiment=3),
        lambda e, r: plots.plot_residual(r, e),
        lambda e, r: plots.plot_residual([e, e], r),
        lambda e, r: plots.plot_record(e),
        lambda e, r: plots.plot_convergence(e.model),
        lambda e, r: plots.plot_convergence([e, e]),
        lambda e, r: plots.plot_cost_surface(r, e),
        lambda e, r: plots.plot_residual_tests(e),
        lambda e, r: plots.plot_selection(e),
        lambda e, r: plots.plot_hankel(e),
        lambda e, r: plots.plot_frequency_response(r),
        lambda e, r: plots.plot_excitation(e),
        lambda e, r: plots.plot_spectrum(e),
        lambda e, r: plots.plot_excitation(tridentify.excitation.doublet(0.1, 0.5, dt=0.1), r),
        lambda e, r: plots.plot_trajectory(e),
        lambda e, r: plots.plot_comparison(r),
        lambda e, r: plots.plot_comparison([e, r]),
        lambda e, r: plots.plot_bode(r),
        lambda e, r: plots.plot_bode(e, e),
        lambda e, r: plots.plot_bode(e, "fast"),
        lambda e, r: plots.plot_bode([]),
        lambda e, r: plots.plot_bode(e, axes=3),
        lambda e, r: plots.plot_bode(None),
        lambda e, r: plots.plot_step(r),
        lambda e, r: plots.plot_step(e, r),
        lambda e, r: plots.plot_impulse("model.json"),
        lambda e, r: plots.plot_nyquist(e, e),
        lambda e, r: plots.plot_pole_zero({"a": 1}),
        lambda e, r: simulate(r, e.model),
        lambda e, r: simulate(e, e),
        lambda e, r: validate(r, e),
    ],
)
def test_wrong_arguments_get_one_line_of_the_package(single, call):
    with pytest.raises(TridentifyError) as caught:
        call(single.estimate, single.record)
    text = str(caught.value)
    assert text.startswith("found ")
    assert "expected" in text
    assert "\n" not in text
    assert len(text) < 300
    assert isinstance(caught.value, (SampleTypeError, OptionError))


def test_an_estimate_is_simulated_by_its_model(single):
    found = simulate(single.estimate, single.record)
    assert found == pytest.approx(simulate(single.estimate.model, single.record))


def test_arguments_in_the_order_of_other_packages(single):
    omega, t = np.array([0.5, 2.0]), np.array([0.0, 1.0, 2.0])
    assert plots.plot_bode(single.estimate, omega)[0].get_lines()[0].get_xdata() == pytest.approx(
        omega
    )
    (ax,) = plots.plot_step(single.estimate, t)
    assert ax.get_xlim() == (0.0, 2.0)


# ----------------------------------------------------------------- what an estimate can be asked
@pytest.mark.slow
@pytest.mark.undrawn
def test_an_estimate_and_a_model_draw_themselves(single, tmp_path):
    estimate, model = single.estimate, single.estimate.model
    for one in (estimate, model):
        for name, (_, count) in SEVERAL.items():
            assert len(getattr(one, name)()) == count
    assert len(estimate.bode([1.0, 2.0], level=0.9)) == 2
    assert len(estimate.plot(single.record)) == 2
    assert "<svg" in estimate.report(tmp_path / "page.html", single.record).read_text()


@pytest.mark.slow
def test_an_estimate_writes_its_report_of_what_it_is_given(single, tmp_path):
    estimate = single.estimate
    first = estimate.report(tmp_path / "bare.html")
    second = estimate.report(tmp_path / "full.html", single.record, title="A flight")
    turned = estimate.report(single.record, tmp_path / "turned.html")
    assert "A flight" in second.read_text()
    sizes = [path.stat().st_size for path in (first, second, turned)]
    assert sizes[0] < sizes[1]
    assert sizes[0] < sizes[2]


def test_an_estimate_as_a_table(single):
    frame = single.estimate.to_frame()
    assert list(frame.index) == ["a1", "a0", "b0"]
    assert list(frame.columns) == ["value", "std", "relative", "low", "high", "unit"]
    assert frame.value.to_numpy() == pytest.approx(single.estimate.theta)
    assert frame["std"].to_numpy() == pytest.approx(single.estimate.std)
    assert (frame.high - frame.low).to_numpy() == pytest.approx(2 * 1.959964 * single.estimate.std)
    narrow = single.estimate.to_frame(level=0.5)
    assert (narrow.high < frame.high).all()
    assert frame.loc["a0", "unit"] == "1/s^2"


def test_an_estimate_for_other_packages(single):
    pytest.importorskip("control")
    system = single.estimate.to_control()
    assert system.den[0][0] == pytest.approx(single.estimate.model.den[0][0])
    assert single.estimate.to_scipy().den == pytest.approx(single.estimate.model.den[0][0])


def test_without_pandas_one_line_says_so(single, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(tridentify.MissingDependencyError, match="found no pandas"):
        single.estimate.to_frame()


def test_dir_shows_what_users_need(single):
    shown = {name for name in dir(single.estimate) if not name.startswith("_")}
    needed = {
        "plot", "bode", "step", "to_control", "to_scipy", "to_frame", "report", "summary", "fit",
        "parameters", "predict", "residual", "save", "load", "derived", "findings", "model",
    }  # fmt: skip
    assert needed <= shown
    internal = {"call", "channel_draws", "derived_rows", "held_note", "model_text",
                "nuisance_rows", "offset_note"}  # fmt: skip
    assert not internal & shown


ROOMS = ("excitation", "export", "online", "physical", "plots", "report", "studies", "uncertainty")
QUICKLY = ("online", "plots", "report")


@pytest.mark.parametrize(
    "room",
    # a process each; all rooms are opened in the same way
    [pytest.param(r, marks=[] if r in QUICKLY else [pytest.mark.slow]) for r in ROOMS],
)
@pytest.mark.slow
def test_a_room_is_there_on_first_use(room):
    assert room in dir(tridentify)
    code = f"import tridentify; print(tridentify.{room}.__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"tridentify.{room}"
