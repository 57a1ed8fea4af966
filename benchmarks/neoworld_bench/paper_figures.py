"""Results of the paper on data of its own: surfaces and joints."""

Rows = dict[str, tuple[float, ...]]


def _table(columns: str, rows: Rows) -> dict[str, dict[str, float]]:
    """Return rows as mappings from column to value."""
    names = columns.split()
    return {method: dict(zip(names, values, strict=True)) for method, values in rows.items()}


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
