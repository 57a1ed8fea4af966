from pathlib import Path

import pytest
import yaml

from neoworld_mjx.config import Config, list_options, load_config
from tests.option_pages import differences_page, options_page

CONFIGS = Path(__file__).parents[1] / "configs"


def _keys(tree, at=()):
    if not isinstance(tree, dict) or not tree:
        return {at}
    return set().union(*(_keys(value, (*at, key)) for key, value in tree.items()))


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.name)
def test_every_configuration_loads_and_survives_a_round_trip(path):
    config = load_config(path)
    again = Config.model_validate(yaml.safe_load(yaml.safe_dump(config.model_dump(mode="json"))))
    assert again == config


def test_generated_pages_match_the_declarations():
    stale = "regenerate them: python -m tests.option_pages --write"
    docs = CONFIGS.parent / "docs"
    assert (docs / "options.md").read_text() == options_page(), stale
    page = (docs / "differences-from-the-paper.md").read_text()
    assert page == differences_page(), stale


UNITS = {"_m": "m", "_m_s": "m/s", "_s": "s", "_deg": "deg", "_px": "px"}
UNITS |= {"_usd": "USD", "_mib": "MiB"}


def test_an_option_has_a_meaning_a_unit_and_its_values():
    for option in list_options(Config):
        assert option.meaning.endswith((".", "`.")), option.path
        endings = [ending for ending in UNITS if option.path.endswith(ending)]
        if endings:
            assert option.unit == UNITS[max(endings, key=len)], option.path
        assert all(value in option.meaning for value in option.values), option.path


DIFFERENCES = [option for option in list_options(Config) if option.difference is not None]


def test_paper_yaml_sets_the_value_of_the_paper():
    paper = yaml.safe_load((CONFIGS / "paper.yaml").read_text())
    for option in DIFFERENCES:
        given = paper
        for step in option.path.split("."):
            assert step in given, f"configs/paper.yaml must set {option.path}"
            given = given[step]
        assert given == option.difference.value != option.default, option.path
        assert option.difference.reason.endswith("."), option.path


def test_steps_with_differences_from_the_paper():
    groups = {option.path.split(".")[0] for option in DIFFERENCES}
    assert groups == {"program", "verify", "compose", "refine"}
    assert len(DIFFERENCES) >= 15


def test_paper_states_what_the_appendix_states():
    cem = load_config(CONFIGS / "paper.yaml").refine.cem
    assert (cem.sigma_xy, cem.sigma_yaw_deg, cem.sigma_log_scale) == (0.05, 15.0, 0.1)


def test_paper_names_every_option_of_the_search_and_the_reward():
    given = yaml.safe_load((CONFIGS / "paper.yaml").read_text())["refine"]
    every = Config().model_dump(mode="json")["refine"]
    assert _keys(given["cem"]) == _keys(every["cem"])
    assert _keys(given["settle"]) == _keys(every["settle"])
    assert _keys(given["reward"]) == _keys(every["reward"]) - {("terms",)}


def test_fast_keeps_the_final_check():
    fast, default = load_config(CONFIGS / "fast.yaml").refine, Config().refine
    for name in ("check_duration_s", "max_drift_m", "max_tilt_deg", "max_depth_m"):
        assert getattr(fast, name) == getattr(default, name)
    candidates = lambda o: o.cem.population * o.cem.iterations
    assert candidates(fast) <= candidates(default) / 4
