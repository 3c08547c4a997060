"""Exports: C that is compiled and run, scripts that Octave runs, files that are read back."""

from __future__ import annotations

import dataclasses
import json
import shutil
import subprocess

import numpy as np
import pytest
from scipy.io import loadmat

from tridentify import Estimate, Record, Structure, TransferFunction, simulate
from tridentify.errors import OptionError, OutputPathError, UnsupportedError
from tridentify.export import write_c_header, write_json, write_matlab
from tridentify.export.c_header import c_header

COMPILER = shutil.which("cc") or shutil.which("gcc")
OCTAVE = shutil.which("octave-cli") or shutil.which("octave")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler (cc, gcc) on PATH")
needs_octave = pytest.mark.skipif(OCTAVE is None, reason="no octave on PATH")

DRIVER = """#include <stdio.h>
#include "{name}.h"
int main(void)
{{
    {name}_t filter;
    {number} u[{upper}_INPUTS], y[{upper}_OUTPUTS];
    double value;
    int i;
    {name}_init(&filter);
    for (;;) {{
        for (i = 0; i < {upper}_INPUTS; ++i) {{
            if (scanf("%lf", &value) != 1) return 0;
            u[i] = ({number})value;
        }}
        {name}_step(&filter, u, y);
        for (i = 0; i < {upper}_OUTPUTS; ++i) printf("%.17g ", (double)y[i]);
        printf("\\n");
    }}
}}
"""
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1")


