"""Diagrams: well-formed SVG, the estimate's numbers, no text on another or out of its box."""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tridentify.errors import OptionError, OutputPathError, StepNotTakenError
from tridentify.estimation.answer.estimate import (
    Estimate,
    Nuisance,
    Pass,
    Start,
    Status,
    Step,
    Trace,
)
from tridentify.plots import diagrams
from tridentify.plots.diagrams.drawing import (
    Board,
    Circle,
    Line,
    Polygon,
    Rect,
    Text,
    fitted,
    text_width,
    wrapped,
)
from tridentify.plots.diagrams.words import elided, pole, terms
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

SVG = "{http://www.w3.org/2000/svg}"
OF_STEPS = {
    "parallel": diagrams.draw_parallel,
    "series-parallel": diagrams.draw_series_parallel,
    "series": diagrams.draw_series,
}
ALL = (*OF_STEPS.values(), diagrams.draw_three_models, diagrams.draw_flow_chart)


def read(svg):
    """Root and texts of a drawing, as the drawing board has them."""
    root = ET.fromstring(svg)
    texts = [
        Text(
            float(one.get("x")),
            float(one.get("y")),
            one.text or "",
            float(one.get("font-size")),
            one.get("text-anchor"),
            bold=one.get("font-weight") == "bold",
        )
        for one in root.iter(f"{SVG}text")
    ]
    return root, texts


def rectangles(root):
    return [
        Rect(*(float(one.get(key)) for key in ("x", "y", "width", "height")))
        for one in root.iter(f"{SVG}rect")
        if one.get("x")
    ]


def segments(root):
    for one in root.iter(f"{SVG}polyline"):
        points = [tuple(map(float, p.split(","))) for p in one.get("points").split()]
        yield from itertools.pairwise(points)


def covers(one, other, slack=0.6):
    return (
        one.x < other.right - slack
        and other.x < one.right - slack
        and one.y < other.bottom - slack
        and other.y < one.bottom - slack
    )


def faults(svg):
    """Whatever is wrong with the layout of a drawing, in words."""
    root, texts = read(svg)
    width, height = map(float, root.get("viewBox").split()[2:])
    found = []
    for text in texts:
        room = text.room
        if room.x < 0 or room.right > width or room.y < 0 or room.bottom > height:
            found.append(f"{text.text!r} leaves the picture")
        if text.text and text.size < 11.0:
            found.append(f"{text.text!r} is too small")
        for box in rectangles(root):
            crossing = covers(room, box)
            inside = (
                room.x >= box.x and room.right <= box.right
                and room.y >= box.y - 1 and room.bottom <= box.bottom + 1
            )  # fmt: skip
            if crossing and not inside:
                found.append(f"{text.text!r} leaves its box")
        for (x, y), (x_1, y_1) in segments(root):
            line = Rect(min(x, x_1), min(y, y_1), abs(x - x_1) + 1.3, abs(y - y_1) + 1.3)
            if covers(room, line, 0.9):
                found.append(f"a line crosses {text.text!r}")
    for one, other in itertools.combinations([t for t in texts if t.text.strip()], 2):
        if covers(one.room, other.room):
            found.append(f"{one.text!r} on {other.text!r}")
    for box, other in itertools.combinations(rectangles(root), 2):
        if covers(box, other):
            found.append(f"boxes at {box.x, box.y} and {other.x, other.y} overlap")
    return found


def words(svg):
    return " ".join(text.text for text in read(svg)[1])


def at_rest(n_inputs, n_outputs, order):
    """Nothing estimated along."""
    none = np.zeros(n_outputs)
    return Nuisance(np.zeros(n_inputs), none, none, np.zeros((n_outputs, order)), none, none)


