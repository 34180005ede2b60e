"""Which attempt comes next, told without a single map."""

from __future__ import annotations

import pytest

from pgcp.methods.base import EXACT, WHOLE, Attempt, Choice, once
from pgcp.methods.pgcp import welds_and_exact
from pgcp.retry.decide import Tried, next_attempt

PLANS = 5


def order(**choice):
    return list(welds_and_exact(Choice(**choice)))


def failed(attempt, stage, crowded=False):
    return Tried(attempt, 0.0, "made to fail", stage=stage, crowded=crowded)


def folded(attempt, folds=3):
    return Tried(attempt, 0.0, "folds", folds)


def course(attempts, outcome):
    """All attempts that are made where each ends as ``outcome`` says."""
    history = []
    while (attempt := next_attempt(attempts, history)) is not None:
        history.append(outcome(attempt))
        assert len(history) < 100
    return [tried.attempt for tried in history]


def test_three_seeds_are_tried_then_half_the_patches_and_so_on():
    attempts = order(patches=6, seed=4)
    assert list(dict.fromkeys((a.patches, a.seed) for a in attempts)) == [(6, 4), (6, 5), (6, 6), (3, 4), (1, 4)]
    assert [a.route for a in attempts[: PLANS + 1]] == [0, 1, 2, 3, 4, EXACT]
    closed = order(patches=6, fewest=2)
    assert list(dict.fromkeys(a.patches for a in closed)) == [6, 3, 2]


def test_exact_seams_come_first_where_they_are_asked_for_and_nothing_else_varies():
    attempts = order(patches=6, varies=False, exact_first=True)
    assert [a.route for a in attempts] == [EXACT, 0, 1, 2, 3, 4]
    assert {(a.patches, a.seed) for a in attempts} == {(6, 0)}


def test_a_method_of_one_route_is_tried_once():
    attempts = list(once(Choice(6, 2)))
    assert attempts == [Attempt(6, 2, WHOLE)]
    assert next_attempt(attempts, [folded(attempts[0])]) is None


def test_the_first_attempt_is_the_first_of_the_order():
    attempts = order(patches=6)
    assert next_attempt(attempts, []) == attempts[0]
    assert next_attempt([], []) is None


def test_every_weld_is_tried_while_welds_fail_and_exact_seams_once():
    made = course(order(patches=4), lambda attempt: failed(attempt, "exact" if attempt.route == EXACT else "weld"))
    assert [a for a in made if a.route == EXACT] == [Attempt(4, 0, EXACT)]
    welds = [a for a in made if a.route != EXACT]
    assert welds == [Attempt(n, s, k) for n, s in [(4, 0), (4, 1), (4, 2), (2, 0), (1, 0)] for k in range(PLANS)]
    assert made.index(Attempt(4, 0, EXACT)) == PLANS  # after the welds of the first seed


def test_two_folded_maps_are_enough_of_so_many_patches():
    made = course(order(patches=4), folded)
    assert made == [Attempt(4, 0, 0), Attempt(4, 0, 1), Attempt(4, 0, EXACT), Attempt(2, 0, 0), Attempt(2, 0, 1),
                    Attempt(1, 0, 0), Attempt(1, 0, 1)]  # fmt: skip


def test_a_folded_map_of_exact_seams_counts():
    attempts = order(patches=4, exact_first=True)
    made = course(attempts, folded)
    assert [a for a in made if a.patches == 4] == [Attempt(4, 0, EXACT), Attempt(4, 0, 0)]


@pytest.mark.parametrize("stage", ["flatten", "plan"])
def test_no_weld_follows_a_flattening_that_failed_nor_the_last_plan(stage):
    attempts = order(patches=2, varies=False)
    history = [failed(attempts[0], "weld"), failed(attempts[1], stage)]
    assert next_attempt(attempts, history) == Attempt(2, 0, EXACT)


def test_nothing_of_a_split_that_failed_is_tried():
    attempts = order(patches=4)
    assert next_attempt(attempts, [failed(attempts[0], "split")]) == Attempt(4, 1, 0)


def test_a_weld_that_failed_says_nothing_of_the_next_seed():
    attempts = order(patches=4)
    history = [failed(a, "exact" if a.route == EXACT else "weld") for a in attempts if a.seed == 0 and a.patches == 4]
    assert next_attempt(attempts, history) == Attempt(4, 1, 0)


def test_where_there_is_no_room_no_other_weld_of_the_split_is_tried():
    attempts = order(patches=4)
    assert next_attempt(attempts, [failed(attempts[0], "weld", crowded=True)]) == Attempt(4, 0, EXACT)
    # exact seams that find no room leave the welds of another seed
    history = [failed(attempts[0], "weld", crowded=True), failed(Attempt(4, 0, EXACT), "exact", crowded=True)]
    assert next_attempt(attempts, history) == Attempt(4, 1, 0)


def test_where_there_is_no_room_fewer_patches_find_none_either():
    made = course(order(patches=4), lambda attempt: failed(attempt, "weld", crowded=True))
    assert {a.patches for a in made} == {4}


def test_where_every_weld_of_a_split_is_blurred_and_exact_seams_fail_no_other_split_is_tried():
    attempts = order(patches=4)
    welds = [Tried(a, 0.0, "made to fail", None, "weld", blurred=True) for a in attempts[:PLANS]]
    assert next_attempt(attempts, welds) == Attempt(4, 0, EXACT)
    assert next_attempt(attempts, [*welds, failed(Attempt(4, 0, EXACT), "exact")]) is None
    other = [failed(attempts[0], "weld"), *welds[1:], failed(Attempt(4, 0, EXACT), "exact")]
    assert next_attempt(attempts, other) == Attempt(4, 1, 0)


def test_fewer_patches_are_tried_where_there_was_a_map_or_another_failure():
    attempts = order(patches=4)
    tried = [a for a in attempts if a.patches == 4]
    crowded = [failed(a, "weld", crowded=True) for a in tried]
    assert next_attempt(attempts, crowded) is None
    assert next_attempt(attempts, [*crowded[:-1], failed(tried[-1], "weld")]) == Attempt(2, 0, 0)
    assert next_attempt(attempts, [folded(tried[0]), *crowded[1:]]) == Attempt(2, 0, 0)
    # that there is no further plan is no failure
    assert next_attempt(attempts, [*crowded[:-1], failed(tried[-1], "plan")]) is None


def test_what_the_report_says_of_an_attempt():
    tried = Tried(Attempt(6, 2, 1), 0.25, "3 folds", 3)
    assert tried.record() == {"patches": 6, "seed": 2, "route": 0.25, "folds": 3, "reason": "3 folds"}