def run_in_c(header, u, number="double"):
    """Outputs of a header for inputs (n_samples, n_inputs)."""
    name, folder = header.stem, header.parent
    source = DRIVER.format(name=name, upper=name.upper(), number=number)
    (folder / "main.c").write_text(source, encoding="utf-8")
    build = [COMPILER, *STRICT, "main.c", "-o", "filter", "-lm"]
    done = subprocess.run(build, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    lines = "\n".join(" ".join(map(repr, row)) for row in u.tolist())
    out = subprocess.run(
        [str(folder / "filter")], input=lines, capture_output=True, text=True, check=True
    )
    return np.array([[float(x) for x in line.split()] for line in out.stdout.splitlines()])


def inputs(n_inputs=1, n=400, seed=0):
    return np.random.default_rng(seed).standard_normal((n, n_inputs))


def zeros_of(model, u, dt):
    return Record(u, np.zeros((len(u), model.n_outputs)), dt=dt)


MODELS = {
    "second order": TransferFunction([2.0, 1.0], [1.0, 2.0, 9.0]),
    "biproper": TransferFunction([3.0, 1.0, 2.0], [1.0, 2.0, 9.0]),
    "gain": TransferFunction([2.5], [1.0]),
    "integrator": TransferFunction([2.0], [1.0, 3.0, 0.0]),
    "unstable": TransferFunction([2.0], [1.0, -0.1, 4.0]),
    "ten poles": TransferFunction([3.0], np.poly(-np.geomspace(0.5, 50.0, 10))),
    "whole delay": TransferFunction([2.0], [1.0, 2.0], delay=0.1),
    "part of a step": TransferFunction([1.0, 2.0], [1.0, 2.0], delay=0.037),
    "many channels": TransferFunction(
        [[[2.0, 1.0], [3.0]], [[1.0, 0.0, 0.0], [5.0]]],
        [[[1.0, 2.0, 9.0], [1.0, 3.0]], [[1.0, 2.0, 9.0], [1.0]]],
        delay=[[0.03, 0.047], [0.0, 0.1]],
    ),
}


@needs_compiler
@pytest.mark.parametrize("which", MODELS)
@pytest.mark.fast("whole delay", "unstable")
def test_the_filter_in_c_is_the_exact_response_to_a_held_input(which, tmp_path):
    model, dt = MODELS[which], 0.02
    u = inputs(model.n_inputs)
    header = write_c_header(model, dt, tmp_path / "plant.h")
    expected = simulate(model, zeros_of(model, u, dt))
    found = run_in_c(header, u)
    np.testing.assert_allclose(found, expected, atol=1e-11 * np.abs(expected).max())


@needs_compiler
@pytest.mark.parametrize("rate", [1e-6, 1e6])
def test_the_scale_of_time_does_not_matter(rate, tmp_path):
    model = TransferFunction([2.0 * rate, 1.0 * rate**2], [1.0, 2.0 * rate, 9.0 * rate**2])
    u, dt = inputs(), 0.02 / rate
    expected = simulate(model, zeros_of(model, u, dt))
    found = run_in_c(write_c_header(model, dt, tmp_path / "plant.h"), u)
    np.testing.assert_allclose(found, expected, atol=1e-11 * np.abs(expected).max())


@needs_compiler
@pytest.mark.parametrize("prewarp", [None, 9.0])
def test_tustin_has_the_response_of_the_bilinear_transform(prewarp, tmp_path):
    model, dt, n = MODELS["second order"], 0.1, 4000
    path = write_c_header(model, dt, tmp_path / "plant.h", method="tustin", prewarp=prewarp)
    impulse = np.zeros((n, 1))
    impulse[0] = 1.0
    h = run_in_c(path, impulse)[:, 0]
    omega = np.array([0.5, 3.0, 9.0, 25.0])
    found = np.exp(-1j * np.outer(omega, np.arange(n)) * dt) @ h
    factor = 2 / dt if prewarp is None else prewarp / np.tan(prewarp * dt / 2)
    bent = factor * np.tan(omega * dt / 2)
    np.testing.assert_allclose(found, model.frequency_response(bent)[:, 0, 0], rtol=1e-9)
    if prewarp:
        exact = model.frequency_response([prewarp])[0, 0, 0]
        assert found[2] == pytest.approx(exact, rel=1e-9)


@needs_compiler
def test_tustin_keeps_whole_delays(tmp_path):
    model = TransferFunction([2.0], [1.0, 2.0], delay=0.3)
    late = run_in_c(write_c_header(model, 0.1, tmp_path / "late.h", method="tustin"), inputs())
    free = TransferFunction([2.0], [1.0, 2.0])
    soon = run_in_c(write_c_header(free, 0.1, tmp_path / "soon.h", method="tustin"), inputs())
    np.testing.assert_allclose(late[3:], soon[:-3], atol=1e-14)
    np.testing.assert_array_equal(late[:3], 0.0)


@needs_compiler
def test_single_precision_keeps_slow_poles(tmp_path):
    model, dt = TransferFunction([1.0], [1.0, 0.02, 1e-4]), 0.01
    header = write_c_header(model, dt, tmp_path / "slow.h", number="float")
    assert "double" not in header.read_text().split("*/", 1)[1]
    u = np.ones((60_000, 1))
    expected = simulate(model, zeros_of(model, u, dt))
    found = run_in_c(header, u, "float")
    assert np.abs(found - expected).max() < 2e-3 * np.abs(expected).max()


@needs_compiler
def test_an_estimate_is_a_filter_with_a_comment(single, tmp_path):
    header = write_c_header(single.estimate, 0.05, tmp_path / "short-period.h")
    text = header.read_text()
    assert "short_period_step" in text
    assert "a0 = " in text
    assert "elevator [rad]" in text
    assert "+-" in text
    other = tmp_path / "plain.h"
    other.write_text(text.replace("short_period", "plain").replace("SHORT_PERIOD", "PLAIN"))
    u = single.record.u
    expected = simulate(single.estimate.model, zeros_of(single.estimate.model, u, 0.05))
    np.testing.assert_allclose(run_in_c(other, u), expected, atol=1e-12)


@needs_compiler
def test_names_cannot_break_out_of_the_comment(tmp_path):
    model = TransferFunction(
        [1.0], [1.0, 1.0], input_names=["*/ int x = 1; /*"], output_names=["??/ (§)"]
    )
    run_in_c(write_c_header(model, 0.1, tmp_path / "safe.h"), inputs(n=3))


UNCHECKED = (
    "[*\\\n/ static void evil(void){} /",
    "???/",
    "*/ #error no",
    "/*/",
    "a\\",
    "x\u2028y\x85z\r\nsystem('ls')\n%{",
)


def with_unchecked(estimate, text):
    """The estimate with a unit and a name that no check has seen."""
    found = dataclasses.replace(estimate)
    object.__setattr__(found, "units", {"elevator": text, "q": text})
    model = TransferFunction.from_dict(estimate.model.to_dict())
    object.__setattr__(model, "output_names", (text,))
    object.__setattr__(found, "model", model)
    return found


@needs_compiler
@pytest.mark.parametrize("text", UNCHECKED)
@pytest.mark.fast("*/ #error no")
def test_what_no_check_has_seen_stays_in_the_comment(single, text, tmp_path):
    plain = c_header(single.estimate, 0.05, "m").split("*/", 1)[1]
    header = c_header(with_unchecked(single.estimate, text), 0.05, "m")
    assert header.split("*/", 1)[1] == plain
    (tmp_path / "m.h").write_text(header)
    command = [COMPILER, *STRICT, "-trigraphs", "-E", "-P", "m.h"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "evil" not in done.stdout
    run_in_c(
        write_c_header(with_unchecked(single.estimate, text), 0.05, tmp_path / "n.h"), inputs(n=3)
    )


@pytest.mark.parametrize("text", UNCHECKED)
def test_what_no_check_has_seen_makes_no_line_of_a_script(single, text, tmp_path):
    plain = write_matlab(single.estimate, tmp_path / "m.m").read_text("utf-8")
    script = write_matlab(with_unchecked(single.estimate, text), tmp_path / "m.m").read_text(
        "utf-8"
    )
    assert len(script.splitlines()) == len(plain.splitlines())
    assert all(one.isprintable() for one in script.split("\n"))
    write_matlab(with_unchecked(single.estimate, text), tmp_path / "m.mat")


@needs_compiler
def test_two_filters_fit_in_one_program(tmp_path):
    for name in ("first", "second"):
        write_c_header(MODELS["second order"], 0.1, tmp_path / f"{name}.h")
    (tmp_path / "both.c").write_text(
        '#include "first.h"\n#include "second.h"\n#include "first.h"\n'
        "int main(void) { first_t a; second_t b; first_init(&a); second_init(&b); return 0; }\n"
    )
    build = [COMPILER, *STRICT, "both.c", "-o", "both"]
    done = subprocess.run(build, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_same_model_gives_the_same_bytes(tmp_path, single):
    for name in ("model.h", "model.mat", "model.m", "model.json"):
        texts = []
        for folder in ("one", "two"):
            path = tmp_path / folder / name
            if name.endswith(".h"):
                write_c_header(single.estimate, 0.1, path)
            elif name.endswith(".json"):
                write_json(single.estimate, path)
            else:
                write_matlab(single.estimate, path)
            texts.append(path.read_bytes())
        assert texts[0] == texts[1], name


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"dt": 0.0}, OptionError, "dt"),
        ({"method": "euler"}, OptionError, "method"),
        ({"prewarp": 3.0}, OptionError, "prewarp"),
        ({"method": "tustin", "prewarp": 100.0}, OptionError, "half the sampling"),
        ({"number": "int"}, OptionError, "number"),
        ({"name": "for"}, OptionError, "identifier"),
        ({"name": "2nd"}, OptionError, "identifier"),
        ({"method": "tustin", "dt": 0.07}, UnsupportedError, "whole number of steps"),
        ({"dt": 1e-9}, OptionError, "steps"),
    ],
)
def test_filters_that_cannot_be_made_are_refused(options, error, words, tmp_path):
    model = TransferFunction([2.0], [1.0, 2.0], delay=0.1)
    given = {"dt": 0.1, "path": tmp_path / "plant.h", **options}
    dt, path = given.pop("dt"), given.pop("path")
    with pytest.raises(error, match=words):
        write_c_header(model, dt, path, **given)
    assert list(tmp_path.iterdir()) == []


