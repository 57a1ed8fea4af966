"""glTF files whose values are normalized or quantized, files that are refused, and colors."""

import base64
import io
import json
import struct

import numpy as np
import pytest
from PIL import Image

from neoworld_mjx.errors import SpecError
from neoworld_mjx.export.importing import import_file
from neoworld_mjx.spec import bounds

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ],
    np.uint16,
)  # fmt: skip
KINDS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
WIDTHS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


class Gltf:
    """A glTF file with one box of 0.2 x 0.4 x 0.6 m (x, y up, z) on a node."""

    def __init__(self):
        self.data = b""
        self.document = {
            "asset": {"version": "2.0"},
            "scenes": [{"nodes": [0]}],
            "scene": 0,
            "nodes": [{"name": "box", "mesh": 0, "scale": [0.1, 0.2, 0.3]}],
            "meshes": [],
            "accessors": [],
            "bufferViews": [],
        }
        position, index = self.accessor(CORNERS), self.accessor(FACES.reshape(-1, 1))
        self.primitive = {"attributes": {"POSITION": position}, "indices": index}
        self.document["meshes"] = [{"primitives": [self.primitive]}]

    def view(self, data: bytes, **more) -> int:
        self.data += b"\0" * (-len(self.data) % 4)
        row = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **more}
        self.document["bufferViews"].append(row)
        self.data += data
        return len(self.document["bufferViews"]) - 1

    def accessor(self, values, pad: int = 0, **more) -> int:
        values = np.ascontiguousarray(values)
        rows = [row.tobytes() + b"\0" * pad for row in values]
        stride = {"byteStride": len(rows[0])} if pad else {}
        self.document["accessors"].append(
            {
                "bufferView": self.view(b"".join(rows), **stride),
                "componentType": KINDS[values.dtype.str[1:]],
                "type": WIDTHS[values.shape[1]],
                "count": len(values),
                **more,
            }
        )
        return len(self.document["accessors"]) - 1

    def write(self, path):
        if path.suffix == ".glb":
            self.document["buffers"] = [{"byteLength": len(self.data)}]
            text = json.dumps(self.document).encode()
            text += b" " * (-len(text) % 4)
            body = struct.pack("<II", len(text), 0x4E4F534A) + text
            body += struct.pack("<II", len(self.data), 0x004E4942) + self.data
            path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body)
        else:
            uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
            self.document["buffers"] = [{"byteLength": len(self.data), "uri": uri}]
            path.write_text(json.dumps(self.document))
        return path


def plain(file: Gltf):
    pass


def normalized(file: Gltf):
    quantized = np.round(CORNERS * 32767).astype(np.int16)
    file.primitive["attributes"]["POSITION"] = file.accessor(quantized, pad=2, normalized=True)
    file.document["extensionsRequired"] = ["KHR_mesh_quantization"]


def bytes_not_normalized(file: Gltf):
    quantized = (CORNERS * 100).astype(np.int8)
    file.primitive["attributes"]["POSITION"] = file.accessor(quantized, pad=1)
    file.document["nodes"][0]["scale"] = [0.001, 0.002, 0.003]
    file.document["extensionsRequired"] = ["KHR_mesh_quantization"]


def morph_targets_at_zero(file: Gltf):
    file.primitive["targets"] = [{"POSITION": file.accessor(CORNERS)}]


def strip(file: Gltf):
    order = np.uint16([3, 7, 2, 6, 4, 7, 5, 3, 1, 2, 0, 4, 1, 5])[:, None]
    file.primitive |= {"indices": file.accessor(order), "mode": 5}


def no_indices(file: Gltf):
    del file.primitive["indices"]
    file.primitive["attributes"]["POSITION"] = file.accessor(CORNERS[FACES.reshape(-1)])


def sparse(file: Gltf):
    moved = CORNERS.copy()
    moved[[2, 5]] = 0.0
    file.primitive["attributes"]["POSITION"] = index = file.accessor(moved)
    file.document["accessors"][index]["sparse"] = {
        "count": 2,
        "indices": {"bufferView": file.view(np.uint16([2, 5]).tobytes()), "componentType": 5123},
        "values": {"bufferView": file.view(CORNERS[[2, 5]].tobytes())},
    }


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize(
    "change",
    [plain, sparse, normalized, bytes_not_normalized, morph_targets_at_zero, strip, no_indices],
)
def test_every_way_to_store_a_box_is_the_same_box(tmp_path, change, suffix):
    file = Gltf()
    change(file)
    (item,) = import_file(file.write(tmp_path / f"a{suffix}")).spec.objects
    low, high = bounds(item.spec)
    assert np.allclose(np.subtract(high, low), [0.2, 0.6, 0.4], atol=1e-4)
    (geom,) = item.spec.parts[0].geoms
    assert geom.shape.volume() == pytest.approx(0.2 * 0.4 * 0.6, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "required"),
    [
        ("KHR_draco_mesh_compression", True),
        ("KHR_draco_mesh_compression", False),
        ("EXT_meshopt_compression", True),
        ("EXT_mesh_gpu_instancing", False),
        ("VENDOR_new_geometry", True),
    ],
)
def test_extensions_that_cannot_be_read_are_named(tmp_path, name, required):
    file = Gltf()
    file.document["extensionsUsed"] = [name]
    file.document["extensionsRequired"] = [name] if required else []
    with pytest.raises(SpecError, match=f"uses {name}, which cannot be read.*gltf-transform"):
        import_file(file.write(tmp_path / "a.glb"))


