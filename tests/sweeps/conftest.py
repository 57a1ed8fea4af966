"""Fixtures of the tests of sweeps."""

import pytest

from neoworld_mjx.sweeps.folder import SweepFolder


@pytest.fixture
def without_figures(monkeypatch):
    """Sweep as without the extra `plot`: drawing is half of the time of a small sweep."""
    monkeypatch.setattr(SweepFolder, "write_figure", lambda *_, **__: None)