def test_a_mat_file_holds_model_names_and_covariance(double, tmp_path):
    estimate = double.estimate
    content = loadmat(write_matlab(estimate, tmp_path / "model.mat"))["model"][0, 0]
    for i in range(2):
        np.testing.assert_array_equal(content["num"][i, 0][0], estimate.model.num[i][0])
        np.testing.assert_array_equal(content["den"][i, 0][0], estimate.model.den[i][0])
    assert [str(one[0][0]) for one in content["names"]] == list(estimate.names)
    np.testing.assert_array_equal(content["cov"], estimate.cov)
    np.testing.assert_array_equal(content["theta"][:, 0], estimate.theta)
    assert content["Ts"][0, 0] == 0.0
    assert str(content["InputName"][0, 0][0]) == "elevator"
    assert str(content["OutputUnit"][1, 0][0]) == "rad"


OCTAVE_PRINTS = """
printf('%.17g ', model.ioDelay); printf('\\n');
for i = 1:rows(model.num)
  for j = 1:columns(model.num)
    printf('%.17g ', model.num{{i, j}}); printf('\\n');
    printf('%.17g ', model.den{{i, j}}); printf('\\n');
  end
end
printf('%s\\n', model.InputName{{1}});
{more}
"""


def run_in_octave(folder, program):
    (folder / "driver.m").write_text(program, encoding="utf-8")
    command = [OCTAVE, "--no-gui", "--norc", "--quiet", "driver.m"]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@needs_octave
