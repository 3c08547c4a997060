"""A structure: orders checked, coefficients named and ordered in one place."""

from __future__ import annotations

import copy
import dataclasses
import json
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tridentify import errors
from tridentify.structure import Structure


@st.composite
def structures(draw: st.DrawFn) -> tuple[Structure, int, int]:
    n_outputs, n_inputs = draw(st.integers(1, 3)), draw(st.integers(1, 3))

    def nested(entry: st.SearchStrategy) -> list:
        return draw(
            st.lists(
                st.lists(entry, min_size=n_inputs, max_size=n_inputs),
                min_size=n_outputs,
                max_size=n_outputs,
            )
        )

    poles = draw(st.integers(1, 5)) if draw(st.booleans()) else nested(st.integers(1, 5))
    lowest = poles if isinstance(poles, int) else min(map(min, poles))
    entry = st.integers(0, lowest)
    zeros = draw(entry) if draw(st.booleans()) else nested(entry)
    delay = draw(st.sampled_from([0.0, 0.25, "free"]))
    return Structure(poles, zeros, delay=delay), n_outputs, n_inputs


def channels(n_outputs: int, n_inputs: int) -> tuple[list[str], list[str]]:
    return [f"in{j}" for j in range(n_inputs)], [f"out{i}" for i in range(n_outputs)]


def test_one_channel_has_plain_names() -> None:
    assert Structure(3, 1).names() == ("a2", "a1", "a0", "b1", "b0")
    assert Structure(1, 1).names(["e"], ["q"]) == ("a0", "b1", "b0")
    assert Structure([[2]], [[0]]).names(["e"], ["q"]) == ("a1", "a0", "b0")


def test_a_shared_denominator_comes_first() -> None:
    names = Structure(2, [[1, 0], [0, 0]]).names(["e", "r"], ["q", "al"])
    assert names == ("a1", "a0", "b1[q,e]", "b0[q,e]", "b0[q,r]", "b0[al,e]", "b0[al,r]")


def test_separate_denominators_come_before_their_numerators() -> None:
    names = Structure([[2], [1]], [[1], [0]]).names(["e"], ["q", "al"])
    assert names == ("a1[q,e]", "a0[q,e]", "b1[q,e]", "b0[q,e]", "a0[al,e]", "b0[al,e]")


def test_free_delays_come_last() -> None:
    assert Structure(1, 0, delay="free").names() == ("a0", "b0", "delay")
    names = Structure(1, 0, delay="free").names(["e", "r"], ["q"])
    assert names[-2:] == ("delay[e]", "delay[r]")
    assert Structure(1, 0, delay="free").delay_matrix(1, 2) == ((0.0, 0.0),)


@given(structures())
def test_names_are_distinct_and_as_many_as_parameters(case: tuple[Structure, int, int]) -> None:
    structure, n_outputs, n_inputs = case
    names = structure.names(*channels(n_outputs, n_inputs))
    assert len(names) == len(set(names)) == structure.n_parameters(n_outputs, n_inputs)


@given(structures())
def test_split_puts_every_coefficient_where_its_name_says(case: tuple[Structure, int, int]) -> None:
    structure, n_outputs, n_inputs = case
    names_in, names_out = channels(n_outputs, n_inputs)
    names = structure.names(names_in, names_out)
    theta = np.arange(10.0, 10.0 + len(names))
    num, den = structure.split(theta, n_outputs, n_inputs)
    value = dict(zip(names, theta, strict=True))
    several = n_outputs * n_inputs > 1
    for i, output in enumerate(names_out):
        for j, source in enumerate(names_in):
            where = f"[{output},{source}]" if several else ""
            own = "" if structure.shared else where
            n = structure.poles_matrix(n_outputs, n_inputs)[i][j]
            m = structure.zeros_matrix(n_outputs, n_inputs)[i][j]
            assert den[i][j].tolist() == [1.0] + [value[f"a{k}{own}"] for k in range(n - 1, -1, -1)]
            assert num[i][j].tolist() == [value[f"b{k}{where}"] for k in range(m, -1, -1)]


@given(structures())
def test_a_structure_survives_json_pickle_and_copy(case: tuple[Structure, int, int]) -> None:
    structure = case[0]
    assert Structure.from_dict(json.loads(json.dumps(structure.to_dict()))) == structure
    assert pickle.loads(pickle.dumps(structure)) == structure
    assert copy.deepcopy(structure) == structure
    assert hash(copy.copy(structure)) == hash(structure)


def test_constraints_survive_json_and_cannot_be_changed() -> None:
    structure = Structure(2, 1, fixed={"a0": 3}, bounds={"b0": (0, None), "b1": (-np.inf, 2)})
    twin = Structure.from_dict(json.loads(json.dumps(structure.to_dict())))
    assert twin == structure
    assert dict(twin.fixed) == {"a0": 3.0}
    assert dict(twin.bounds) == {"b0": (0.0, None), "b1": (None, 2.0)}
    with pytest.raises(TypeError):
        structure.fixed["a0"] = 4.0


