"""The course of retries: which map is kept of several that fold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from meshes import grid, lifted

import pgcp
from pgcp.methods.base import Failure
from pgcp.methods.pgcp import METHOD as PGCP
from pgcp.methods.registry import METHODS
from pgcp.patches.mapped import Mapped

APART = [51, 55, 111, 115, 171]  # vertices of the mesh that share no face


@pytest.fixture
def mesh():
    return lifted(grid(14, jitter=0.2))


@pytest.fixture
def spoilt():
    """Registers a method whose n-th map has the n-th of some numbers of vertices far from where they belong."""
    names = []

    def register(counts):
        left = iter(counts)

        def mapper(run, parts):
            inner = PGCP.mapper(run, parts)

            def mapped(route):
                found = inner(route)
                if isinstance(found, Failure):
                    return found
                points = found.points.copy()
                points[APART[: next(left)]] += 0.5
                assert isinstance(found, Mapped)
                return replace(found, points=points)

            return mapped

        method = METHODS.register(replace(PGCP, name=f"spoilt-{len(names)}", mapper=mapper))
        names.append(method.name)
        return method.name

    yield register
    for name in names:
        METHODS.remove(name)


def folds_of(result):
    return [tried["folds"] for tried in result.report["retries"]]


@pytest.mark.parametrize("counts", [(4, 1, 3, 2, 5, 5, 5, 5), (5, 4, 3, 2, 2, 1, 4, 5), (1, 2, 3, 4, 4, 4, 5, 5)])
def test_the_map_with_fewest_folds_is_kept_if_all_fold(mesh, spoilt, counts):
    with pytest.raises(pgcp.FoldError) as raised:
        pgcp.parameterize(mesh, target="disk", method=spoilt(counts), patches=4, repairs=(), moebius="none")
    result = raised.value.result
    folds = folds_of(result)
    assert len(folds) > 4
    assert len(set(folds)) > 2
    assert result.quality.folds == min(folds) > 0


def test_the_first_map_without_folds_ends_the_course(mesh, spoilt):
    result = pgcp.parameterize(mesh, target="disk", method=spoilt((3, 1, 0)), patches=4, repairs=(), moebius="none")
    assert len(folds_of(result)) == 2
    assert result.quality.folds == 0


def test_folds_of_the_best_map_are_repaired_at_last(mesh, spoilt):
    """What only the last tier of repair can mend waits until every attempt has folded."""
    result = pgcp.parameterize(mesh, target="disk", method=spoilt((4, 1, 3, 2, 5, 5, 5, 5)), patches=4, repairs=("embed",))
    assert len(folds_of(result)) > 4
    assert result.quality.folds == 0
    far = np.abs(result.coordinates @ [1, 1j])
    assert far.max() < 1 + 1e-12
