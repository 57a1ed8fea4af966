"""What the paper reports of pictures, judgements and joints: its own scenes, objects and models."""

PAPER_SCENES: dict[str, dict[str, dict[str, float]]] = {
    "full": {
        "VIGA": {
            "clip": 0.8831,
            "dino": 0.6087,
            "complete": 4.70,
            "layout": 3.95,
            "function": 3.45,
        },
        "SAGE": {
            "clip": 0.8729,
            "dino": 0.5379,
            "complete": 3.80,
            "layout": 2.60,
            "function": 2.90,
        },
        "NeoWorld-Pro": {
            **{"clip": 0.9128, "dino": 0.7855},
            **{"complete": 6.20, "layout": 5.35, "function": 5.58},
        },
    },
    "tabletop": {
        "VIGA": {
            "clip": 0.8764,
            "dino": 0.5950,
            "complete": 4.55,
            "layout": 3.91,
            "function": 3.00,
        },
        "TabletopGen": {
            **{"clip": 0.8917, "dino": 0.6266},
            **{"complete": 4.36, "layout": 3.73, "function": 3.64},
        },
        "SAGE": {
            "clip": 0.8741,
            "dino": 0.4742,
            "complete": 3.45,
            "layout": 2.64,
            "function": 2.73,
        },
        "NeoWorld-Pro": {
            **{"clip": 0.9205, "dino": 0.7166},
            **{"complete": 6.10, "layout": 5.70, "function": 5.58},
        },
    },
}
"""Table of scenes: pictures of 30 scenes and 11 tabletop scenes, and scores from 1 to 7."""
PAPER_OBJECTS: dict[str, dict[str, float]] = {
    "Articulate-Anything": {"ssim": 0.7646, "lpips": 0.2930, "clip": 0.7056, "uni3d": 0.2125},
    "PhysX-Anything": {"ssim": 0.7657, "lpips": 0.2991, "clip": 0.7937, "uni3d": 0.2709},
    "URDF-Anything+": {"uni3d": 0.1638},
    "Articraft": {"ssim": 0.8926, "lpips": 0.2149, "clip": 0.8999, "uni3d": 0.2566},
    "NeoWorld-Pro": {"ssim": 0.8894, "lpips": 0.1989, "clip": 0.9042, "uni3d": 0.2812},
}
"""Table of objects: appearance and similarity."""
PAPER_SURFACES: dict[str, dict[str, float]] = {
    "Articulate-Anything": {"chamfer_x10": 0.3989, "f_01": 10.76, "f_05": 41.07},
    "PhysX-Anything": {"chamfer_x10": 0.7150, "f_01": 4.61, "f_05": 24.72},
    "URDF-Anything+": {"chamfer_x10": 0.1696, "f_01": 24.30, "f_05": 65.18},
    "Articraft": {"chamfer_x10": 0.2155, "f_01": 22.14, "f_05": 62.25},
    "NeoWorld-Pro": {"chamfer_x10": 0.1809, "f_01": 25.77, "f_05": 67.06},
}
"""Table of objects: geometry."""
PAPER_JOINTS: dict[str, dict[str, float]] = {
    "Articulate-Anything": {
        **{"total": 245, "predicted": 170, "hits": 95, "miss": 0.6122},
        **{"type_error": 0.6939, "axis_deg": 63.25, "pivot": 0.32},
    },
    "PhysX-Anything": {
        **{"total": 245, "predicted": 192, "hits": 126, "miss": 0.4857},
        **{"type_error": 0.5878, "axis_deg": 45.80, "pivot": 0.37},
    },
    "URDF-Anything+": {
        **{"total": 245, "predicted": 96, "hits": 74, "miss": 0.6980},
        **{"type_error": 0.8286, "axis_deg": 50.41, "pivot": 0.40},
    },
    "Articraft": {
        **{"total": 245, "predicted": 304, "hits": 190, "miss": 0.2245},
        **{"type_error": 0.2939, "axis_deg": 30.14, "pivot": 0.23},
    },
    "NeoWorld-Pro": {
        **{"total": 245, "predicted": 268, "hits": 216, "miss": 0.1183},
        **{"type_error": 0.1878, "axis_deg": 28.52, "pivot": 0.19},
    },
}
"""Table of joints, decided by paired videos; miss = 1 - hits / total, "type_error" is over all."""


def of_scenes(*measures: str) -> dict[str, dict[str, dict[str, float]]]:
    """Return some columns of the table of scenes."""
    return {
        subset: {
            method: {name: row[name] for name in measures if name in row}
            for method, row in methods.items()
        }
        for subset, methods in PAPER_SCENES.items()
    }
