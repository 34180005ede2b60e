"""What a flat conformal map does to lengths, foretold without the map: the linear Yamabe equation."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from pgcp.surface.distortion import corner_angles
from pgcp.surface.operators import cotangent_laplacian, face_areas, needed_mollification
from pgcp.types import BoolArray, FloatArray, IntArray, Mesh


def curvature(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """2 pi less the angles around each vertex (V,); of inner vertices the Gaussian curvature. 0 where no face is."""
    angles = corner_angles(vertices, faces)
    around = np.bincount(faces.reshape(-1), np.nan_to_num(angles).reshape(-1), len(vertices))
    used = np.bincount(faces.reshape(-1), minlength=len(vertices)) > 0
    return np.where(used, 2.0 * np.pi - around, 0.0)


OUTSIDE = 0.01  # share of the area left out of the scale ratio at either end
_LEAST_SHARE = 0.2  # of the largest squeezed region, from which on others are cut at the same time
_TINY = 1e-300
LARGEST = 700.0  # logarithm of the largest ratio that is told


class Foretold:
    """Logarithms of scale factors of a surface that is cut and laid flat, its boundary kept at its length.

    L u = -K inside, u = 0 on the cut (the linear part of CETM; Springborn, Schroeder, Pinkall 2008, BFF's first step): exact
    in the limit of fine meshes.
    """

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        self._laplacian = cotangent_laplacian(vertices, faces, needed_mollification(vertices, faces)).tocsc()
        self._curvature = curvature(vertices, faces)
        areas = face_areas(vertices, faces)
        self.areas = np.bincount(faces.reshape(-1), np.repeat(areas, 3), len(vertices)) / 3.0

    def log_scale(self, on_cut: BoolArray) -> FloatArray:
        """u (V,), 0 where ``on_cut`` (V,) and where no face is."""
        inside = np.flatnonzero(~on_cut & (self.areas > 0.0))
        u = np.zeros(len(on_cut))
        if len(inside) and on_cut.any():
            part = self._laplacian[inside][:, inside].tocsc()
            solved = splu(part, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
            u[inside] = np.nan_to_num(solved.solve(-self._curvature[inside]))
        return u


def extremes(values: FloatArray, weights: FloatArray) -> tuple[float, float]:
    """The values (N,) below and above which a hundredth of all weights (N,) lies."""
    order = np.argsort(values)
    below = np.cumsum(weights[order])
    places = np.searchsorted(below, [OUTSIDE * below[-1], (1.0 - OUTSIDE) * below[-1]])
    low, high = values[order[np.minimum(places, len(order) - 1)]]
    return float(low), float(high)


def scale_ratio(log_scale: FloatArray, areas: FloatArray) -> float:
    """By how much area scales differ: the scale that 99 % of the area stays below, over the one that 99 % stays above.

    log_scale (N,): logarithms of scale factors of lengths; areas (N,), on the surface, on which they hold. An area scale is the
    square of the length scale. Largest and least scale are no measure: at the ends and branches of a cut the scale of a
    conformal map goes to 0 or infinity, as far as the mesh is fine.
    """
    low, high = extremes(log_scale, areas)
    return float(np.exp(min(2.0 * (high - low), LARGEST)))


def measured_scales(mesh: Mesh, image: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Logarithms of length scales (F,) of a map to points (V, 2) of the plane, and areas (F,) on the surface.

    The scale of a face is the root of its area in the map over its area on the surface; faces without area have none, and
    weigh nothing.
    """
    bare = mesh.bare
    surface = face_areas(bare.vertices, bare.faces)
    flat = face_areas(np.column_stack([image, np.zeros(len(image))]), bare.faces)
    scales = 0.5 * (np.log(np.maximum(flat, _TINY)) - np.log(np.maximum(surface, _TINY)))
    return np.where(surface > 0.0, scales, 0.0), surface


def scale_ratio_of(mesh: Mesh, image: FloatArray) -> float:
    """The scale ratio (``scale_ratio``) of a map to points (V, 2) of the plane."""
    return scale_ratio(*measured_scales(mesh, image))


def at_vertices(mesh: Mesh, scales: FloatArray, areas: FloatArray) -> FloatArray:
    """Means (V,) of what faces (F,) hold, by area; 0 at vertices without area."""
    corners = mesh.bare.faces.reshape(-1)
    total = np.bincount(corners, np.repeat(areas, 3), len(mesh.vertices))
    return np.asarray(
        np.bincount(corners, np.repeat(areas * scales, 3), len(mesh.vertices)) / np.where(total > 0.0, total, 1.0)
    )


def tips_of(ends: IntArray, log_scale: FloatArray, areas: FloatArray, on_cut: BoolArray, bound: float) -> IntArray:
    """Vertices that a cut should go through, so that the scale ratio comes below a bound: the tips of what is squeezed most.

    What is smaller than the bound allows, beside the largest scale, falls apart in regions; the tip of each is where the scale
    is least. Returned are those of regions that have a fifth of the largest one's area or more. Where the largest
    scale is farther from that on the cut than the least is, tips are those of what is too large beside the least, where the
    scale is greatest. None where all is on the cut.

    ends (E, 2): edges; log_scale, areas, on_cut (V,).
    """
    low, high = extremes(log_scale, areas)
    span = 0.5 * np.log(bound)
    free = ~on_cut & (areas > 0.0)
    sides = ((free & (log_scale < high - span), log_scale), (free & (log_scale > low + span), -log_scale))
    base = float(np.median(log_scale[on_cut] if on_cut.any() else log_scale))
    for bad, depth in sides if base - low >= high - base else sides[::-1]:
        if not bad.any():
            continue
        a, b = ends[bad[ends].all(axis=1)].T
        count = len(bad)
        label = connected_components(csr_array((np.ones(len(a), np.int8), (a, b)), shape=(count, count)), directed=False)[1]
        share = np.bincount(label[bad], areas[bad], int(label.max()) + 1)
        order = np.lexsort((depth, label))
        order = order[bad[order]]
        first = order[np.append(True, label[order[1:]] != label[order[:-1]])]
        return np.sort(first[share[label[first]] >= _LEAST_SHARE * share.max()])
    return np.empty(0, np.int64)
