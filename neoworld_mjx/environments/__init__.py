"""Robot-learning environments of a run folder or a scene.

Importing the package registers `neoworld/Scene-v0` with Gymnasium, if it is installed.
"""

from importlib.util import find_spec

if find_spec("gymnasium") is not None:
    from gymnasium.envs.registration import register

    register(
        "neoworld/Scene-v0",
        f"{__name__}.gym_environment:gym_env",
        vector_entry_point=f"{__name__}.gym_environment:SceneVectorEnv",
    )
