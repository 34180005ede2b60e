"""How many texels of a texture a surface gets for its lengths, and how far the texture is stretched on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pgcp.types import FloatArray, IntArray, Layout, Mesh


@dataclass(frozen=True, slots=True, eq=False)
class TexelDensity:
    """Texels per unit of length on every face, for a texture of width x height texels.

    most, least (F,): in the direction that gets most, and least; areas (F,) of the faces on the surface.
    """

    most: FloatArray
    least: FloatArray
    areas: FloatArray

    @property
    def mean(self) -> FloatArray:
        """Square root (F,) of texels per area."""
        return np.sqrt(self.most * self.least)

    def met_by(self, share: float) -> float:
        """The density that this share of the surface's area has or exceeds; 1: the least of all, 0: the greatest."""
        values = self.mean
        solid = np.flatnonzero(self.areas > 0.0)
        order = solid[np.argsort(-values[solid], kind="stable")]
        total = np.cumsum(self.areas[order])
        return float(values[order[min(int(np.searchsorted(total, share * total[-1] * (1.0 - 1e-12))), len(order) - 1)]])

    def record(self) -> dict[str, Any]:
        """Least, median and greatest density, median and worst ratio of the two directions, and Sander's stretch.

        stretch_mean (L2) and stretch_worst (L infinity): how long a texel is on the surface, on average and at most, where 1
        would be the same everywhere (Sander, Snyder, Gortler, Hoppe 2001, section 3). Faces without area are left out.
        """
        solid = (self.areas > 0.0) & (self.least > 0.0)
        most, least, areas = self.most[solid], self.least[solid], self.areas[solid]
        if not len(areas):
            return {}
        even = float(np.sqrt((areas * most * least).sum() / areas.sum()))
        ratio = np.sort(most / least)
        square = 0.5 * (1.0 / most**2 + 1.0 / least**2)
        density = np.sqrt(most * least)
        return {
            "texels_per_unit_least": float(density.min()),
            "texels_per_unit_median": self.met_by(0.5),
            "texels_per_unit_greatest": float(density.max()),
            "texel_ratio_median": float(ratio[len(ratio) // 2]),
            "texel_ratio_worst": float(ratio[-1]),
            "stretch_mean": even * float(np.sqrt((areas * square).sum() / areas.sum())),
            "stretch_worst": even / float(least.min()),
        }


def texel_density(mesh: Mesh, layout: Layout, width: float, height: float) -> TexelDensity:
    """Texels per unit of length: the singular values of the map from each face to a texture of so many texels.

    0 where a face has no area on the surface.
    """
    corners = mesh.vertices[mesh.faces]
    image = layout.points[layout.faces] * np.array([width, height])
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(one, axis=1)
    normal = np.cross(one, two)
    double = np.linalg.norm(normal, axis=1)
    solid = (double > 0.0) & (length > 0.0)
    base, height_of = np.where(solid, length, 1.0), np.where(solid, double / np.where(length > 0.0, length, 1.0), 1.0)
    along = np.einsum("fk,fk->f", one, two) / base
    p, q = image[:, 1] - image[:, 0], image[:, 2] - image[:, 0]
    first = p / base[:, None]
    second = (q - along[:, None] * first) / height_of[:, None]
    sum_of = 0.5 * ((first**2).sum(axis=1) + (second**2).sum(axis=1))
    determinant = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    spread = np.sqrt(np.maximum(sum_of**2 - determinant**2, 0.0))
    most = np.sqrt(sum_of + spread)
    least = np.abs(determinant) / np.where(most > 0.0, most, 1.0)
    return TexelDensity(np.where(solid, most, 0.0), np.where(solid, least, 0.0), np.where(solid, 0.5 * double, 0.0))


def edges_in_texels(layout: Layout, width: float, height: float) -> FloatArray:
    """Lengths (F, 3) of the edges from each corner of a face to the next, on a texture of so many texels."""
    corners = layout.points[layout.faces] * np.array([width, height])
    return np.asarray(np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2))


def heights_in_texels(layout: Layout, width: float, height: float) -> FloatArray:
    """Least heights (F,) of the faces on a texture of so many texels."""
    corners = layout.points[layout.faces] * np.array([width, height])
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    double = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])
    return np.asarray(double / np.maximum(edges_in_texels(layout, width, height).max(axis=1), 1e-300))


def at_places(image: np.ndarray, points: FloatArray) -> FloatArray:
    """Colours (n, k) of a texture (height, width, k) at texture coordinates (n, 2), between texels linearly.

    As OpenGL and glTF say: v points up, the middle of the texel at the lower left is at (1/2, 1/2) texels. The texture repeats
    to the left and right, and ends at the upper and lower edge.
    """
    height, width = image.shape[:2]
    x, y = points[:, 0] * width - 0.5, (1.0 - points[:, 1]) * height - 0.5
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    u, v = (x - left)[:, None], (y - top)[:, None]
    rows = [np.clip(top, 0, height - 1), np.clip(top + 1, 0, height - 1)]
    columns = [left % width, (left + 1) % width]
    upper = (1.0 - u) * image[rows[0], columns[0]] + u * image[rows[0], columns[1]]
    lower = (1.0 - u) * image[rows[1], columns[0]] + u * image[rows[1], columns[1]]
    return np.asarray((1.0 - v) * upper + v * lower)


def within_square(layout: Layout) -> tuple[FloatArray, IntArray, IntArray]:
    """Points and faces of a layout, faces that reach beyond 1 again a period to the left, and the number of each face.

    A face with a globe's pole inside lies across others, as folded ones do: these come last, and are drawn where no other is.
    """
    corners = layout.points[layout.faces]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    wrong = (np.ptp(corners[:, :, 0], axis=1) > 0.5) | (one[:, 0] * two[:, 1] <= one[:, 1] * two[:, 0])
    beyond = np.flatnonzero(corners[:, :, 0].max(axis=1) > 1.0)
    shifted = layout.points - np.array([1.0, 0.0])
    faces = np.vstack([layout.faces, layout.faces[beyond] + len(layout.points)])
    face_of = np.append(np.arange(len(layout.faces)), beyond)
    order = np.argsort(wrong[face_of], kind="stable")
    return np.vstack([layout.points, shifted]), faces[order], face_of[order]
