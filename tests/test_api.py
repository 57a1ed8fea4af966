"""The public names, and errors for arguments of a wrong type."""

import inspect

import pytest

import neoworld_mjx as nw
from neoworld_mjx.errors import ConfigError


def test_every_public_name_resolves_and_has_a_docstring():
    for name in nw.__all__:
        assert getattr(nw, name).__doc__, name
    assert set(nw.__all__) <= set(dir(nw))
    with pytest.raises(AttributeError, match="no attribute 'refin'"):
        nw.refin  # noqa: B018


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((3, "out"), "photo must be a path, got int"),
        (("photo.png", None), "out must be a path, got NoneType"),
        (("photo.png", "out", {"seed": 1}), r"config must be a Config, got dict: .*load_config"),
    ],
)
def test_reconstruct_names_an_argument_of_a_wrong_type(arguments, message):
    with pytest.raises(ConfigError, match=message):
        inspect.unwrap(nw.reconstruct)(*arguments)
