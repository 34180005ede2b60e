"""CEM and CCEM where there is next to nothing to map: a single face, faces without inner vertices."""

from __future__ import annotations

import numpy as np
import pytest

import pgcp
from pgcp.methods.common.disk import inscribed
from pgcp.types import Mesh

TRIANGLES = {
    "right": [(0, 0, 0), (1, 0, 0), (0, 1, 0)],
    "obtuse": [(0, 0, 0), (10, 0, 0), (5, 0.2, 0)],
    "needle": [(0, 0, 0), (1, 0, 0), (0, 0.001, 0)],
    "turned": [(3, 1, 2), (1, -4, 2), (0, 2, 9)],
}


@pytest.mark.parametrize("method", ["cem", "ccem"])
@pytest.mark.parametrize("name", TRIANGLES)
def test_a_triangle_is_mapped_exactly(name, method):
    for faces in ([[0, 1, 2]], [[2, 1, 0]]):
        result = pgcp.parameterize(Mesh(np.array(TRIANGLES[name], float), np.array(faces)), method=method, target="disk")
        assert np.abs(np.linalg.norm(result.coordinates, axis=1) - 1.0).max() < 1e-12
        assert np.abs(result.mu).max() < 1e-9


@pytest.mark.parametrize("method", ["cdcp", "cem"])
def test_three_boundary_vertices_are_enough(method):
    """Of a flat pyramid, whose harmonic boundary (CDCP eq. 18) does not go around the pole."""
    points = np.array([(0, 0, 0), (1, 0, 0), (0.4, 1, 0), (0.45, 0.3, 2)])
    result = pgcp.parameterize(Mesh(points, np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]])), method=method, target="disk")
    assert result.quality.folds == 0
    assert np.abs(np.linalg.norm(result.coordinates[:3], axis=1) - 1).max() < 1e-12


def test_arcs_of_a_triangle_are_twice_its_angles():
    assert inscribed(np.array(TRIANGLES["right"], float)) == pytest.approx([0, np.pi / 2, 3 * np.pi / 2])


@pytest.mark.parametrize("method", ["cem", "ccem"])
def test_without_inner_vertices_there_is_a_map(method):
    fan = [(np.cos(a), np.sin(a), 0.3 * a) for a in np.linspace(0, 5, 8)]
    faces = [(0, k, k + 1) for k in range(1, 7)]
    result = pgcp.parameterize(Mesh(np.array(fan), np.array(faces)), method=method, target="disk")
    assert result.quality.folds == 0
    assert result.report["converged"] == (method == "ccem")
    if method == "cem":
        assert len(result.report["iterations"]) == 1