@pytest.mark.parametrize("kind", ["m", "mat"])
def test_octave_reads_both_files(kind, double, tmp_path):
    estimate = double.estimate
    write_matlab(estimate, tmp_path / f"plant.{kind}")
    load = "plant" if kind == "m" else "load('plant.mat')"
    more = "printf('%.17g ', model.cov); printf('\\n'); printf('%.17g ', model.theta);"
    lines = run_in_octave(tmp_path, f"{load};" + OCTAVE_PRINTS.format(more=more))
    rows = [np.array(line.split(), dtype=float) for line in lines[:5]]
    for i in range(2):
        np.testing.assert_array_equal(rows[1 + 2 * i], estimate.model.num[i][0])
        np.testing.assert_array_equal(rows[2 + 2 * i], estimate.model.den[i][0])
    assert lines[5] == "elevator"
    np.testing.assert_array_equal(np.array(lines[6].split(), float), estimate.cov.T.ravel())
    np.testing.assert_array_equal(np.array(lines[7].split(), float), estimate.theta)


@needs_octave
def test_octave_reads_the_script_of_a_model_with_delays_and_odd_names(tmp_path):
    model = TransferFunction(
        [[[1.0], [2.0, 3.0]]],
        [[[1.0, 0.1], [1.0, 2.0, 1 / 3]]],
        delay=[[0.0, 0.125]],
        input_names=["it's", "100%"],
    )
    write_matlab(model, tmp_path / "plant.m")
    lines = run_in_octave(tmp_path, "plant;" + OCTAVE_PRINTS.format(more=""))
    np.testing.assert_array_equal(np.array(lines[0].split(), float), [0.0, 0.125])
    np.testing.assert_array_equal(np.array(lines[4].split(), float), model.den[0][1])
    assert lines[5] == "it's"


def test_the_script_names_every_coefficient(double, tmp_path):
    text = write_matlab(double.estimate, tmp_path / "plant.m").read_text()
    assert "model.den = {[1 a1 a0]; [1 a1 a0]};" in text
    assert "b1_q_elevator = " in text


@pytest.mark.parametrize("name", ["model.txt", "my-model.m", "2.m"])
def test_names_that_matlab_cannot_use_are_refused(name, tmp_path):
    with pytest.raises(OptionError, match="rename"):
        write_matlab(MODELS["gain"], tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_json_of_a_model_and_of_an_estimate_is_read_back(single, tmp_path):
    model = MODELS["many channels"]
    content = json.loads(write_json(model, tmp_path / "model.json").read_text())
    assert content.pop("model_schema") == 1
    again = TransferFunction.from_dict(content)
    assert again.to_dict() == model.to_dict()
    path = write_json(single.estimate, tmp_path / "estimate.json")
    np.testing.assert_array_equal(Estimate.load(path).theta, single.estimate.theta)


def test_nothing_is_left_where_nothing_can_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    for write in (
        lambda path: write_json(MODELS["gain"], path / "a.json"),
        lambda path: write_matlab(MODELS["gain"], path / "a.mat"),
        lambda path: write_c_header(MODELS["gain"], 0.1, path / "a.h"),
    ):
        with pytest.raises(OutputPathError):
            write(tmp_path / "file")


def test_fixed_coefficients_are_named_in_the_script(single, tmp_path):
    assert single.estimate.structure == Structure(
        2, 0, offset=False, drift=False, initial_state="rest"
    )
    text = write_matlab(single.estimate, tmp_path / "plant.m").read_text()
    assert "model.num = {[b0]};" in text