@pytest.mark.parametrize(
    ("table", "row", "feature"),
    [
        ("nodes", {"skin": 0}, "skins"),
        ("meshes", {"weights": [0.0, 0.5]}, "morph targets"),
    ],
)
def test_meshes_that_would_be_wrong_are_refused(tmp_path, table, row, feature):
    file = Gltf()
    file.document[table][0] |= row
    with pytest.raises(SpecError, match=f"uses {feature}, which cannot be read"):
        import_file(file.write(tmp_path / "a.glb"))


def test_extensions_that_only_affect_looks_are_accepted(tmp_path):
    file = Gltf()
    file.document["extensionsRequired"] = ["KHR_materials_unlit", "KHR_texture_transform"]
    file.document["extensionsUsed"] = ["KHR_lights_punctual", "VENDOR_optional"]
    assert len(import_file(file.write(tmp_path / "a.glb")).spec.objects) == 1


def colored(file: Gltf, **looks):
    file.document["materials"] = [{"pbrMetallicRoughness": looks}]
    file.primitive["material"] = 0


def base_color(file: Gltf):
    colored(file, baseColorFactor=[0.1, 0.7, 0.2, 0.5])
    return (0.1, 0.7, 0.2, 1.0)  # An opaque material ignores alpha.


def blended(file: Gltf):
    colored(file, baseColorFactor=[0.1, 0.7, 0.2, 0.5])
    file.document["materials"][0]["alphaMode"] = "BLEND"
    return (0.1, 0.7, 0.2, 0.5)


def vertex_colors(file: Gltf):
    color = np.tile(np.uint8([0, 0, 255, 255]), (8, 1))
    file.primitive["attributes"]["COLOR_0"] = file.accessor(color, normalized=True)
    return (0.0, 0.0, 1.0, 1.0)


def specular_glossiness(file: Gltf):
    looks = {"diffuseFactor": [0.9, 0.1, 0.1, 1]}
    extension = {"KHR_materials_pbrSpecularGlossiness": looks}
    file.document["materials"] = [{"extensions": extension}]
    file.primitive["material"] = 0
    return (0.9, 0.1, 0.1, 1.0)


def texture_atlas(file: Gltf):
    """A picture with a red and a green half, of which the box shows the red one."""
    image, stream = Image.new("RGB", (8, 8), (200, 30, 30)), io.BytesIO()
    image.paste((30, 200, 30), (4, 0, 8, 8))
    image.save(stream, "PNG")
    file.document["images"] = [
        {"bufferView": file.view(stream.getvalue()), "mimeType": "image/png"}
    ]
    file.document["textures"] = [{"source": 0}]
    colored(file, baseColorTexture={"index": 0})
    file.primitive["attributes"]["TEXCOORD_0"] = file.accessor(np.full((8, 2), 0.2, np.float32))
    return (200 / 255, 30 / 255, 30 / 255, 1.0)


@pytest.mark.parametrize(
    "change", [base_color, blended, vertex_colors, specular_glossiness, texture_atlas]
)
def test_colors_are_read(tmp_path, change):
    file = Gltf()
    expected = change(file)
    read = import_file(file.write(tmp_path / "a.glb"))
    (material,) = read.spec.objects[0].spec.materials
    assert material.rgba == pytest.approx(expected, abs=0.01)
    assert not any("mean color" in note for note in read.notes)


def test_several_colors_become_their_mean_with_a_note(tmp_path):
    file = Gltf()
    texture_atlas(file)
    uv = np.where(np.arange(8)[:, None] % 2, 0.2, 0.8).astype(np.float32)
    file.primitive["attributes"]["TEXCOORD_0"] = file.accessor(np.tile(uv, (1, 2)))
    read = import_file(file.write(tmp_path / "a.glb"))
    assert any("texture: replaced by the mean color" in note for note in read.notes)


def test_a_mesh_of_several_materials_has_one_collider(tmp_path):
    """The surfaces of each material are open; only together are they a solid."""
    file = Gltf()
    file.document["materials"] = [
        {"pbrMetallicRoughness": {"baseColorFactor": [*rgb, 1]}} for rgb in ([1, 0, 0], [0, 0, 1])
    ]
    attributes = file.primitive["attributes"]
    file.document["meshes"][0]["primitives"] = [
        {"attributes": attributes, "material": k, "indices": file.accessor(half.reshape(-1, 1))}
        for k, half in enumerate((FACES[:5], FACES[5:]))
    ]
    (item,) = import_file(file.write(tmp_path / "a.glb")).spec.objects
    (part,) = item.spec.parts
    assert [geom.role for geom in part.geoms] == ["visual", "visual", "collision"]
    assert {m.rgba[:3] for m in item.spec.materials} == {(1, 0, 0), (0, 0, 1)}
    assert part.geoms[2].shape.volume() == pytest.approx(0.048, rel=1e-3)
