"""All evidence about a scene in addition to its tree."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import UInt8

from .depth_image import DepthImage
from .further_photo import FurtherPhoto
from .known_camera import KnownCamera
from .known_objects import KnownObjects
from .lens import Lens
from .masks import Masks

PhotoPixels = UInt8[np.ndarray, "row column 3"]


@dataclass(frozen=True)
class Evidence:
    """Evidence about the camera and the layout of a scene, in addition to its tree."""

    photo: PhotoPixels | None = field(default=None, repr=False)
    """The photograph (sRGB) that the camera of the tree took; without one, the scene is composed
    and not aligned."""
    camera: KnownCamera | None = None
    """Known parameters of the photograph's camera."""
    depth: DepthImage | None = None
    """Depth image of the photograph's view; used only with a photograph."""
    masks: Masks | None = None
    """Masks of the objects in the photograph."""
    objects: KnownObjects = field(default_factory=KnownObjects)
    """Assets in place of programs, known sizes, and objects that stay where they were placed."""
    further: tuple[FurtherPhoto, ...] = ()
    """Further photographs of the scene."""
    boxes: bool = True
    """False if the 2D boxes of the tree are projections of its 3D boxes, and no evidence of their
    own. The tree is then not fitted to them."""
    lens: Lens | None = None
    """Lens that took photograph, depth image and masks, if they are not undistorted yet; `camera`
    describes the undistorted image."""
