"""Of maps that all fold, the one with fewest folds is kept, whichever came first."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import pytest

from pgcp.methods.base import Choice
from pgcp.methods.pgcp import welds_and_exact
from pgcp.options import Options
from pgcp.retry import course


@dataclass
class Done:
    folds: int
    repaired: SimpleNamespace
    attempt: object
    error: float | None = None


class Splits:
    """Every attempt leads to a map, which is the attempt."""

    def __init__(self, run, method):
        self.maps, self.parts = [], None

    def map(self, attempt):
        return SimpleNamespace(attempt=attempt, route=attempt.route)

    def discard(self):
        pass


def kept(folds, monkeypatch, patches=4):
    """The map that is kept where attempt number n leaves folds[n] folds, (after, before) repair, and the attempts made."""
    made = []

    def finish(_run, _method, found):
        after, before = folds[len(made)]
        made.append(found.attempt)
        return Done(after, SimpleNamespace(folds_before=before), found.attempt)

    monkeypatch.setattr(course, "_Splits", Splits)
    monkeypatch.setattr(course, "finish", finish)
    monkeypatch.setattr(course, "mean_error", lambda _run, _done: 1.0)
    monkeypatch.setattr(course, "repaired_at_last", lambda _run, done: done)
    monkeypatch.setattr(course, "may_help", lambda *_: False)
    monkeypatch.setattr(course, "are_few", lambda _run, _folds: True)
    run = SimpleNamespace(
        options=Options(),
        patch_count=patches,
        fewest_patches=1,
        is_closed=False,
        boundary=range(12),
        target=SimpleNamespace(has_free_boundary=True),
    )
    monkeypatch.setattr(course, "target_of", lambda target: target)
    method = SimpleNamespace(attempts=welds_and_exact, to_target=object())
    best, _ = course._best(run, method)
    return best, made


COUNTS = [5, 3, 8, 2, 9, 4, 7, 6, 10, 11, 12, 13, 14, 15]


@pytest.mark.parametrize("first", range(4))
def test_the_map_with_fewest_folds_is_kept(first, monkeypatch):
    folds = [(count, count) for count in COUNTS[first:] + COUNTS[:first]]
    best, made = kept(folds, monkeypatch)
    assert len(made) > 2
    assert best.folds == min(after for after, _ in folds[: len(made)])


def test_of_as_many_folds_left_fewer_before_repair_are_better(monkeypatch):
    folds = [(3, 50), (3, 20), (3, 90), *[(3, 70)] * 20]
    best, _ = kept(folds, monkeypatch)
    assert best.repaired.folds_before == 20


def test_the_first_map_without_folds_ends_the_search(monkeypatch):
    best, made = kept([(4, 4), (0, 2), (1, 1)], monkeypatch)
    assert best.folds == 0
    assert best.attempt == made[-1]
    assert len(made) == 2
    order = list(welds_and_exact(Choice(4)))
    assert made[0] == order[0]


@pytest.mark.parametrize(("vertices", "fewest"), [(200, 1), (7000, 2), (90_000, 8)])
def test_patches_keep_to_boundaries_that_can_be_solved_densely(vertices, fewest):
    run = SimpleNamespace(options=Options(), patch_count=8, fewest_patches=1, is_closed=False, boundary=range(vertices))
    assert course._choice(run).fewest == fewest
    assert min(attempt.patches for attempt in welds_and_exact(course._choice(run))) == fewest
