import pytest

from neoworld_mjx.export import export_object, export_scene
from neoworld_mjx.spec import Box, Camera, Lathe, ObjectSpec, SceneObject, SceneSpec
from tests.support import mechanisms


@pytest.fixture(scope="session")
def cabinet() -> ObjectSpec:
    return mechanisms.cabinet()


@pytest.fixture(scope="session")
def scene(cabinet) -> SceneSpec:
    """A table, an open cabinet on it, a bowl in the cabinet's drawer, another cabinet fastened."""
    table = mechanisms.single("table", Box(size=(1, 1, 0.04)), 0.02)
    bowl = Lathe(profile=((0, 0), (0.02, 0), (0.03, 0.02)), thickness=0.003)
    return SceneSpec(
        objects=(
            SceneObject(name="physics", spec=table, environment=True, yaw=0.2),
            SceneObject(
                name="box",
                spec=cabinet,
                parent="physics",
                xy=(0.1, -0.2),
                z=0.05,
                yaw=0.7,
                base_tilt=(0.99, 0.1, 0.0, 0.0),
                joint_state={"hinge": 0.8, "slide": 0.1, "spin": 2.0},
            ),
            SceneObject(
                name="bowl",
                spec=mechanisms.single("bowl", bowl),
                parent="box",
                parent_link="drawer",
                z=0.1,
            ),
            SceneObject(
                name="fastened",
                spec=cabinet,
                parent="physics",
                fixed_base=True,
                xy=(0.1, 0.4),
                z=0.05,
                yaw=-0.7,
                joint_state={"slide": 0.05},
            ),
        ),
        camera=Camera(width=300, height_px=200, fovy=0.7, height=0.5, pitch=0.6),
    )


@pytest.fixture(scope="session")
def folder(tmp_path_factory, scene, cabinet):
    """The files of the scene, and in `alone` those of the cabinet."""
    out = tmp_path_factory.mktemp("exported")
    export_scene(scene, out)
    export_object(cabinet, out / "alone")
    return out