def made(
    order=2,
    zeros=0,
    *,
    outputs=("alpha",),
    inputs=("elevator",),
    passes=4,
    kind="orthonormal",
    operators=None,
    spread=0.02,
    scale=1.0,
) -> Estimate:
    """An estimate of any size with the trace of a strategy that took every step."""
    rng = np.random.default_rng(order + 7 * zeros)
    roots = -scale * (0.5 + np.arange(order))
    den = np.poly(roots)
    nums = [[rng.uniform(-9, 9, zeros + 1) for _ in inputs] for _ in outputs]
    theta = np.concatenate([den[1:], *(num for row in nums for num in row)])
    structure = Structure(order, [[zeros] * len(inputs)] * len(outputs))
    names = structure.names(inputs, outputs)
    count = operators or 2 * order
    poles = np.column_stack([np.resize(roots, count), np.resize([0.3, -0.3], count)])
    beta = rng.uniform(-1e4, 1e4, len(outputs) * len(inputs) * count)
    taken = []
    for k in range(1, passes + 1):
        distance = 10.0**-k
        weights = np.tile(np.append(1.0, np.full(order, distance)), len(outputs))
        steps = (
            Step("parallel", beta, 1.25e-3 / k, 12.0, "operators", kind, poles),
            Step("series-parallel", theta * (1 + distance), 3e-4, 85.0, "filter", poles=poles[:3]),
            Step("series", weights, 2e-4, 31.0, "", kind, poles[:order]),
        )
        taken.append(Pass(k, steps, theta * (1 + distance), 1e-3 / k, distance, distance**2))
    start = Start("Laguerre 4.21 rad/s, order 2", theta, 0.2)
    n_outputs = len(outputs)
    return Estimate(
        model=TransferFunction(
            nums, [[den] * len(inputs)] * n_outputs, input_names=inputs, output_names=outputs
        ),
        structure=structure,
        theta=theta,
        names=names,
        cov=np.diag((spread * theta) ** 2),
        noise_variance=np.ones(n_outputs),
        fit=np.full(n_outputs, 91.234),
        status=Status.CONVERGED,
        trace=Trace(tuple(taken), (start,), ("offset: lowest AICc",), "the cost stopped falling"),
        method="ThreeModel",
        n_samples=500,
        nuisance=(at_rest(len(inputs), n_outputs, order),),
        degrees_of_freedom=490,
        cost=1e-3,
        aicc=0.0,
        condition=10.0,
        gradient=1e-9,
        input_names=tuple(inputs),
        output_names=tuple(outputs),
        units={},
        intersample="zoh",
        dt=0.02,
    )


@pytest.mark.parametrize("draw", ALL)
@pytest.mark.parametrize("order", [1, 2, 3, 4, 6])
@pytest.mark.fast("6-*", "1-*")
def test_orders_leave_every_text_in_its_place(draw, order):
    for zeros in {0, order - 1, order}:
        assert faults(draw(made(order, zeros))) == []


@pytest.mark.parametrize("draw", ALL)
@pytest.mark.parametrize("scale", [1e6, 1e-6])
def test_fast_and_slow_systems_leave_every_text_in_its_place(draw, scale):
    assert faults(draw(made(4, 3, scale=scale))) == []


@pytest.mark.parametrize("draw", ALL)
@pytest.mark.parametrize("spread", [0.0, math.nan, 1e-14, 30.0])
@pytest.mark.fast("nan-*")
def test_any_standard_error_leaves_every_text_in_its_place(draw, spread):
    assert faults(draw(made(3, 1, spread=spread))) == []


@pytest.mark.parametrize("draw", ALL)
@pytest.mark.parametrize("kind", ["allpass", "laguerre", ""])
@pytest.mark.fast("laguerre-*", "-draw_three_models")
def test_kinds_and_numbers_of_operators(draw, kind):
    for operators in (1, 30):
        assert faults(draw(made(2, 1, kind=kind, operators=operators))) == []


@pytest.mark.parametrize("draw", ALL)
@pytest.mark.parametrize("passes", [1, 20, 120])
@pytest.mark.fast("120-*")
def test_many_passes_are_elided(draw, passes):
    assert faults(draw(made(passes=passes))) == []
    chart = words(diagrams.draw_flow_chart(made(passes=passes)))
    assert ("passes more" in chart) == (passes > 12)


NAMES = st.text(
    st.characters(exclude_categories=("Cs",), exclude_characters="[],"), min_size=1, max_size=60
).filter(lambda name: name.strip() == name and name.isprintable())


@pytest.mark.slow
@settings(max_examples=20)
@given(
    names=st.lists(NAMES, min_size=4, max_size=4, unique=True),
    order=st.integers(1, 4),
    draw=st.sampled_from(ALL),
)
def test_any_names_leave_every_text_in_its_place(names, order, draw):
    estimate = made(order, outputs=names[:2], inputs=names[2:])
    assert faults(draw(estimate)) == []


