"""How good a map is: angle errors, Beltrami coefficients, folds, area distortion."""

from __future__ import annotations

import numpy as np

from pgcp.beltrami import covering_degree, folded_faces, folded_faces_on_sphere
from pgcp.distortion import angle_errors, log_area_ratios
from pgcp.operators import face_areas
from pgcp.types import ComplexArray, FloatArray, Mesh, Quality


def measure_quality(mesh: Mesh, coordinates: FloatArray, mu: ComplexArray) -> Quality:
    """Measure a map to the plane, coordinates (V, 2), or to the sphere, (V, 3), by chordal triangles. mu (F,).

    Faces without area on the surface have no angles to keep: they count for folds only.
    """
    solid = face_areas(mesh.vertices, mesh.faces) > 0.0
    errors = angle_errors(mesh, coordinates)[solid].reshape(-1)
    size = np.abs(mu[solid])
    flat = coordinates.shape[1] == 2
    folds = (
        folded_faces(mesh.faces, coordinates[:, 0] + 1j * coordinates[:, 1])
        if flat
        else folded_faces_on_sphere(mesh.faces, coordinates)
    )
    return Quality(
        angle_mean_deg=float(errors.mean()),
        angle_sd_deg=float(errors.std()),
        angle_median_deg=float(np.median(errors)),
        angle_p99_deg=float(np.quantile(errors, 0.99)),
        angle_max_deg=float(errors.max()),
        mu_mean=float(size.mean()),
        mu_max=float(size.max()),
        folds=len(folds),
        log_area_mean=float(np.abs(log_area_ratios(mesh, coordinates)[solid]).mean()),
        degree=None if flat else covering_degree(mesh.faces, coordinates),
    )
