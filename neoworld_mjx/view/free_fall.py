"""Simulation of the scene on the page in C MuJoCo, at most as fast as real time."""

import threading
import time
from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..physics.mjcf import START, body_name, to_mjspec
from ..spec import JointSpec, SceneSpec
from ..spec.pose import Pose, rotate
from .scene_nodes import PartPoses

TIMESTEP_S = 0.004
FRAME_S = 1 / 30


class FreeFall:
    """Thread-safe simulation of a scene."""

    def __init__(self, scene: SceneSpec, on_frame: Callable[["FreeFall"], None]):
        """Compile a scene at its poses and joint states.

        Args:
            scene: the scene.
            on_frame: function to call after each frame while the simulation runs.

        Raises:
            SpecError: a part is too light to be simulated.
            ValueError: MuJoCo rejects the scene.
        """
        self.scene = scene
        self._on_frame = on_frame
        self._model = to_mjspec(scene, timestep=TIMESTEP_S).compile()
        # Otherwise MuJoCo resets a diverged simulation, which then looks stable.
        self._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self._data = mujoco.MjData(self._model)
        self._lock = threading.RLock()
        self._playing = threading.Event()
        self._thread: threading.Thread | None = None
        self._bodies = [
            ((obj.name, part.name), self._model.body(body_name(obj, part.name)).id, _origin(joint))
            for obj in scene.objects
            for part, joint in obj.spec.ordered
        ]
        self.reset()

    @property
    def playing(self) -> bool:
        """True if the simulation is running."""
        return self._playing.is_set()

    @property
    def seconds(self) -> float:
        """Simulated time [s]."""
        return float(self._data.time)

    def reset(self) -> None:
        """Reset to the initial state."""
        with self._lock:
            if self._model.nkey:
                key = self._model.key(START).id
                mujoco.mj_resetDataKeyframe(self._model, self._data, key)
            else:
                mujoco.mj_resetData(self._model, self._data)
            mujoco.mj_forward(self._model, self._data)

    def play(self) -> None:
        """Run in a thread until `pause`."""
        if self.playing:
            return
        self._playing.set()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def pause(self) -> None:
        """Stop the simulation."""
        self._playing.clear()
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join()

    def step(self, seconds: float) -> None:
        """Simulate a duration [s] as fast as possible."""
        with self._lock:
            for _ in range(max(1, round(seconds / self._model.opt.timestep))):
                mujoco.mj_step(self._model, self._data)

    def poses(self) -> PartPoses:
        """Return the current pose of each part; see `PartPoses`."""
        with self._lock:
            quat = self._data.xquat.copy()
            pos = self._data.xpos.copy()
        return {
            key: Pose(pos[body] - rotate(quat[body], origin), quat[body])
            for key, body, origin in self._bodies
        }

    def _run(self) -> None:
        due = time.perf_counter()
        while self.playing:
            self.step(FRAME_S)
            if not np.isfinite(self._data.qpos).all():
                self._playing.clear()
                return
            self._on_frame(self)
            due = max(due + FRAME_S, time.perf_counter() - FRAME_S)
            time.sleep(max(0.0, due - time.perf_counter()))


def _origin(joint: JointSpec | None) -> NDArray:
    """Return the origin of a part's body in the object's frame [m]: the anchor of its joint."""
    return np.zeros(3) if joint is None else np.array(joint.pos)
