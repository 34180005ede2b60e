"""Seams solved exactly: what takes the place of such a map, and what is said of it."""

from __future__ import annotations

import pytest
from meshes import icosphere

import pgcp
from pgcp.types import Mesh


@pytest.mark.parametrize("method", ["dncp", "scp"])
def test_a_map_from_welds_that_is_better_says_why(method):
    ball = icosphere(2)
    result = pgcp.parameterize(Mesh(ball.vertices, ball.faces[1:], "without a face"), method=method)
    assert result.report["retries"] == []
    assert result.report["fallback"]["to"] == "welded ones"
    assert "smaller angle errors" in result.report["fallback"]["reason"]
    assert result.quality.folds == 0
