"""What the coordinates of a map are called in files, and the map's image as a surface."""

from __future__ import annotations

import numpy as np

from pgcp.types import FloatArray, Parameterization


def coordinates_of(result: Parameterization) -> tuple[str, FloatArray]:
    """Name and values of a map's coordinates: "uv" (V, 2) in the plane, "sphere" (V, 3) on the unit sphere."""
    return result.coordinates_name, result.coordinates


def image_of(values: FloatArray, radius: float = 1.0) -> FloatArray:
    """Points (V, 3) of coordinates: those of the plane at z = 0, those of the sphere at a distance."""
    columns = values.shape[1]
    return values * radius if columns == 3 else np.pad(values, ((0, 0), (0, 3 - columns)))
