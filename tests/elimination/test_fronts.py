"""Dense fronts against numpy."""

from __future__ import annotations

import numpy as np
import pytest

from pgcp.elimination.fronts import add_update, clear, eliminate, padded, store_update


def positive(width: int, seed: int) -> np.ndarray:
    a = np.random.default_rng(seed).standard_normal((width, width))
    return a @ a.T + width * np.eye(width)


def front_of(matrix: np.ndarray) -> np.ndarray:
    """Its upper triangle as a front, with numbers that mean nothing where none is to be looked at."""
    width = len(matrix)
    rows = np.full((width, padded(width)), 7.0)
    rows[:, :width] = np.where(np.tri(width, k=-1, dtype=bool), 7.0, matrix)
    return rows.reshape(-1)


@pytest.mark.parametrize("width", [1, 2, 5, 8, 9, 31, 64, 191, 192, 193, 260])
@pytest.mark.parametrize("part", [0.0, 0.1, 0.5, 1.0])
def test_what_is_eliminated_is_a_cholesky_factor_and_what_is_left_the_schur_complement(width, part):
    own = round(part * width)
    matrix = positive(width, width)
    front = front_of(matrix)
    assert eliminate(front, own, width)
    rows = np.triu(front.reshape(width, -1)[:, :width])
    upper = np.linalg.cholesky(matrix[:own, :own]).T if own else np.empty((0, 0))
    beside = np.linalg.solve(upper.T, matrix[:own, own:]) if own else np.empty((0, width))
    assert np.abs(rows[:own, :own] - upper).max(initial=0.0) < 1e-12 * width
    assert np.abs(rows[:own, own:] - beside).max(initial=0.0) < 1e-12 * width
    left = np.triu(matrix[own:, own:] - beside.T @ beside)
    assert np.abs(rows[own:, own:] - left).max(initial=0.0) < 1e-12 * width


@pytest.mark.parametrize(("width", "bad"), [(40, -1.0), (40, 0.0), (40, np.nan), (250, -1.0), (250, 0.0)])
def test_a_pivot_that_is_not_positive_is_said(width, bad):
    for own in (1, 4, 7, 30):
        matrix = positive(width, 1)
        matrix[own - 1, own - 1] = bad
        assert not eliminate(front_of(matrix), own, width)


@pytest.mark.parametrize("width", [13, 200])
def test_updates_are_added_where_they_belong_from_a_stack_and_from_another_front(width):
    rng = np.random.default_rng(width)
    own, child = 3, positive(width - 2, 4)
    left = child[own:, own:]
    into = np.sort(rng.choice(width, len(left), replace=False)).astype(np.int32)
    stack = np.zeros(width * width)
    top = store_update(front_of(child), own, len(child), stack, 5)
    assert top == 5 + len(left) * (len(left) + 1) // 2
    step = padded(len(child)) + 1
    front = np.full(width * padded(width), 7.0)
    clear(front, width)
    add_update(front, width, into, stack, 5, len(left), 1)
    add_update(front, width, into, front_of(child), own * step, step, 0)
    expected = np.zeros((width, width))
    expected[np.ix_(into, into)] = 2.0 * left
    assert (np.triu(front.reshape(width, -1)[:, :width]) == np.triu(expected)).all()
