"""How good a map is: angle errors, Beltrami coefficients, folds, area distortion."""

from __future__ import annotations

import numba
import numpy as np

from pgcp.beltrami import folded_faces
from pgcp.operators import face_areas
from pgcp.types import ComplexArray, FloatArray, Mesh, Quality


@numba.njit(cache=True)
def corner_angles(vertices: FloatArray, faces: np.ndarray) -> FloatArray:
    """Angle of every corner (F, 3), radians, by atan2 of cross and dot product."""
    out = np.empty((faces.shape[0], 3))
    for f in range(faces.shape[0]):
        for i in range(3):
            a, b, c = faces[f, i], faces[f, (i + 1) % 3], faces[f, (i + 2) % 3]
            ux, uy, uz = (
                vertices[b, 0] - vertices[a, 0],
                vertices[b, 1] - vertices[a, 1],
                vertices[b, 2] - vertices[a, 2],
            )
            vx, vy, vz = (
                vertices[c, 0] - vertices[a, 0],
                vertices[c, 1] - vertices[a, 1],
                vertices[c, 2] - vertices[a, 2],
            )
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            out[f, i] = np.arctan2(np.sqrt(nx * nx + ny * ny + nz * nz), ux * vx + uy * vy + uz * vz)
    return out


def angle_errors(mesh: Mesh, coordinates: FloatArray) -> FloatArray:
    """|angle in the map - angle on the surface| of every corner (F, 3), degrees (PGCP eq. 5.1)."""
    flat = np.zeros((len(coordinates), 3))
    flat[:, : coordinates.shape[1]] = coordinates
    difference = corner_angles(flat, mesh.faces)
    difference -= corner_angles(mesh.vertices, mesh.faces)
    np.abs(difference, out=difference)
    return np.degrees(difference, out=difference)


def log_area_ratios(mesh: Mesh, coordinates: FloatArray) -> FloatArray:
    """d_area of every face (F,) (PGCP eq. 6.1); faces without area on either side get the largest finite value met."""
    flat = np.zeros((len(coordinates), 3))
    flat[:, : coordinates.shape[1]] = coordinates
    image, surface = face_areas(flat, mesh.faces), face_areas(mesh.vertices, mesh.faces)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.log(image / image.sum()) - np.log(surface / surface.sum())
    finite = np.isfinite(ratio)
    ratio[~finite] = np.abs(ratio[finite]).max(initial=0.0)
    return ratio


def measure_quality(mesh: Mesh, coordinates: FloatArray, mu: ComplexArray) -> Quality:
    """Measure a planar map. coordinates (V, 2), mu (F,)."""
    errors = angle_errors(mesh, coordinates).reshape(-1)
    size = np.abs(mu)
    z = coordinates[:, 0] + 1j * coordinates[:, 1]
    return Quality(
        angle_mean_deg=float(errors.mean()),
        angle_sd_deg=float(errors.std()),
        angle_median_deg=float(np.median(errors)),
        angle_p99_deg=float(np.quantile(errors, 0.99)),
        angle_max_deg=float(errors.max()),
        mu_mean=float(size.mean()),
        mu_max=float(size.max()),
        folds=len(folded_faces(mesh.faces, z)),
        log_area_mean=float(np.abs(log_area_ratios(mesh, coordinates)).mean()),
    )
