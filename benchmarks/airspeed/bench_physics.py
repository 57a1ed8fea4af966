"""Rollouts of noisy layouts on a crowded table, for asv and as a script."""

import sys

import jax
from neoworld_bench.engines.table_scenes import crowded, noisy_layouts
from neoworld_bench.engines.throughput import physics
from neoworld_bench.engines.verdicts import compare, motion, naive_loop
from neoworld_bench.machine import peak_mib

from neoworld_mjx.errors import EngineError
from neoworld_mjx.physics.engine import EarlyStop
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.physics.simulate import open_engine


class _Rollouts:
    param_names = ("engine", "objects", "population", "early_stop")
    timeout = 600
    number, repeat, warmup_time = 1, 5, 0.0

    def setup(self, engine, objects, population, early_stop):
        try:
            self.engine = open_engine(engine)
        except EngineError as error:
            raise NotImplementedError(str(error)) from None
        self.scene = compile_scene(crowded(objects))
        self.layouts = noisy_layouts(self.scene, population)
        self.rule = EarlyStop() if early_stop else None
        self.found = self.once()
        self._validate()

    def once(self):
        rollout = self.engine.rollout(
            self.scene, self.scene.place(self.layouts), early_stop=self.rule
        )
        return jax.block_until_ready(rollout)

    def _validate(self):
        first = self.layouts[:16]
        loop = naive_loop(self.scene, first, self.scene.place_exactly(first))
        agreement = compare(loop.motion, motion(self.scene, self.found)[:16])
        assert (agreement.share(near=False) or 1.0) >= 0.9, "verdicts differ from the naive loop's"

    def time_rollout(self, *_):
        self.once()

    def track_candidates_stable(self, *_):
        return float((motion(self.scene, self.found) < 1).mean())

    def track_peak_mib(self, *_):
        return peak_mib()[0]


class FastNative(_Rollouts):
    params = (["native"], [3, 6, 10], [64, 256], [False, True])


class SlowNative(_Rollouts):
    params = (["native"], [6, 20, 40], [1024], [False, True])


class SlowDevice(_Rollouts):
    params = (["mjx", "warp"], [3, 6, 10], [1024], [False, True])


class FastNaive:
    """The loop that engines have to beat: compile, step, next."""

    param_names = ("objects",)
    params = ([3, 6, 10],)
    unit = "candidates/s"

    def track_rate(self, objects):
        scene = compile_scene(crowded(objects))
        layouts = noisy_layouts(scene, 16)
        return naive_loop(scene, layouts, scene.place_exactly(layouts)).candidates_per_s


if __name__ == "__main__":
    chosen = sys.argv[1:] or ["native"]
    for row in physics((6,), (256,), chosen, apart=False):
        print(row)
