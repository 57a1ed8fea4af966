"""Results of the paper on data of its own: images, judgements, surfaces and joints."""

Rows = dict[str, tuple[float | None, ...]]


def _table(columns: str, rows: Rows) -> dict[str, dict[str, float]]:
    """Return rows as mappings from column to value, without missing values."""
    names = columns.split()
    return {
        method: {n: v for n, v in zip(names, values, strict=True) if v is not None}
        for method, values in rows.items()
    }


_SCENE_COLUMNS = "clip dino complete layout function"
PAPER_SCENES = {
    "full": _table(
        _SCENE_COLUMNS,
        {
            "VIGA": (0.8831, 0.6087, 4.7, 3.95, 3.45),
            "SAGE": (0.8729, 0.5379, 3.8, 2.6, 2.9),
            "NeoWorld-Pro": (0.9128, 0.7855, 6.2, 5.35, 5.58),
        },
    ),
    "tabletop": _table(
        _SCENE_COLUMNS,
        {
            "VIGA": (0.8764, 0.595, 4.55, 3.91, 3.0),
            "TabletopGen": (0.8917, 0.6266, 4.36, 3.73, 3.64),
            "SAGE": (0.8741, 0.4742, 3.45, 2.64, 2.73),
            "NeoWorld-Pro": (0.9205, 0.7166, 6.1, 5.7, 5.58),
        },
    ),
}
"""Image similarities and scores from 1 to 7 of 30 scenes and of 11 tabletop scenes."""
PAPER_OBJECTS = _table(
    "ssim lpips clip uni3d",
    {
        "Articulate-Anything": (0.7646, 0.293, 0.7056, 0.2125),
        "PhysX-Anything": (0.7657, 0.2991, 0.7937, 0.2709),
        "URDF-Anything+": (None, None, None, 0.1638),
        "Articraft": (0.8926, 0.2149, 0.8999, 0.2566),
        "NeoWorld-Pro": (0.8894, 0.1989, 0.9042, 0.2812),
    },
)
"""Appearance of objects."""
PAPER_SURFACES = _table(
    "chamfer_x10 f_01 f_05",
    {
        "Articulate-Anything": (0.3989, 10.76, 41.07),
        "PhysX-Anything": (0.715, 4.61, 24.72),
        "URDF-Anything+": (0.1696, 24.3, 65.18),
        "Articraft": (0.2155, 22.14, 62.25),
        "NeoWorld-Pro": (0.1809, 25.77, 67.06),
    },
)
"""Geometry of objects."""
PAPER_JOINTS = _table(
    "total predicted hits miss type_error axis_deg pivot",
    {
        "Articulate-Anything": (245, 170, 95, 0.6122, 0.6939, 63.25, 0.32),
        "PhysX-Anything": (245, 192, 126, 0.4857, 0.5878, 45.8, 0.37),
        "URDF-Anything+": (245, 96, 74, 0.698, 0.8286, 50.41, 0.4),
        "Articraft": (245, 304, 190, 0.2245, 0.2939, 30.14, 0.23),
        "NeoWorld-Pro": (245, 268, 216, 0.1183, 0.1878, 28.52, 0.19),
    },
)
"""Joints, decided by paired videos; miss = 1 - hits / total, "type_error" is over all joints."""


def of_scenes(*measures: str) -> dict[str, dict[str, dict[str, float]]]:
    """Return some columns of the table of scenes."""
    return {
        subset: {
            method: {name: row[name] for name in measures if name in row}
            for method, row in methods.items()
        }
        for subset, methods in PAPER_SCENES.items()
    }
