"""What memory this process may have at most, where the system sets a limit (``ulimit -v``), and what a run needs of it.

Beyond the limit libraries end the process and say nothing of use, so that what can be known is looked at before.
"""

from __future__ import annotations

from pgcp.errors import InputError
from pgcp.runtime.sizing import least_need

_LIBRARIES = 1_200_000_000  # address space of libraries, their threads and of compiling, as measured on two processors
NEEDS_MEMORY = "allow more, or use more patches"


def address_limit() -> int | None:
    """Bytes of addresses that this process may have, None where there is no limit."""
    try:
        import resource
    except ImportError:
        return None
    limits = [resource.getrlimit(kind)[0] for kind in (resource.RLIMIT_AS, resource.RLIMIT_DATA)]
    finite = [limit for limit in limits if limit != resource.RLIM_INFINITY]
    return min(finite, default=None)


def check_address_space(vertex_count: int = 0, face_count: int = 0, patches: int = 1, at_once: int = 1) -> None:
    """Raise InputError where a run on a mesh of this size, so many patches at once, needs more than the limit."""
    limit = address_limit()
    need = _LIBRARIES + (least_need(vertex_count, face_count, patches, at_once) if vertex_count else 0)
    if limit is not None and need > limit:
        what = f"{vertex_count} vertices in {patches} patches need" if vertex_count else "a run needs"
        raise InputError(
            f"{what} about {need / 1e9:.1f} GB of memory, but this process may have {limit / 1e9:.1f} GB (ulimit -v); "
            f"{NEEDS_MEMORY if vertex_count else 'allow more'}"
        )
