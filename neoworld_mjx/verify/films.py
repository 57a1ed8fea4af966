"""GIF animations of the two standard scenarios of the paper."""

import numpy as np

from ..checks.object_tests import ObjectTests
from ..checks.simulation import Trajectory
from ..render.animation import encode_animation
from ..render.flat_rendering import render_plain
from ..spec import single_object_scene
from .key_frames import posed_at, standard_runs, view_of_all

WIDTH, HEIGHT = 240, 200
FRAMES = 16


def films(tests: ObjectTests) -> dict[str, bytes]:
    """Return a GIF of each standard scenario of an object, by the kind of the scenario.

    The GIFs loop, play at the speed of the simulation, and have flat colors. For an object with a
    fixed base, the only GIF shows a joint that is driven. If such an object has no joints, there is
    no GIF.
    """
    return {kind: _film(tests, run) for kind, run in standard_runs(tests).items()}


def _film(tests: ObjectTests, run: Trajectory) -> bytes:
    steps = np.linspace(0, len(run.time) - 1, FRAMES).astype(int)
    poses = [posed_at(tests, run, int(k)) for k in steps]
    view = view_of_all(poses, WIDTH, HEIGHT)
    frames = [render_plain(single_object_scene(posed), view) for posed in poses]
    pause_ms = max(20, round(1000 * float(run.time[-1] - run.time[0]) / (FRAMES - 1)))
    return encode_animation(frames, pause_ms)
