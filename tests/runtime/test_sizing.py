from __future__ import annotations

import pytest

from pgcp.errors import InputError
from pgcp.runtime.sizing import make_plan


def test_patches_by_vertices_and_workers():
    assert make_plan(16, 18, 0).patches == 1
    assert make_plan(16, 18, 0, fewest=2).patches == 2
    assert make_plan(200, 338, 0).patches == 3
    assert make_plan(150_000, 300_000, 0).patches == 6
    assert make_plan(700_000, 1_400_000, 2).patches == 6
    assert make_plan(1_100_000, 2_200_000, 2).patches == 10
    assert make_plan(2_300_000, 4_600_000, 2).patches == 12
    assert make_plan(10_000_000, 19_990_000, 2).patches == 50
    assert make_plan(1_100_000, 2_200_000, 16).patches == 16
    assert make_plan(1_000, 2_000, 16).patches == 6  # not for a mesh on which more processes would be of no use
    assert make_plan(10_000_000, 19_990_000, 2, patches=8).patches == 8


def test_short_memory_means_more_patches_and_fewer_kept_factors():
    plans = [make_plan(10_000_000, 19_990_000, 2, memory_limit_bytes=int(gb * 1e9)) for gb in (64, 6, 4)]
    assert [plan.patches for plan in plans] == sorted(plan.patches for plan in plans)
    assert [plan.factor_cache_bytes for plan in plans] == sorted((plan.factor_cache_bytes for plan in plans), reverse=True)
    assert plans[0].factor_cache_bytes == make_plan(10_000_000, 19_990_000, 2).factor_cache_bytes
    assert plans[-1].patches > plans[0].patches
    assert make_plan(10_000_000, 19_990_000, 2, memory_limit_bytes=8 * 10**9, factor_cache_bytes=7).factor_cache_bytes == 7


def test_a_closed_surface_needs_more():
    assert make_plan(10_000_000, 19_999_996, 2, memory_limit_bytes=55 * 10**8).patches > 50
    assert make_plan(10_000_000, 19_990_000, 2, memory_limit_bytes=55 * 10**8).patches == 50
    with pytest.raises(InputError, match=r"need about 5\.\d GB"):
        make_plan(10_000_000, 19_999_996, 2, memory_limit_bytes=4 * 10**9)


def test_too_little_memory_is_said():
    with pytest.raises(InputError, match=r"10000000 vertices in .* need about .* GB, more than the memory limit of 2.0 GB"):
        make_plan(10_000_000, 19_990_000, 2, memory_limit_bytes=2 * 10**9)
    with pytest.raises(InputError, match="in 2 patches on 2 processes"):
        make_plan(10_000_000, 19_990_000, 2, patches=2, memory_limit_bytes=8 * 10**9)