def test_all_that_is_known_survives_json_and_cannot_be_changed() -> None:
    structure = Structure(
        2,
        1,
        equalities=[({"b0": 1, "a0": -2, "a1": 0.0}, 0)],
        priors={"a1": [1, 0.1]},
        static_gain=np.float64(2.0),
    )
    twin = Structure.from_dict(json.loads(json.dumps(structure.to_dict())))
    assert twin == structure == pickle.loads(pickle.dumps(structure))
    ((weights, value),) = twin.equalities
    assert (dict(weights), value) == ({"b0": 1.0, "a0": -2.0}, 0.0)
    assert dict(twin.priors) == {"a1": (1.0, 0.1)}
    assert twin.static_gain == 2.0
    with pytest.raises(TypeError):
        weights["b0"] = 4.0


def test_a_structure_says_whether_anything_is_known() -> None:
    assert not Structure(2, 1).constrained
    assert Structure(2, 1, static_gain=0.0).constrained
    assert Structure(2, 1, static_gain=[[None, 2.0]]).gain_matrix(1, 2) == ((None, 2.0),)
    assert Structure(2, 1, priors={"a0": (1.0, 0.1)}, fixed={"b0": 1.0}).known == ("b0", "a0")
    with pytest.raises(errors.StaticGainError, match="expected 2 x 1"):
        Structure(2, 1, static_gain=[[1.0, 2.0]]).gain_matrix(2, 1)


def test_replace_resolves_a_choice() -> None:
    resolved = dataclasses.replace(Structure(2, 1, delay=0.1), offset=True, initial_state="rest")
    assert (resolved.offset, resolved.initial_state, resolved.delay) == (True, "rest", 0.1)


def test_lists_arrays_and_numpy_numbers_are_the_same_orders() -> None:
    expected = Structure(((2, 2),), ((1, 0),))
    assert Structure([[2, 2]], [[1, 0]]) == expected
    assert Structure(np.array([[2, 2]]), np.array([[1, 0]])) == expected
    assert Structure(np.int64(2), np.uint8(1)) == Structure(2, 1)


BAD = [
    (errors.OrderError, (0, 0), {}, "poles=0"),
    (errors.OrderError, (-1, 0), {}, "poles=-1"),
    (errors.OrderError, (2.0, 0), {}, r"poles=2\.0"),
    (errors.OrderError, ("2", 0), {}, "poles='2'"),
    (errors.OrderError, (True, 0), {}, "poles=True"),
    (errors.OrderError, (2, -1), {}, "zeros=-1"),
    (errors.OrderError, (2, None), {}, "zeros=None"),
    (errors.OrderError, (2, 3), {}, "3 zeros with 2 poles"),
    (errors.OrderError, ([[3, 1]], 2), {}, "2 zeros with 1 poles"),
    (errors.OrderError, ([[2.5]], 1), {}, r"poles=2\.5"),
    (errors.ChannelCountError, (2, [1, 0]), {}, "nest it twice"),
    (errors.ChannelCountError, (2, []), {}, "nest it twice"),
    (errors.ChannelCountError, (2, [[1], [1, 0]]), {}, "equally long rows"),
    (errors.ChannelCountError, ([[2]], [[1, 0]]), {}, "nest them alike"),
    (errors.ChannelCountError, ([[2]], 0), {"delay": [[0.1, 0.1]]}, "delay for 1 x 2"),
    (errors.OptionError, (2, 1), {"delay": -0.1}, "delay=-0.1"),
    (errors.OptionError, (2, 1), {"delay": np.nan}, "delay=nan"),
    (errors.OptionError, (2, 1), {"delay": "auto"}, "'free' to estimate"),
    (errors.OptionError, (2, 1), {"offset": 1}, "offset=1"),
    (errors.OptionError, (2, 1), {"drift": "yes"}, "drift='yes'"),
    (errors.OptionError, (2, 1), {"initial_state": "zero"}, "'equilibrium'"),
    (errors.ParameterNameError, (2, 1), {"fixed": {"a2": 1.0}}, "'a2'"),
    (errors.ParameterNameError, (2, 1), {"bounds": {"b2": (0, 1)}}, "'b2'"),
    (errors.ParameterNameError, (2, 1), {"fixed": {"gain": 1.0}}, "'gain'"),
    (errors.ParameterNameError, (2, 1), {"fixed": {"delay": 1.0}}, "'delay'"),
    (errors.BoundsError, (2, 1), {"fixed": {"a0": np.nan}}, "fixed value nan"),
    (errors.BoundsError, (2, 1), {"fixed": {"a0": "3"}}, "fixed value '3'"),
    (errors.BoundsError, (2, 1), {"fixed": [("a1", 2)]}, "mapping of coefficient to value"),
    (errors.BoundsError, (2, 1), {"fixed": "a1=2"}, "fixed='a1=2'"),
    (errors.BoundsError, (2, 1), {"bounds": [("a1", (0, 1))]}, "mapping of coefficient to .low"),
    (errors.BoundsError, (2, 1), {"bounds": "a1>0"}, "bounds='a1>0'"),
    (errors.BoundsError, (2, 1), {"bounds": {"a0": (1, 0)}}, "low < high"),
    (errors.BoundsError, (2, 1), {"bounds": {"a0": 3}}, "low < high"),
    (errors.BoundsError, (2, 1), {"bounds": {"a0": (0, "x")}}, "low < high"),
    (errors.BoundsError, (2, 1), {"fixed": {"a0": 1}, "bounds": {"a0": (0, 2)}}, "both fixed"),
    (errors.ParameterNameError, (2, 1), {"equalities": [({"a7": 1.0}, 0.0)]}, "'a7'"),
    (errors.ParameterNameError, (2, 1), {"priors": {"b7": (1.0, 0.1)}}, "'b7'"),
    (errors.EqualityError, (2, 1), {"equalities": {"a0": 1.0}}, "weights by coefficient"),
    (errors.EqualityError, (2, 1), {"equalities": [({"a0": 1.0},)]}, "weights by coefficient"),
    (errors.EqualityError, (2, 1), {"equalities": [("a0", 1.0)]}, "weights by coefficient"),
    (errors.EqualityError, (2, 1), {"equalities": [({"a0": np.nan}, 1.0)]}, "nan"),
    (errors.EqualityError, (2, 1), {"equalities": [({"a0": 1.0}, np.inf)]}, "inf"),
    (errors.EqualityError, (2, 1), {"equalities": [({"a0": 0.0}, 1.0)]}, "not zero"),
    (errors.EqualityError, (2, 1), {"equalities": [({}, 0.0)]}, "not zero"),
    (errors.PriorError, (2, 1), {"priors": [("a0", 1.0)]}, "mapping"),
    (errors.PriorError, (2, 1), {"priors": {"a0": 3.0}}, "standard deviation"),
    (errors.PriorError, (2, 1), {"priors": {"a0": (3.0, 0.0)}}, "above zero"),
    (errors.PriorError, (2, 1), {"priors": {"a0": (3.0, -0.1)}}, "above zero"),
    (errors.PriorError, (2, 1), {"priors": {"a0": (np.nan, 0.1)}}, "finite"),
    (errors.PriorError, (2, 1), {"priors": {"a0": (3.0, np.inf)}}, "finite"),
    (errors.StaticGainError, (2, 1), {"static_gain": np.inf}, "static_gain=inf"),
    (errors.StaticGainError, (2, 1), {"static_gain": "2"}, "static_gain='2'"),
    (errors.StaticGainError, (2, 1), {"static_gain": [1.0]}, "nest it twice"),
    (errors.StaticGainError, (2, 1), {"static_gain": [[1.0, np.nan]]}, "static_gain=nan"),
    (errors.StaticGainError, ([[2]], 0), {"static_gain": [[1.0, 2.0]]}, "1 outputs x 2 inputs"),
]


