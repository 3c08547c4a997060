"""Signals: correlation, spectra, crest factors, and what is refused."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from tridentify import TransferFunction, read_record, simulate
from tridentify.errors import OptionError, OutputPathError, ShapeError
from tridentify.excitation import (
    Excitation,
    chirp,
    doublet,
    multisine,
    prbs,
    three_two_one_one,
)
from tridentify.excitation.multisine import crest, low_crest, schroeder, signal_of
from tridentify.excitation.prbs import TAPS, sequence


def autocorrelation(u):
    return np.fft.irfft(np.abs(np.fft.rfft(u)) ** 2, u.size) / u.size


@pytest.mark.parametrize("order", [n for n in TAPS if n <= 16])
def test_prbs_has_the_autocorrelation_of_a_maximum_length_sequence(order):
    u = prbs(order, dt=1.0).u[:, 0]
    assert u.size == 2**order - 1
    assert np.sum(u > 0) == 2 ** (order - 1)
    r = autocorrelation(u)
    np.testing.assert_allclose(r[0], 1.0)
    np.testing.assert_allclose(r[1:], -1.0 / u.size, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("order", [17, 18, 19, 20])
def test_long_registers_run_through_all_states(order):
    r = autocorrelation(2.0 * sequence(order) - 1.0)
    np.testing.assert_allclose(r[1:], -1.0 / r.size, atol=1e-9)


def test_every_register_gives_the_same_sequence_from_another_place():
    first = sequence(7)
    other = sequence(7, [0, 0, 1, 0, 1, 1, 0])
    assert not np.array_equal(first, other)
    assert any(np.array_equal(np.roll(first, k), other) for k in range(first.size))


def test_the_register_is_what_the_signal_begins_with():
    np.testing.assert_array_equal(sequence(4, [1, 0, 0, 1])[:4], [1, 0, 0, 1])
    np.testing.assert_array_equal(sequence(4, [1, 0, 0, 0])[:4], [0, 0, 0, 1])


def test_prbs_holds_its_bits_and_uses_the_levels():
    plan = prbs(5, dt=0.02, clock=0.1, levels=(0.0, 3.0), periods=2)
    assert plan.n_samples == 2 * 31 * 5
    assert plan.period == 31 * 5
    blocks = plan.u[:, 0].reshape(-1, 5)
    assert np.all(blocks == blocks[:, :1])
    assert set(np.unique(plan.u)) == {0.0, 3.0}
    np.testing.assert_array_equal(plan.u[:155], plan.u[155:])


def test_inputs_of_a_prbs_are_correlated_at_one_lag_only():
    u = prbs(8, dt=1.0, n_inputs=2).u
    r = np.fft.irfft(np.fft.rfft(u[:, 0]) * np.conj(np.fft.rfft(u[:, 1])), 255) / 255
    assert np.sum(np.abs(r) > 0.5) == 1
    assert abs(r[0]) < 0.005


def test_doublet_has_most_energy_where_it_is_meant_to():
    w = 4.0
    plan = doublet(0.1, dt=1e-3, for_frequency=w, lead=1.0, tail=200.0)
    omega, lines = plan.spectrum()
    assert omega[np.argmax(lines)] == pytest.approx(w, rel=0.03)
    assert plan.u.sum() == 0.0
    assert plan.u[999, 0] == 0.0
    assert plan.u[1000, 0] == 0.1


def test_three_two_one_one_excites_its_frequency_with_more_than_half_its_largest_line():
    plan = three_two_one_one(1.0, dt=1e-3, for_frequency=2.0, tail=100.0)
    omega, lines = plan.spectrum()
    at = np.interp(2.0, omega, lines[:, 0])
    assert at > 0.5 * lines.max()
    assert plan.n_samples == 7 * 800 + 100_000


@pytest.mark.parametrize("sweep", ["linear", "logarithmic"])
def test_chirp_has_its_power_in_the_band_and_rests_at_the_ends(sweep):
    plan = chirp((1.0, 20.0), 100.0, dt=0.02, amplitude=0.3, sweep=sweep)
    omega, lines = plan.spectrum()
    power = lines[:, 0] ** 2
    inside = (omega >= 0.9) & (omega <= 22.0)
    assert power[inside].sum() > 0.97 * power.sum()
    assert plan.u[0, 0] == 0.0
    assert abs(plan.u[-1, 0]) < 1e-6
    assert plan.amplitude[0] == pytest.approx(0.3, rel=1e-3)
    halves = [power[(omega > a) & (omega < b)].sum() for a, b in ((1.5, 4.0), (8.0, 18.0))]
    share = halves[0] / sum(halves)
    assert share == pytest.approx(2.5 / 12.5 if sweep == "linear" else 0.547, abs=0.05)


def test_multisine_has_the_lines_and_powers_asked_for_and_no_others():
    plan = multisine(8.0, dt=0.05, harmonics=[3, 9, 5], power=[4.0, 1.0, 0.0], amplitude=2.0)
    omega, lines = plan.spectrum()
    np.testing.assert_allclose(omega[3], 2 * np.pi * 3 / 8.0)
    there = lines[:, 0] > 1e-9
    np.testing.assert_array_equal(np.flatnonzero(there), [3, 9])
    assert lines[3, 0] / lines[9, 0] == pytest.approx(2.0)
    assert plan.amplitude[0] == pytest.approx(2.0)


@pytest.mark.parametrize(("n_lines", "most"), [(1, 1.4143), (7, 1.45), (31, 1.45), (120, 1.5)])
def test_multisine_has_a_low_crest_factor(n_lines, most):
    plan = multisine(20.0, dt=0.02, harmonics=range(1, n_lines + 1))
    assert plan.crest_factor[0] < most


def test_phases_are_never_worse_than_schroeders():
    rng = np.random.default_rng(0)
    for size in (2, 5, 40):
        lines = np.sort(rng.choice(np.arange(1, 100), size, replace=False))
        level = rng.uniform(0.1, 1.0, size)
        found = crest(signal_of(lines, level, low_crest(lines, level, 512), 512))
        assert found <= crest(signal_of(lines, level, schroeder(level), 512))


@pytest.mark.slow
def test_inputs_of_a_multisine_are_orthogonal_and_share_the_band():
    plan = multisine(10.0, dt=0.02, band=(0.6, 15.0), n_inputs=3, amplitude=[1.0, 2.0, 0.5])
    gram = plan.u.T @ plan.u
    np.testing.assert_allclose(gram, np.diag(np.diag(gram)), atol=1e-9 * gram.max())
    np.testing.assert_allclose(plan.amplitude, [1.0, 2.0, 0.5])
    omega, lines = plan.spectrum()
    for column in lines.T:
        own = omega[column > 1e-9]
        assert 0.6 <= own[0] < 2.6
        assert 13.0 < own[-1] <= 15.0


def test_each_period_begins_near_zero():
    plan = multisine(10.0, dt=0.02, band=(0.6, 15.0))
    assert abs(plan.u[0, 0]) < 0.05


def test_a_seed_makes_the_same_multisine_again():
    first, again = (multisine(5.0, dt=0.05, harmonics=[1, 2, 5], seed=3) for _ in range(2))
    np.testing.assert_array_equal(first.u, again.u)


def test_an_excitation_is_a_value():
    plan = doublet(1.0, 0.5, dt=0.1)
    with pytest.raises(ValueError, match="read-only"):
        plan.u[0] = 2.0
    again = pickle.loads(pickle.dumps(plan))
    np.testing.assert_array_equal(again.u, plan.u)
    assert again.what == plan.what
    assert plan.scaled(3.0).amplitude[0] == 3.0
    assert plan.repeated(2).n_samples == 2 * plan.n_samples
    assert "crest factor" in plan.summary()
    assert "<table>" in plan._repr_html_()
    assert plan._repr_html_().count("<svg") == 1


def test_a_plan_becomes_a_record():
    plan = doublet(1.0, 0.5, dt=0.1).named(["elevator"], {"elevator": "rad"})
    model = TransferFunction([1.0], [1.0, 1.0])
    y = simulate(model, plan.record())
    record = plan.record(y, output_names=["q"])
    assert record.input_names == ("elevator",)
    assert record.units["elevator"] == "rad"
    assert record.dt == 0.1
    assert record.intersample == "zoh"
    assert plan.record(output_names=["q", "r"]).n_outputs == 2


def test_saved_plans_are_read_back_without_a_digit_lost(tmp_path):
    plan = multisine(3.0, dt=0.1, band=(2.0, 12.0), n_inputs=2, amplitude=[0.1, 1 / 3])
    plan = plan.named(["elevator", "aileron"], {"elevator": "rad"})
    path = plan.save(tmp_path / "new" / "plan.csv")
    again = read_record(path, time="t", inputs=["elevator"], outputs=["aileron"])
    np.testing.assert_array_equal(again.u[:, 0], plan.u[:, 0])
    np.testing.assert_array_equal(again.y[:, 0], plan.u[:, 1])
    assert again.dt == pytest.approx(0.1)
    assert again.units["elevator"] == "rad"


def test_a_folder_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputPathError):
        doublet(1.0, 0.5, dt=0.1).save(tmp_path / "file" / "plan.csv")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: prbs(1, dt=0.1), "expected 2 to 20"),
        (lambda: prbs(5, dt=0.1, clock=0.25), "whole number of sampling"),
        (lambda: prbs(5, dt=-0.1), "dt"),
        (lambda: prbs(5, dt=0.1, levels=(1.0, 1.0)), "levels"),
        (lambda: prbs(3, dt=0.1, register=[0, 0, 0]), "not all zero"),
        (lambda: prbs(3, dt=0.1, register=[1, 0]), "3 bits"),
        (lambda: prbs(3, dt=0.1, periods=0), "periods"),
        (lambda: doublet(1.0, dt=0.1), "width"),
        (lambda: doublet(1.0, 0.5, dt=0.1, for_frequency=3.0), "one of the two"),
        (lambda: doublet(0.0, 0.5, dt=0.1), "amplitude"),
        (lambda: doublet(1.0, 0.01, dt=0.1), "at least one sample"),
        (lambda: doublet(1.0, 0.5, dt=0.1, tail=-1.0), "tail"),
        (lambda: three_two_one_one(1.0, dt=0.1, for_frequency=0.0), "for_frequency"),
        (lambda: chirp((1.0, 40.0), 10.0, dt=0.1), "half"),
        (lambda: chirp((5.0, 1.0), 10.0, dt=0.1), "band"),
        (lambda: chirp((0.0, 1.0), 10.0, dt=0.1, sweep="logarithmic"), "sweep"),
        (lambda: chirp((0.1, 1.0), 10.0, dt=0.1, taper=2.0), "taper"),
        (lambda: multisine(1.0, dt=0.1), "band and harmonics"),
        (lambda: multisine(1.0, dt=0.1, harmonics=[0, 1]), "harmonics"),
        (lambda: multisine(1.0, dt=0.1, harmonics=[5]), "harmonics"),
        (lambda: multisine(1.0, dt=0.1, harmonics=[[1, 2], [2, 3]]), "every line once"),
        (lambda: multisine(1.0, dt=0.1, harmonics=[1, 2], power=[1.0]), "power"),
        (lambda: multisine(1.0, dt=0.1, harmonics=[1, 2], power=[1.0, -1.0]), "power"),
        (lambda: multisine(1.05, dt=0.1, harmonics=[1]), "whole number"),
        (lambda: multisine(1.0, dt=0.1, band=(1.0, 3.0)), "lengthen the period"),
        (lambda: multisine(1.0, dt=0.1, harmonics=[1], amplitude=0.0), "amplitude"),
        (lambda: doublet(1.0, 1e9, dt=1e-6), "at most"),
        (lambda: doublet(1.0, 0.5, dt=0.1).scaled([1.0, 2.0]), "factor"),
        (lambda: Excitation(np.ones(4), 0.1, intersample="spline"), "intersample"),
    ],
)
def test_what_makes_no_signal_is_refused_in_one_line(make, words):
    with pytest.raises(OptionError, match=words) as caught:
        make()
    assert "found" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("u", [[1.0], [[np.nan], [1.0]], np.zeros((3, 0)), "text"])
def test_samples_that_are_none_are_refused(u):
    with pytest.raises(ShapeError):
        Excitation(u, 0.1)
