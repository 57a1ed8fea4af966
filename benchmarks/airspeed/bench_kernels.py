"""Implementations of the penetration term, for asv and as a script."""

import jax
import numpy as np
from neoworld_bench.engines.kernel_times import TOLERANCE, implementations, kernels
from neoworld_bench.engines.table_scenes import Noise, crowded, noisy_layouts

from neoworld_mjx.physics.layout import rotation
from neoworld_mjx.physics.model import compile_scene


class FastPairDepth:
    param_names = ("implementation", "objects", "population")
    params = (list(implementations()), [3, 10], [256])
    number, repeat = 1, 7

    def setup(self, implementation, objects, population):
        scene = compile_scene(crowded(objects))
        poses = scene.place(noisy_layouts(scene, population, noise=Noise(xy=0.3)))
        self.where = (poses.pos, rotation(poses.quat), poses.scale)
        calls = {
            name: jax.jit(lambda p, r, s, op=op: op(p, r, s, scene.samples, scene.colliders))
            for name, op in implementations().items()
        }
        self.call = calls[implementation]
        try:
            depths = np.asarray(self.call(*self.where))
        except Exception as error:
            raise NotImplementedError(str(error)) from None
        gap = np.abs(depths - np.asarray(calls["jnp"](*self.where))).max()
        assert gap <= TOLERANCE, f"differs from the reference by {gap} m"

    def time_depth(self, *_):
        jax.block_until_ready(self.call(*self.where))


if __name__ == "__main__":
    for row in kernels((3, 10), (256,)):
        print(row)