@pytest.mark.parametrize(("error", "orders", "options", "words"), BAD)
def test_senseless_structures_are_refused(error: type, orders, options, words: str) -> None:
    with pytest.raises(error, match=words) as caught:
        Structure(*orders, **options)
    assert type(caught.value) is error
    assert "\n" not in str(caught.value)
    assert "expected" in str(caught.value)


def test_a_single_channel_shares_its_denominator() -> None:
    nested = Structure([[2]], [[1]], fixed={"a0": 3.0})
    assert nested.shared
    assert nested.common_poles == Structure(2, 1).common_poles == 2
    separate = Structure([[2, 2]], 1)
    assert not separate.shared
    with pytest.raises(errors.ChannelCountError, match="separate denominators"):
        _ = separate.common_poles


def test_nested_orders_must_fit_the_record() -> None:
    structure = Structure(2, [[1], [0]])
    for call in (structure.zeros_matrix, structure.n_parameters):
        with pytest.raises(errors.ChannelCountError, match="zeros for 2 outputs x 1 inputs"):
            call(1, 1)
    with pytest.raises(errors.ChannelCountError, match=r"theta of shape \(2,\)"):
        structure.split([1.0, 2.0], 2, 1)


def test_a_constraint_on_no_coefficient_is_refused_once_the_channels_are_known() -> None:
    structure = Structure(2, 0, fixed={"b0[q,e]": 1.0})
    assert structure.names(["e"], ["q", "al"])[2] == "b0[q,e]"
    with pytest.raises(errors.ParameterNameError, match="expected one of a1, a0"):
        structure.names(["r"], ["q", "al"])


@pytest.mark.parametrize("content", [{}, {"poles": 2}, {"poles": 2, "zeros": 1, "colour": "red"}])
def test_a_damaged_dictionary_is_refused(content: dict) -> None:
    with pytest.raises(errors.StructureError, match="restore the file"):
        Structure.from_dict(content)


def test_a_wrong_value_in_a_dictionary_keeps_its_own_error() -> None:
    with pytest.raises(errors.OptionError, match="offset='maybe'"):
        Structure.from_dict({"poles": 2, "zeros": 1, "offset": "maybe"})
