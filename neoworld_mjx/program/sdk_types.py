"""Type aliases of the SDK's arguments."""

from typing import Literal

Vec3 = tuple[float, float, float] | list[float]
Point2 = tuple[float, float] | list[float]
Face = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