@pytest.mark.parametrize("draw", ALL)
def test_drawings_are_self_contained_and_described(draw):
    svg = draw(made(outputs=("<q> & 'r'",), inputs=('"e"</svg>',)))
    root, texts = read(svg)
    assert root.tag == f"{SVG}svg"
    assert root.find(f"{SVG}title").text
    assert root.find(f"{SVG}desc").text
    assert root.get("role") == "img"
    assert not re.search(r"\b(href|url|id|script|import)\s*[=(]", svg)
    assert svg.count("http") == 1  # the name space
    assert "sans-serif" in root.get("font-family")
    assert any("<q> & 'r'" in text.text for text in texts)
    assert isinstance(svg, str)
    assert svg._repr_svg_() == svg


def test_parallel_model_shows_its_weights_and_operators():
    estimate = made(operators=3, kind="allpass")
    step = estimate.trace.passes[-1].steps[0]
    text = words(diagrams.draw_parallel(estimate))
    for k, beta in enumerate(step.coefficients):
        shown = re.search(f"β{'₁₂₃'[k]} = (\\S+)", text)[1].replace("−", "-")
        assert float(shown) == pytest.approx(beta, rel=2e-3)
    assert "W₂ = ((p − γ)/(p + γ))²" in text
    assert "γ = 0.5 rad/s" in text
    assert "mean square 0.0003125, condition 12" in text
    assert "pass 4 of 4" in text
    assert "pass 2 of 4" in words(diagrams.draw_parallel(estimate, pass_number=2))


def test_channel_of_several_is_the_one_asked_for():
    estimate = made(outputs=("q", "alpha"), inputs=("elevator", "flap"))
    step = estimate.trace.passes[-1].steps[0]
    text = words(diagrams.draw_parallel(estimate, output=1, input_=0))
    assert "alpha / elevator (channel 3 of 4)" in text
    expected = step.coefficients.reshape(2, 2, -1)[1, 0, 0]
    shown = re.search(r"β₁ = (\S+)", text)[1].replace("−", "-")
    assert float(shown) == pytest.approx(expected, rel=2e-3)
    assert "other inputs do as well: flap" in text
    model = words(diagrams.draw_series_parallel(estimate, output=0, input_=1))
    k = estimate.names.index("b0[q,flap]")
    assert " ".join(terms(step_values(estimate, 0, 1)[0], estimate.std[k : k + 1])) in model


def step_values(estimate, output, input_):
    theta = estimate.trace.passes[-1].steps[1].coefficients
    num, den, _ = estimate.channel_draws(theta[None], output, input_)
    return num[0], den[0]


def test_series_parallel_model_shows_polynomials_with_errors_and_the_filter():
    estimate = made(2, 1)
    num, den = step_values(estimate, 0, 0)
    std = estimate.std
    text = words(diagrams.draw_series_parallel(estimate))
    assert " ".join(terms(den, [0.0, *std[:2]])) in text
    assert " ".join(terms(num, std[2:])) in text
    filter_ = estimate.trace.passes[-1].steps[1].poles
    c = np.poly(filter_[:, 0] + 1j * filter_[:, 1]).real
    assert terms(c, np.zeros(4))[-1] in text
    assert "parallel model of Step 1" in text
    assert "± is one standard error of the final estimate" in text
    bare = words(diagrams.draw_series_parallel(made(2, 1, spread=0.0)))
    assert "±" not in bare


def test_series_model_shows_the_distance_of_beta():
    text = words(diagrams.draw_series(made(passes=3)))
    assert "β₀ = 1" in text
    assert "β₂ = 0.001" in text
    assert "largest |β − (1, 0, ..., 0)| = 0.001" in text


def test_three_models_stand_below_each_other():
    estimate = made(3, 1)
    svg = diagrams.draw_three_models(estimate)
    titles = [text for text in read(svg)[1] if text.text.startswith("Step ") and text.size > 14]
    assert [text.text[:6] for text in titles] == ["Step 1", "Step 2", "Step 3"]
    assert sorted(text.y for text in titles) == [text.y for text in titles]


@pytest.mark.parametrize("order", [1, 2, 3, 4, 6])
def test_three_models_in_closed_loop(order):
    estimate = dataclasses.replace(made(order), route="reference")
    svg = diagrams.draw_closed_loop(estimate)
    assert faults(svg) == []
    titles = [text for text in read(svg)[1] if text.text.startswith("Step ") and text.size > 14]
    assert [text.text[:6] for text in titles] == ["Step 1", "Step 2", "Step 3"]
    assert sorted(text.y for text in titles) == [text.y for text in titles]
    num, den, _ = estimate.channel(0, 0)
    for one in (num, den):
        assert " ".join(terms(one, np.zeros(len(one)))) in words(svg)


