"""Versions of the packages that results depend on."""

from __future__ import annotations

import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version

_PACKAGES = ("pgcp", "numpy", "scipy", "numba", "dask", "distributed", "pymetis", "mkl")


@cache
def package_versions() -> dict[str, str]:
    """Version of Python and of each package that is installed here."""
    out = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            continue
    return out
