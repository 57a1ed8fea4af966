"""The release has one version, and its credits, workflows and containers name existing files."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml

import neoworld_mjx
from neoworld_mjx.pipeline.bundled_examples import bundled_examples

ROOT = Path(__file__).parents[1]


def text_of(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_version_is_the_same_everywhere_and_has_notes():
    project = tomllib.loads(text_of("pyproject.toml"))["project"]
    released = re.findall(
        r"^## \[(\d+\.\d+\.\d+)\] - \d{4}-\d{2}-\d{2}$", text_of("CHANGELOG.md"), re.M
    )
    cited = yaml.safe_load(text_of("CITATION.cff"))["version"]
    assert project["version"] == neoworld_mjx.__version__ == cited == released[0]


@pytest.mark.parametrize("name", sorted(bundled_examples()))
def test_a_bundled_photograph_is_credited_with_its_licence(name):
    example = bundled_examples()[name]
    (credit,) = re.findall(
        rf"^{re.escape(example.photo.name)}\n((?: {{4}}.*\n)+)", text_of("NOTICE"), re.M
    )
    spelt = {
        "CC0": "CC0 1.0",
        "Apache-2.0": "Apache License, Version 2.0",
        "CC-BY-4.0": "CC BY 4.0",
    }
    assert spelt[example.licence] in credit
    (row,) = re.findall(
        rf"^\| `{re.escape(example.photo.name)}` .*$", text_of("examples/README.md"), re.M
    )
    assert row.endswith(f"| {example.licence} |")