def test_a_closed_loop_needs_a_reference():
    with pytest.raises(StepNotTakenError, match="expected one by the reference route"):
        diagrams.draw_closed_loop(made(2))


def test_flow_chart_tells_what_happened():
    estimate = made(passes=3)
    passes = list(estimate.trace.passes)
    passes[1] = dataclasses.replace(passes[1], note="reflected an unstable pole")
    trace = dataclasses.replace(estimate.trace, passes=tuple(passes))
    text = words(diagrams.draw_flow_chart(dataclasses.replace(estimate, trace=trace)))
    for wanted in (
        "ThreeModel: converged",
        "500 samples of elevator and alpha",
        "Laguerre 4.21 rad/s, order 2: 0.2",
        "3 times, at last cost 0.0004167",
        "β within 0.001 of (1, 0, ..., 0)",
        "2 times",
        "the cost stopped falling",
        "pass 2: reflected an unstable pole",
        "offset: lowest AICc",
        "fit alpha 91.2 %",
        "passes 1 to 3: Step 1, 2, 3",
    ):
        assert wanted in text
    for name, value in zip(estimate.names, estimate.theta, strict=True):
        shown = re.search(rf"{name} = (\S+)", text)[1]
        assert float(shown) == pytest.approx(value, rel=0.01)


def test_flow_chart_goes_back_to_the_first_step_that_is_repeated(single):
    """As printed: Step 1 once, then Steps 2 and 3 in turns, which end with Step 2."""
    estimate = single.estimate
    first = estimate.trace.passes[0].steps
    passes = (
        Pass(1, first, estimate.theta, 1.0, 0.5),
        Pass(2, first[1:], estimate.theta, 0.9, 0.1),
        Pass(3, first[1:2], estimate.theta, 0.9),
    )
    svg = diagrams.draw_flow_chart(dataclasses.replace(estimate, trace=Trace(passes)))
    root, texts = read(svg)
    assert sum(text.text == "settled?" for text in texts) == 1
    title = next(text for text in texts if text.text.startswith("Steps 2 and 4"))
    box = next(box for box in rectangles(root) if covers(title.room, box))
    ends = [end for _, end in segments(root)]
    assert any(abs(x - box.right) < 9 and abs(y - box.middle) < 1 for x, y in ends)
    assert faults(svg) == []


def test_flow_chart_of_other_methods(single):
    estimate = dataclasses.replace(
        single.estimate,
        method="OutputError",
        trace=Trace(single.estimate.trace.passes[-1:], stopped="no step lowers the cost"),
    )
    svg = diagrams.draw_flow_chart(estimate)
    assert faults(svg) == []
    assert "Step on the output error" in words(svg)
    empty = diagrams.draw_flow_chart(dataclasses.replace(estimate, trace=Trace(())))
    assert faults(empty) == []
    assert "none recorded" in words(empty)


@pytest.mark.parametrize("name", OF_STEPS)
def test_steps_that_were_not_taken_are_refused_in_one_line(single, name):
    estimate = dataclasses.replace(
        single.estimate, method="OutputError", trace=Trace(single.estimate.trace.passes[-1:])
    )
    for draw in (OF_STEPS[name], diagrams.draw_three_models):
        with pytest.raises(StepNotTakenError, match="of OutputError, whose steps are output") as e:
            draw(estimate)
        assert "\n" not in str(e.value)
    with pytest.raises(StepNotTakenError, match="in pass 5"):
        OF_STEPS[name](single.estimate, pass_number=5)


def test_without_a_parallel_model_the_object_itself_stands_in_the_diagram(single):
    step = Step("series-parallel", single.estimate.theta, 0.1, 4.0, "recorded output")
    trace = Trace((Pass(1, (step,), single.estimate.theta, 0.1),))
    svg = diagrams.draw_series_parallel(dataclasses.replace(single.estimate, trace=trace))
    assert "object and noise ζ" in words(svg)
    assert "on the object itself" in words(svg)
    assert "parallel model of" not in words(svg).replace("series-parallel", "")
    assert faults(svg) == []


@pytest.mark.parametrize(
    "options", [{"output": 1}, {"input_": -1}, {"output": True}, {"pass_number": 99}]
)
def test_channels_and_passes_that_do_not_exist_are_refused(options):
    with pytest.raises(OptionError, match="expected"):
        diagrams.draw_parallel(made(), **options)


