"""A made-up view of boxes on a table: photograph, depth image and masks."""

import numpy as np

WIDTH, HEIGHT = 320, 240
BOXES = {"red": (40, 90, 110, 170), "blue": (150, 60, 190, 150), "green": (220, 110, 290, 190)}
"""Left, top, right and bottom of each box [px]."""
DEPTHS = {"red": 0.70, "blue": 0.85, "green": 0.62}
COLORS = {"red": (200, 40, 30), "blue": (30, 60, 190), "green": (40, 150, 60)}


def table_depth() -> np.ndarray:
    """Return the depths of a plane that is farther at the top [m]."""
    rows = np.arange(HEIGHT)[:, None] + np.zeros((1, WIDTH))
    return 1 / (0.75 + 0.6 * rows / HEIGHT)


def picture() -> np.ndarray:
    """Return the photograph, with a little noise."""
    rng = np.random.default_rng(0)
    rgb = np.full((HEIGHT, WIDTH, 3), (180, 160, 130), float)
    for name, (left, top, right, bottom) in BOXES.items():
        rgb[top:bottom, left:right] = COLORS[name]
    return np.clip(rgb + rng.normal(0, 3, rgb.shape), 0, 255).astype(np.uint8)


def depth() -> np.ndarray:
    """Return the depth image [m], with missing values."""
    values = table_depth()
    for name, (left, top, right, bottom) in BOXES.items():
        values[top:bottom, left:right] = DEPTHS[name]
    values[:6] = np.nan
    return values


def labels() -> np.ndarray:
    """Return masks with the numbers 3, 5 and 9."""
    values = np.zeros((HEIGHT, WIDTH), np.uint8)
    for number, (left, top, right, bottom) in zip((3, 5, 9), BOXES.values(), strict=True):
        values[top:bottom, left:right] = number
    return values
