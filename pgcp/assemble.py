"""Put the maps of all patches together into one, at the surface's scale."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pgcp.beltrami import signed_area
from pgcp.operators import face_areas
from pgcp.types import ComplexArray, FloatArray, IntArray, Mesh, Patch, PatchMap


def collect(mesh: Mesh, parts: Iterable[tuple[Patch, PatchMap]]) -> tuple[ComplexArray, ComplexArray]:
    """One array of positions z (V,) and one of Beltrami coefficients mu (F,) from all patches.

    Vertices on seams have the same position in every patch that holds them. Vertices used by no face stay at 0.
    """
    z = np.zeros(len(mesh.vertices), np.complex128)
    mu = np.zeros(len(mesh.faces), np.complex128)
    for patch, solved in parts:
        z[patch.vertex_ids] = solved.z
        mu[patch.face_ids] = solved.mu
    return z, mu


def place(mesh: Mesh, z: ComplexArray, boundary: IntArray) -> FloatArray:
    """Coordinates (V, 2): total area as on the surface, boundary centred at the origin, its long axis horizontal."""
    centred = z - z[boundary].mean()
    axis = np.exp(-0.5j * np.angle(np.sum(centred[boundary] ** 2)))
    area = abs(signed_area(mesh.faces, z))
    scale = np.sqrt(face_areas(mesh.vertices, mesh.faces).sum() / area) if area > 0 else 1.0
    placed = centred * axis * scale
    used = np.zeros(len(z), bool)
    used[mesh.faces.reshape(-1)] = True
    placed[~used] = 0.0
    return np.column_stack([placed.real, placed.imag])