def test_a_trace_without_poles_can_be_drawn(single):
    """As saved before steps told their poles."""
    for draw in ALL:
        assert faults(draw(single.estimate)) == []


def test_trace_keeps_kind_and_poles_in_a_file(tmp_path):
    estimate = made(kind="laguerre")
    loaded = Estimate.load(estimate.save(tmp_path / "estimate.json"))
    step, kept = estimate.trace.passes[0].steps[0], loaded.trace.passes[0].steps[0]
    assert kept.kind == "laguerre"
    assert kept.poles.tolist() == step.poles.tolist()
    assert diagrams.draw_three_models(loaded) == diagrams.draw_three_models(estimate)


def test_a_file_without_kind_and_poles_can_be_read(tmp_path):
    import json

    path = made().save(tmp_path / "estimate.json")
    document = json.loads(path.read_text())
    for one in document["trace"]["passes"]:
        for step in one["steps"]:
            del step["kind"], step["poles"]
    path.write_text(json.dumps(document))
    assert Estimate.load(path).trace.passes[0].steps[0].poles.shape == (0, 2)


def test_write_diagram(tmp_path):
    svg = diagrams.draw_parallel(made())
    path = diagrams.write_diagram(svg, tmp_path / "new" / "step-1.svg")
    assert path.read_text(encoding="utf-8") == svg
    with pytest.raises(OutputPathError):
        diagrams.write_diagram(svg, tmp_path / "new" / "step-1.svg" / "inside.svg")


# ---------------------------------------------------------------------------------- the board
def test_faults_would_be_found():
    """The checks of this file can fail."""
    board = Board(200.0)
    board.text(190.0, 30.0, "out of the picture")
    board.text(20.0, 60.0, "one")
    board.text(22.0, 62.0, "other")
    board.line((0.0, 56.0), (200.0, 56.0))
    board.shapes.append(Rect(30.0, 50.0, 10.0, 10.0))
    found = " ".join(faults(board.svg("t", "d")))
    for wanted in ("leaves the picture", "'one' on 'other'", "a line crosses", "leaves its box"):
        assert wanted in found


@pytest.mark.parametrize("family", ["DejaVu Sans"])
def test_estimated_widths_hold_the_font(family):
    from matplotlib.font_manager import FontProperties, findfont
    from matplotlib.ft2font import FT2Font

    font = FT2Font(findfont(FontProperties(family=family)))
    font.set_size(100, 72)

    def width(text):
        return sum(font.load_char(ord(c)).linearHoriAdvance / 65536 for c in text) / 100

    for text in (
        "mean square 0.0003125, condition 12",
        "+ (406.5 ± 1.4) p² + (412.3 ± 4.7) p",
        "β₁ = −0.0002345",
        "W₂ = ((p − γ)/(p + γ))²",
        "W₁: pole −0.497 + 1.94j",
        "pitch rate of the body / elevator deflection",
        "Least squares: least mean square of ε",
    ):
        assert width(text) * 13.0 <= text_width(text, 13.0) <= 1.3 * width(text) * 13.0


@given(st.text(max_size=40), st.floats(20.0, 300.0))
def test_fitted_text_fits(text, width):
    assert text_width(fitted(text, width)) <= width


def test_terms_too_long_for_a_line_are_split_between_words():
    lines = wrapped(["+ (1.2345e-05 ± 1.2e-12) p⁴"], 110.0)
    assert " ".join(lines) == "+ (1.2345e-05 ± 1.2e-12) p⁴"
    assert len(lines) == 2


def test_words_of_polynomials_and_poles():
    assert terms([1.0, -2.0, 0.0], [0.0, 0.1, 0.0]) == ["p²", "− (2.00 ± 0.10) p", "+ 0"]
    assert terms([-1.0, 3.0], [0.0, 0.0]) == ["− p", "+ 3"]
    assert pole(-1.0, -2.5) == "−1 − 2.5j"
    assert elided(7, 6) == [0, 1, 2, -1, 5, 6]


def test_arrow_heads_end_at_the_point():
    head = Line(((0.0, 0.0), (100.0, 0.0))).svg()
    corners = re.search(r'<polygon points="([^"]*)"', head)[1]
    assert corners.split()[0] == "100.0,0.0"
    board = Board()
    board.shapes += [Circle(5.0, 300.0), Polygon(((0.0, 0.0), (1.0, 320.0), (2.0, 2.0)))]
    assert board.height == pytest.approx(332.0)
