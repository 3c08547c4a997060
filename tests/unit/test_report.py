"""The report: complete, self-contained, honest about doubts, and never half-written."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import html
import io
import itertools
import re
from html.parser import HTMLParser
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure

from tridentify import Structure, TransferFunction, identify, simulate, validate
from tridentify.errors import OptionError, OutputPathError
from tridentify.estimation.answer.estimate import Status, Trace
from tridentify.judgement.cautions import judged
from tridentify.record.record import Record
from tridentify.report import save_figures, write_report
from tridentify.report.figures import draw_figures, draw_fit
from tridentify.report.page import beside
from tridentify.report.pictures import Picture, _save
from tridentify.report.settings import settings_table
from tridentify.report.tables import result_tables, validation_tables

FIGURES = ("fit", "bode", "step", "pole-zero", "convergence", "residual-tests")


class _Page(HTMLParser):
    """Headings, outside addresses and unclosed tags of a page."""

    VOID = frozenset({"meta", "link", "img", "br"})

    def __init__(self, text):
        super().__init__()
        self.open, self.headings, self.addresses, self.loading = [], [], [], 0
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        if tag not in self.VOID:
            self.open.append(tag)
        self.loading += tag in ("link", "iframe", "img")
        links = (v for k, v in attrs if k in ("href", "src", "xlink:href") and v)
        self.addresses += [link for link in links if not link.startswith("#")]

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("h1", "h2", "h3"):
            self.headings.append(data.strip())


@pytest.fixture(scope="module")
def page(double, tmp_path_factory):
    path = write_report(
        double.estimate, double.record, tmp_path_factory.mktemp("report") / "report.html"
    )
    return path.read_text(encoding="utf-8")


@pytest.fixture
def no_figures(monkeypatch):
    """Pages whose figures do not matter are quicker without."""
    for name in ("model_pictures", "tests_pictures"):
        monkeypatch.setattr(f"tridentify.report.figures.{name}", lambda *_: [])


def test_page_is_well_formed_and_needs_nothing_from_outside(page):
    parsed = _Page(page)
    assert not parsed.open
    assert parsed.addresses == []
    assert parsed.loading == 0
    # nothing is fetched, and no script but its own runs
    assert "default-src 'none'" in page
    script = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)[0]
    own = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{own}'" in page
    assert "url(http" not in page
    assert "@import" not in page


def test_page_has_every_section(page):
    headings = _Page(page).headings
    assert headings[0] == "q, alpha from elevator"
    for wanted in (
        "Coefficients",
        "Natural frequency, damping, gain",
        "Estimated along",
        "Fit",
        "Measured against model",
        "Tests of the residual",
        "Residual of alpha and its tests",
        "Step response",
        "Step 1: the parallel model",
        "Step 3: the series model",
        "The way to the estimate",
        "Frequency response",
        "Poles and zeros",
        "Convergence of the passes",
        "Passes",
        "Coefficients after each pass",
        "Starts tried",
        "Settings and data",
    ):
        assert wanted in headings
    order = (
        "Usable: a model",
        "Measured against model",
        "fit of q / alpha",
        "<h2>Model",
        "<h2>How it",
    )
    places = [page.index(words) for words in order]
    assert places == sorted(places)


def test_the_first_screen_says_what_was_found_and_how_far_to_trust_it(page):
    first = page[: page.index("<nav")]
    assert "2 poles and 1 zero fits 93.2 % of q, 93.2 % of alpha." in first
    assert "Nothing speaks against it" in first
    assert re.search(r"short period . 600 samples every 0.02 s, 11.98 s . \d+ \w+ \d{4}", first)
    assert len(re.findall("<dt>", first)) == 4
    for label in ("fit of q / alpha", "natural frequency", "damping", "dc gain[q,elevator]"):
        assert f"<dt>{label}</dt>" in first
    assert "stationary point" not in first


def test_how_the_algorithm_went_is_folded(page):
    folded = page[page.index('<details class="course">') :]
    folded = folded[: folded.index("</details>")]
    for words in ("Convergence of the passes", "Step 1: the parallel model", "Starts tried"):
        assert page.count(words) == folded.count(words) > 0


def test_formulas_are_those_of_the_notebook(page, double):
    assert page.count("<mfrac>") == 2
    assert double.estimate.model_mathml() in page
    # to be copied as text
    assert html.escape(double.estimate.model_text()) in page


def test_page_states_the_numbers(page, double):
    estimate = double.estimate
    for name, parameter in estimate.parameters.items():
        row = re.search(rf"<td class=\"text\">{re.escape(name)}</td>(.*?)</tr>", page, re.DOTALL)
        cells = re.findall(r"<td[^>]*>(.*?)</td>", row[1])
        assert float(cells[0]) == pytest.approx(parameter.value, abs=0.6 * parameter.std)
        assert float(cells[1]) == pytest.approx(parameter.std, rel=0.06)
        assert cells[-1] == parameter.unit
    for text in ("93.21", estimate.record_fingerprint, "8 Laguerre functions", "AICc lower by"):
        assert text in page


def test_every_inline_figure_is_valid_svg_that_scales(page):
    drawings = re.findall(r"<svg.*?</svg>", page, re.DOTALL)
    assert len(drawings) == 7 + 4
    clips = []
    for drawing in drawings:
        root = ElementTree.fromstring(drawing)
        assert root.get("viewBox")
        assert root.get("width") is None
        assert root.get("aria-label")
        clips += re.findall(r'<clipPath id="(.*?)"', drawing)
        for reference in re.findall(r"url\(#(.*?)\)", drawing):
            assert f'id="{reference}"' in drawing
    assert len(clips) == len(set(clips))


@pytest.mark.slow
def test_foreign_text_is_escaped(single, tmp_path):
    names = {"input_names": ["<i>"], "output_names": ["a&b"]}
    record = Record(single.record.u, single.record.y, dt=0.02, name="<script>x", **names)
    estimate = dataclasses.replace(
        single.estimate, input_names=("<i>",), output_names=("a&b",), method="<b>", units={}
    )
    text = write_report(estimate, record, tmp_path / "r.html").read_text()
    assert text.count("<script") == 2
    assert "<i>" not in text
    assert "<b>" not in text
    assert "&lt;script&gt;x" in text
    for drawing in re.findall(r"<svg.*?</svg>", text, re.DOTALL):
        ElementTree.fromstring(drawing)


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize(
    ("status", "words"),
    [
        (Status.CONVERGED, "Usable:"),
        (Status.WEAKLY_IDENTIFIABLE, "Usable with caution:"),
        (Status.STALLED, "Not usable:"),
    ],
)
def test_verdict_and_remedy_come_first(single, tmp_path, status, words):
    estimate = dataclasses.replace(single.estimate, status=status)
    text = write_report(estimate, single.record, tmp_path / "r.html", title="Test").read_text()
    assert f"<strong>{words}" in text
    assert ("What to do" in text) == bool(status.remedy)
    assert status.remedy in text
    assert "<h1>Test</h1>" in text


def test_sound_estimate_has_no_warnings(single, double):
    assert not judged(single.estimate, [single.record])
    assert not judged(double.estimate, [double.record])


def test_doubts_are_named(single):
    y = np.array(single.record.y)
    y[:, 0] += 1e-3 * np.sin(single.record.t)
    y[20:25] = np.nan
    doubtful = Record(single.record.u, y, dt=0.02, output_names=["q"])
    vague = dataclasses.replace(single.estimate, cov=np.diag([4.0, 0.01, 0.01]))
    found = judged(vague, [doubtful])
    codes = [finding.code for finding in found]
    assert codes == ["not-determined", "noise-model", "missing-samples"]
    assert found[0].message.split(":")[0] == "Standard error above half of the value"
    assert "a1." in found[0].text
    assert "a0" not in found[0].text
    assert found[2].message.startswith("5 output samples are missing;")
    assert found[1].message.startswith("The residual of q is not white:")
    for remedy in ("--drift auto", "more poles or zeros", "delay"):
        assert remedy in found[1].remedy


def test_a_residual_at_rounding_level_is_not_called_coloured(single):
    fitted = single.estimate.predict(single.record)
    for size, doubts in ((1e-12, 0), (1e-6, 1)):
        y = fitted * (1 + size * np.sin(single.record.t)[:, np.newaxis])
        record = Record(single.record.u, y, dt=0.02, output_names=["q"])
        assert len(judged(single.estimate, [record])) == doubts


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_what_validation_finds_stands_first(single, tmp_path):
    late = np.roll(single.record.u[:, 0], 6)
    shifted = Record(late, single.record.y, dt=0.02, input_names=["elevator"], output_names=["q"])
    text = write_report(single.estimate, shifted, tmp_path / "r.html").read_text()
    # outputs that come before their input are no model's fault, and no use
    assert '<section class="verdict bad"' in text
    found = validate(single.estimate, shifted)
    assert html.escape(found.findings[0].message) in text[: text.index('<section id="model">')]


@pytest.mark.usefixtures("no_figures")
def test_a_page_is_not_called_a_pdf(single, tmp_path):
    with pytest.raises(OptionError, match="found the page 'flight"):
        write_report(single.estimate, single.record, tmp_path / "flight.pdf")
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("no_figures")
def test_a_record_too_short_to_test_says_so(single, tmp_path):
    text = write_report(
        single.estimate, single.record.slice(0.0, 0.05), tmp_path / "r.html"
    ).read_text()
    assert "Not tested: found" in text


@pytest.mark.slow
def test_several_experiments_each_get_their_figures(single, tmp_path):
    estimate = dataclasses.replace(single.estimate, nuisance=single.estimate.nuisance * 2)
    records = [single.record, single.record]
    text = write_report(estimate, records, tmp_path / "r.html").read_text()
    assert "Measured against model, experiment 2: doublet" in _Page(text).headings
    names = {path.name for path in save_figures(estimate, records, tmp_path / "figures")}
    assert {"fit-1.svg", "fit-2.svg", "bode.svg"} < names


@pytest.mark.slow
def test_estimate_without_trace_or_covariance_has_a_report(single, tmp_path):
    bare = dataclasses.replace(
        single.estimate,
        trace=Trace(()),
        cov=np.full((3, 3), np.nan),
        nuisance=single.estimate.nuisance,
        gradient=float("nan"),
    )
    text = write_report(bare, single.record, tmp_path / "r.html").read_text()
    assert not re.search(r"\bnan\b", text)


@pytest.mark.slow
def test_long_record_makes_a_small_page(single, tmp_path):
    t = np.arange(60_000) * 0.02
    u = np.sign(np.sin(t))
    y = np.random.default_rng(0).standard_normal(t.size)
    record = Record(u, y, dt=0.02, input_names=["elevator"], output_names=["q"])
    path = write_report(single.estimate, record, tmp_path / "r.html")
    assert path.stat().st_size < 1_500_000


@pytest.mark.slow
def test_page_and_figures_together_are_those_apart_and_drawn_once(single, tmp_path, monkeypatch):
    from matplotlib.figure import Figure

    apart = write_report(single.estimate, single.record, tmp_path / "r.html").read_text()
    drawn, stages = [], []
    plain = Figure.savefig

    def counted(figure: Figure, *arguments: object, **options: object) -> None:
        drawn.append((id(figure), figure.get_layout_engine()))
        plain(figure, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", counted)
    folder = tmp_path / "both"
    page = write_report(
        single.estimate, single.record, folder / "r.html", figures=folder, progress=stages.append
    )
    headings = re.findall(r"<figcaption>.*?</figcaption>", apart, re.DOTALL)
    assert re.findall(r"<figcaption>.*?</figcaption>", page.read_text(), re.DOTALL) == headings
    assert sorted(path.name for path in folder.glob("*.svg")) == sorted(
        f"{stem}.svg" for stem in FIGURES
    )
    # no places are worked out while a figure is saved
    assert {engine for _, engine in drawn} == {None}
    assert len({number for number, _ in drawn}) == len(drawn) == len(FIGURES)
    assert stages == ["testing the residual", "writing the report and the figures"]


@pytest.mark.slow
@pytest.mark.undrawn
def test_figures_are_written_in_the_asked_formats(single, tmp_path):
    paths = save_figures(single.estimate, single.record, tmp_path / "f", formats=("png", "svg"))
    expected = [f"{stem}.{form}" for stem in FIGURES for form in ("png", "svg")]
    assert [path.name for path in paths] == expected
    assert sorted(item.name for item in (tmp_path / "f").iterdir()) == sorted(expected)
    with pytest.raises(OptionError, match="found the figure format 'bmp'"):
        save_figures(single.estimate, single.record, tmp_path / "g", formats=("bmp",))
    assert not (tmp_path / "g").exists()


@pytest.mark.parametrize(("name", "start"), [("png", b"\x89PNG"), ("svg", b"<?xml")])
def test_a_figure_is_in_the_format_of_its_name(name, start):
    written = io.StringIO() if name == "svg" else io.BytesIO()
    _save(SimpleNamespace(figure=Figure(figsize=(1.0, 1.0))), written, name)
    assert written.getvalue()[:5].startswith(start.decode() if name == "svg" else start)


@pytest.mark.usefixtures("no_figures")
def test_unwritable_place_leaves_nothing_behind(single, tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(OutputPathError, match="choose another output path"):
        write_report(single.estimate, single.record, tmp_path / "taken" / "report.html")
    with pytest.raises(OutputPathError):
        save_figures(single.estimate, single.record, tmp_path / "taken")
    assert [item.name for item in tmp_path.iterdir()] == ["taken"]


@pytest.mark.usefixtures("no_figures")
def test_report_replaces_an_older_one(single, tmp_path):
    path = tmp_path / "report.html"
    path.write_text("old")
    assert write_report(single.estimate, single.record, path) == path
    assert path.read_text().startswith("<!DOCTYPE html>")
    assert [item.name for item in tmp_path.iterdir()] == ["report.html"]


@pytest.mark.unjudged
def test_equalities_are_written_as_one_writes_them():
    u = np.sign(np.sin(np.arange(200) ** 1.5))
    record = Record(u, u, dt=0.02)
    record = record.with_outputs(simulate(TransferFunction([4.0], [1.0, 4.0]), record))
    structure = Structure(1, 0, equalities=[({"b0": 1.0, "a0": -1.0}, 0.0)])
    rows = dict(settings_table(identify(record, structure), [record]))
    assert rows["equalities"] == "b0 - a0 = 0"


def test_numbers_that_say_nothing_have_few_digits(single):
    cov = np.diag([400.0, 1e-4, 1e-6])
    vague = dataclasses.replace(single.estimate, cov=cov)
    cells = {row[0]: row for table in result_tables(vague) for row in table.rows}
    assert cells["a1"][3] == "not determined"
    assert cells["a0"][3] == "0.33 %"
    checked = validate(single.estimate, single.record)
    surely = [dataclasses.replace(test, p_value=7e-205, rejected=True) for test in checked.tests]
    table = validation_tables(dataclasses.replace(checked, tests=tuple(surely)))[0]
    assert {row[1] for row in table.rows} == {"< 0.001 *"}
    assert table.marked == tuple(range(len(table.rows)))
    assert all(row[-1] for row in table.rows)
    missing = [dataclasses.replace(test, p_value=float("nan")) for test in checked.tests]
    table = validation_tables(dataclasses.replace(checked, tests=tuple(missing)))[0]
    assert {row[1] for row in table.rows} == {"-"}
    assert "A dash" in table.note


def test_columns_of_figures_are_of_like_height():
    heights = (6.0, 2.0, 2.0, 2.0, 3.0)
    pictures = [Picture(f"{h}", "", "", "response", "<svg", 5.6, h) for h in heights]
    wide = dataclasses.replace(pictures[0], width=11.2)
    first, alone, second = beside([*pictures[:4], wide, pictures[4]])
    assert [sum(p.height for p in column) for column in first.columns] == [6.0, 6.0]
    assert alone.wide is wide
    assert second.columns == ((pictures[4],),)


@pytest.mark.slow
def test_a_sheet_leaves_room_for_all_that_stands_around_its_axes(double, single):
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    case = Record(
        single.record.u,
        1e-5 * np.asarray(single.record.y),
        dt=0.02,
        input_names=["a name of an input that is rather long"],
        output_names=["q"],
        units={"q": "rad/s"},
    )
    checked = validate(double.estimate, double.record)
    drawings = [
        *draw_figures(double.estimate, [double.record], checked),
        draw_fit(case, np.asarray(case.y)),
    ]
    for drawing in drawings:
        figure = drawing.figure
        renderer = FigureCanvasAgg(figure).get_renderer()
        figure.draw_without_rendering()
        width, height = figure.bbox.width, figure.bbox.height
        boxes = [ax.get_tightbbox(renderer) for ax in figure.axes if ax.axison]
        for box in boxes:
            assert -1.0 <= box.x0 < box.x1 <= width + 1.0, drawing.stem
            assert -1.0 <= box.y0 < box.y1 <= height + 1.0, drawing.stem
        for one, other in itertools.combinations(boxes, 2):
            wide = min(one.x1, other.x1) - max(one.x0, other.x0)
            high = min(one.y1, other.y1) - max(one.y0, other.y0)
            assert min(wide, high) < 4.0, drawing.stem
