"""Files that assets refer to: folders of packages, URIs, colors of meshes and of URDF."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from neoworld_mjx.errors import SpecError
from neoworld_mjx.export.importing import import_file

MASS = (
    "<inertial><mass value='1'/><inertia ixx='.01' iyy='.01' izz='.01' ixy='0' ixz='0' iyz='0'/>"
    "</inertial>"
)
BOX = "<geometry><box size='.2 .2 .2'/></geometry>"


def urdf(geometry: str, more: str = "") -> str:
    return (
        f"<robot name='r'><link name='base'>{MASS}<visual>{geometry}{more}</visual>"
        f"<collision>{BOX}</collision></link></robot>"
    )


def mesh(name: str) -> str:
    return f"<geometry><mesh filename='{name}'/></geometry>"


@pytest.fixture
def package(tmp_path):
    """A ROS package with urdf/ beside meshes/, whose mesh has a space in its name."""
    root = tmp_path / "arm_description"
    for folder in ("urdf", "meshes", "robots/left"):
        (root / folder).mkdir(parents=True)
    trimesh.creation.box((0.2, 0.2, 0.2)).export(root / "meshes" / "base link.stl")
    return root


REFERENCES = {
    "package": "package://arm_description/meshes/base link.stl",
    "encoded package": "package://arm_description/meshes/base%20link.stl",
    "model": "model://arm_description/meshes/base%20link.stl",
    "relative": "../meshes/base link.stl",
    "backslashes": "..\\meshes\\base link.stl",
    "file": "file://{root}/meshes/base%20link.stl",
}


@pytest.mark.parametrize("kind", REFERENCES)
@pytest.mark.parametrize("manifest", [True, False])
def test_a_package_may_keep_its_meshes_beside_the_folder_of_the_urdf(package, kind, manifest):
    if manifest:
        (package / "package.xml").write_text("<package/>")
    path = package / "urdf" / "a.urdf"
    path.write_text(urdf(mesh(REFERENCES[kind].format(root=package))))
    (part,) = import_file(path).spec.parts
    assert part.geoms[0].shape.type == "mesh"


def test_the_manifest_of_a_package_is_found_above(package):
    path = package / "robots" / "left" / "a.urdf"
    path.write_text(urdf(mesh("package://arm_description/meshes/base link.stl")))
    with pytest.raises(SpecError, match="copy the package arm_description, with its"):
        import_file(path)
    (package / "package.xml").write_text("<package/>")
    assert import_file(path).spec.parts


def test_packages_of_a_workspace_may_refer_to_each_other(tmp_path, package):
    other = tmp_path / "bringup"
    other.mkdir()
    path = other / "a.urdf"
    path.write_text(urdf(mesh("package://arm_description/meshes/base link.stl")))
    (other / "package.xml").write_text("<package/>")
    with pytest.raises(SpecError, match="copy the package arm_description"):
        import_file(path)
    (package / "package.xml").write_text("<package/>")
    assert import_file(path).spec.parts
    path.write_text(urdf(mesh("package://arm_description/../secret.stl")))
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "secret.stl")
    with pytest.raises(SpecError, match="outside its folder"):
        import_file(path)


def obj_with_materials(folder, name="m"):
    box, ball = trimesh.creation.box((0.2, 0.2, 0.2)), trimesh.creation.icosphere(1, 0.1)
    lines = [f"mtllib {name}.mtl"]
    first = 1
    for material, part in (("Wood", box), ("Leaf", ball)):
        lines += [f"v {x} {y} {z}" for x, y, z in part.vertices]
        lines.append(f"usemtl {material}")
        lines += [f"f {a + first} {b + first} {c + first}" for a, b, c in part.faces]
        first += len(part.vertices)
    (folder / f"{name}.obj").write_text("\n".join(lines))
    (folder / f"{name}.mtl").write_text(
        "newmtl Wood\nKd 0.8 0.1 0.1\nd 1\nnewmtl Leaf\nKd 0.1 0.8 0.1\nd 0.5\n"
    )


def colors(path) -> set[tuple[float, ...]]:
    spec = import_file(path).spec
    shown = {g.material for part in spec.parts for g in part.geoms if g.role != "collision"}
    return {tuple(np.round(m.rgba, 2).tolist()) for m in spec.materials if m.name in shown}


def test_materials_of_obj_files_are_read(tmp_path):
    obj_with_materials(tmp_path)
    (tmp_path / "a.urdf").write_text(urdf(mesh("m.obj")))
    assert colors(tmp_path / "a.urdf") == {(0.8, 0.1, 0.1, 1.0), (0.1, 0.8, 0.1, 0.5)}


def test_vertex_colors_and_textures_of_meshes_are_read(tmp_path):
    box = trimesh.creation.box((0.2, 0.2, 0.2))
    box.visual.vertex_colors = [0, 0, 255, 255]
    box.export(tmp_path / "v.ply")
    (tmp_path / "a.urdf").write_text(urdf(mesh("v.ply")))
    assert colors(tmp_path / "a.urdf") == {(0.0, 0.0, 1.0, 1.0)}
    Image.new("RGB", (4, 4), (51, 204, 51)).save(tmp_path / "t.png")
    (tmp_path / "t.mtl").write_text("newmtl a\nKd 1 1 1\nmap_Kd t.png\n")
    lines = ["mtllib t.mtl", "usemtl a", "v 0 0 0", "v 1 0 0", "v 0 1 0", "v 0 0 1"]
    lines += ["vt 0 0", "vt 1 0", "vt 0 1"]
    lines += [f"f {a}/1 {b}/2 {c}/3" for a, b, c in ((1, 3, 2), (1, 2, 4), (1, 4, 3), (2, 3, 4))]
    (tmp_path / "t.obj").write_text("\n".join(lines))
    (tmp_path / "b.urdf").write_text(urdf(mesh("t.obj")))
    assert colors(tmp_path / "b.urdf") == {(0.2, 0.8, 0.2, 1.0)}


def test_materials_of_urdf_are_found_wherever_they_are_defined(tmp_path):
    red = "<material name='red'><color rgba='.9 .1 .1 1'/></material>"
    second = (
        f"<link name='top'>{MASS}<visual>{BOX}<material name='red'/></visual>"
        f"<collision>{BOX}</collision></link><joint name='j' type='fixed'><parent link='base'/>"
        "<child link='top'/><origin xyz='0 0 .2'/></joint></robot>"
    )
    path = tmp_path / "a.urdf"
    path.write_text(urdf(BOX, red).replace("</robot>", second))
    assert colors(path) == {(0.9, 0.1, 0.1, 1.0)}
    # The color of URDF takes precedence over those of the mesh.
    obj_with_materials(tmp_path)
    path.write_text(urdf(mesh("m.obj"), red))
    assert colors(path) == {(0.9, 0.1, 0.1, 1.0)}
