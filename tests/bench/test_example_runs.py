"""The suite of the bundled examples."""

import pytest
from neoworld_bench import suites
from neoworld_bench.photographs.example_runs import example_jobs

from neoworld_mjx.config import load_config
from neoworld_mjx.errors import PhotoError
from neoworld_mjx.pipeline.bundled_examples import bundled_examples


def test_every_example_is_a_job_and_unknown_ones_are_refused():
    assert list(example_jobs((), load_config())) == list(bundled_examples())
    options = suites.Examples(example=("microwaves",))
    with pytest.raises(PhotoError, match="did you mean 'microwave'"):
        suites.SUITES["examples"].load()(options, load_config())
