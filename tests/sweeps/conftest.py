"""Fixtures of the tests of sweeps."""

import pytest

from neoworld_mjx.sweeps import group_runs
from neoworld_mjx.sweeps.folder import SweepFolder


@pytest.fixture
def without_figures(monkeypatch):
    """Sweep as without the extra `plot`: drawing is half of the time of a small sweep."""
    monkeypatch.setattr(SweepFolder, "write_figure", lambda *_, **__: None)


@pytest.fixture(scope="module")
def compiled_once():
    """Most of the time of a small sweep is compiling its scene, which these tests share."""
    remaining, built = group_runs.compile_for_search, {}

    def compiled(scene, o):
        key = (scene.model_dump_json(), o.cem.sigma_xy, o.rollout.timestep_s)
        if key not in built:
            built[key] = remaining(scene, o)
        return built[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(group_runs, "compile_for_search", compiled)
        yield
