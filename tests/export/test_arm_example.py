"""The example of an arm beside a scene: its files are written and it is run."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from neoworld_mjx.cli import main

ARM = Path(__file__).parents[2] / "examples" / "arm"


@pytest.fixture
def pushed(tmp_path, monkeypatch):
    """The names of the example after it has run."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main(["export", str(ARM / "chest.py"), "--for", "mjx", "--out", "files"])
    assert end.value.code == 0
    for name in ("arm.xml", "world.xml"):
        shutil.copy(ARM / name, tmp_path)
    names: dict = {}
    exec(compile((ARM / "push.py").read_text(encoding="utf-8"), "push.py", "exec"), names)
    return names


def test_the_arm_pushes_the_drawer_closed(pushed, capfd):
    model, data, slide = (pushed[name] for name in ("model", "data", "slide"))
    assert pushed["start"].qpos[slide] == 0.12
    assert data.qpos[slide] < 0.02
    tip = data.site("arm-tip").xpos
    assert np.linalg.norm(tip - pushed["before"]) > 0.1
    # The chest is free, and stays where it is.
    assert np.linalg.norm(data.body("scene-chest").xpos) < 0.01
    assert {"arm-lift", "arm-left"} <= {model.actuator(k).name for k in range(model.nu)}
    assert "scene-chest-slide-pos" in {model.sensor(k).name for k in range(model.nsensor)}
