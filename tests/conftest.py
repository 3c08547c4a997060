"""What every test may use."""

from __future__ import annotations

import os
import re
from pathlib import Path

import hypothesis
import pytest

os.environ.setdefault("MPLBACKEND", "Agg")

# The same examples on every run and no deadline: a first call may compile a kernel.
# HYPOTHESIS_PROFILE=explore looks for new examples; `make test` takes fewer (quick).
hypothesis.settings.register_profile("fixed", deadline=None, derandomize=True)
hypothesis.settings.register_profile("quick", deadline=None, derandomize=True, max_examples=25)
hypothesis.settings.register_profile("explore", deadline=None, max_examples=1000)
hypothesis.settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "fixed"))

REPOSITORY = Path(__file__).resolve().parents[1]

TWINS = re.compile(
    r"run\.feather"
    r"|test_online_invariance.*, forgetting\]"
    r"|test_no_process_outlives_the_caller\[9-2"
    r"|test_notes_do_not_depend_on_units\[(ladder|motor, current)"
    r"|test_stream_command.*(is_what_the_record_gives|with_a_delay_gaps|whatever_stands_between)"
    r"|taken_up_where_it_ended\[(100|4000|45678|60001)"
    r"|test_stream_command.*(part_missing_is_refused_in_one_line\[counts|grows_in_halves_of_lines)"
    r"|test_stream_command.*(a_known_step_takes_the_place|json_gives_what_csv_gives)"
    r"|test_online_disturbances.*\[.*(gradient|kalman|least squares)"
    r"|contract/test_online\.py.*\[.*(gradient|kalman)"
    r"|test_cautions_sensors.*\[auto-"
    r"|test_every_format(?!.*the_record_comes_back).*\[run\.mf4"
    r"|test_the_function_wins_over.*(importlib|-from |import tridentify\.methods)"
    r"|part_missing_is_refused_in_one_line\[(reader|timeline|question|mark)"
    r"|test_attas_(both_outputs|noise_is_coloured).*data_2"
    r"|real/(test_rcrc_circuit|test_flight_physical)"
    r"|test_free_delay.*\[output-error"
    r"|test_notes_hold_everywhere\[(ladder|motor, speed, two known)"
    r"|test_report.*(long_record_makes_a_small_page|several_experiments_each_get)"
    r"|test_saturation_is_noticed.*-0\.05-0\.5-"
    r"|test_unstable_and_integrating.*(integrator and pair|unstable pair)"
    r"|(test_a_stretch_and_a_stated_step|lists_those_that_are|nothing_is_printed)\[run\.mf4"
    r"|test_flat_tops_of_a_fast_system_raise_no_alarm\[0\.003-"
    r"|test_one_sample_in_twenty_is_an_outlier\[(gradient|least)"
    r"|test_long_records_have_the_same_states\[pairs"
    r"|test_blocks_are_steps_for_every_estimator\[damaged-three models, "
    r"|test_blocks_are_steps_for_every_estimator\[plain-.*(started|forgetting)"
    r"|test_blocks_are_steps_for_every_structure\[three models-(late|proper|equilibrium)"
    r"|test_blocks_are_steps_for_every_structure\[forgetting-(late|proper|equilibrium)"
)
"""Tests of some seconds whose twin, with another value or by another way, runs every time."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the twins as slow."""
    for item in items:
        if TWINS.search(item.nodeid):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def repository() -> Path:
    """The folder of this checkout."""
    return REPOSITORY


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder with the public records, which are not part of this repository.

    It is `../shared/data` beside the checkout, or what TRIDENTIFY_SHARED_DATA names.
    """
    named = os.environ.get("TRIDENTIFY_SHARED_DATA")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        if named:
            pytest.fail(f"TRIDENTIFY_SHARED_DATA names {named}, which is not a folder")
        pytest.skip("no ../shared/data beside the repository; TRIDENTIFY_SHARED_DATA may name it")
    return folder
