"""Tiny random models in the files in which CLIP, DINOv2, LPIPS and Uni3D come."""

import json

import numpy as np
from onnx import TensorProto, helper, numpy_helper, save_model

SIDE = 32
"""Pixels of the square that image towers take."""
CLIP_CONFIG = {
    "size": {"shortest_edge": SIDE},
    "crop_size": {"height": SIDE, "width": SIDE},
    "resample": 3,
    "image_mean": [0.48, 0.46, 0.41],
    "image_std": [0.27, 0.26, 0.28],
    "do_resize": True,
    "do_center_crop": True,
    "do_convert_rgb": True,
    "image_processor_type": "CLIPImageProcessor",
}
"""The published form of preprocessor_config.json."""


def save(path, nodes, inputs, output, weights):
    """Write a graph: inputs (name, shape), output (name, shape), weights by name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    info = helper.make_tensor_value_info
    graph = helper.make_graph(
        [helper.make_node(op, ins, outs, **given) for op, ins, outs, given in nodes],
        "tiny",
        [info(name, TensorProto.FLOAT, shape) for name, shape in inputs],
        [info(output[0], TensorProto.FLOAT, output[1])],
        [numpy_helper.from_array(np.asarray(w), name) for name, w in weights.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    save_model(model, path)
    return path


def random(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def image_tower(path, *, output="image_embeds", side=SIDE, width=16, scale=1.0, name=None):
    """Write patches, a mean over them and a projection; DINOv2's output keeps the tokens."""
    tokens = output == "last_hidden_state"
    shape = ["batch", "tokens", width] if tokens else ["batch", width]
    middle = [
        ("Conv", ["pixel_values", "patch"], ["grid"], {"strides": [8, 8]}),
        ("Relu", ["grid"], ["lit"], {}),
    ]
    if tokens:
        middle += [
            ("Reshape", ["lit", "flat"], ["rows"], {}),
            ("Transpose", ["rows"], ["listed"], {"perm": [0, 2, 1]}),
        ]
    else:
        middle += [("ReduceMean", ["lit"], ["listed"], {"axes": [2, 3], "keepdims": 0})]
    weights = {"patch": scale * random(8, 3, 8, 8), "out": random(8, width, seed=1)}
    if tokens:
        weights["flat"] = np.array([0, 8, -1])
    nodes = [*middle, ("MatMul", ["listed", "out"], [output], {})]
    inputs = [(name or "pixel_values", ["batch", 3, side, side])]
    if name:
        nodes = [("Identity", [name], ["pixel_values"], {}), *nodes]
    return save(path, nodes, inputs, (output, shape), weights)


def clip_folder(folder, **changes):
    """Write CLIP's image tower: model.onnx and preprocessor_config.json."""
    image_tower(folder / "model.onnx", **changes)
    (folder / "preprocessor_config.json").write_text(json.dumps(CLIP_CONFIG))
    return folder


def dino_folder(folder):
    """Write DINOv2 likewise; its size is larger than its square."""
    image_tower(folder / "model.onnx", output="last_hidden_state")
    config = CLIP_CONFIG | {"size": {"shortest_edge": 40}, "crop_size": SIDE}
    (folder / "preprocessor_config.json").write_text(json.dumps(config))
    return folder


def lpips_file(path, *, size=("h", "w")):
    """Write LPIPS with one layer: unit features, squared difference, heads that are not negative,
    mean over the picture.
    """
    nodes = []
    for side in "ab":
        nodes += [
            ("Conv", [f"in{side}", "kernel"], [f"conv{side}"], {"strides": [2, 2]}),
            ("Relu", [f"conv{side}"], [f"lit{side}"], {}),
            ("ReduceL2", [f"lit{side}"], [f"norm{side}"], {"axes": [1], "keepdims": 1}),
            ("Add", [f"norm{side}", "eps"], [f"more{side}"], {}),
            ("Div", [f"lit{side}", f"more{side}"], [f"unit{side}"], {}),
        ]
    nodes += [
        ("Sub", ["unita", "unitb"], ["difference"], {}),
        ("Mul", ["difference", "difference"], ["squared"], {}),
        ("Conv", ["squared", "head"], ["weighed"], {}),
        ("ReduceMean", ["weighed"], ["distance"], {"axes": [2, 3], "keepdims": 1}),
    ]
    weights = {"kernel": random(8, 3, 5, 5), "head": np.abs(random(1, 8, 1, 1, seed=1))}
    weights["eps"] = np.float32(1e-10)
    inputs = [(f"in{side}", [1, 3, *size]) for side in "ab"]
    return save(path, nodes, inputs, ("distance", [1, 1, "one", "uno"]), weights)


def uni3d_folder(folder, *, width=16):
    """Write Uni3D's files: the maximum over each group's points and all groups, projected."""
    nodes = [
        ("Unsqueeze", ["center", "axis"], ["apart"], {}),
        ("Expand", ["apart", "group"], ["centres"], {}),
        ("Concat", ["centres", "features"], ["points"], {"axis": 3}),
        ("MatMul", ["points", "first"], ["hidden"], {}),
        ("Relu", ["hidden"], ["lit"], {}),
        ("ReduceMax", ["lit"], ["pooled"], {"axes": [1, 2], "keepdims": 0}),
        ("MatMul", ["pooled", "out"], ["pc_embeds"], {}),
    ]
    weights = {"first": random(9, 12), "out": random(12, 16, seed=1)}
    weights |= {"axis": np.array([2]), "group": np.array([1, 1, 8, 1])}
    inputs = [("center", [1, 24, 3]), ("features", [1, 24, 8, 6])]
    save(folder / "points.onnx", nodes, inputs, ("pc_embeds", [1, 16]), weights)
    image_tower(folder / "model.onnx", width=width)
    (folder / "preprocessor_config.json").write_text(json.dumps(CLIP_CONFIG))
    return folder
