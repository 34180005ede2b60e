"""SCP of the undivided mesh: the spectral conformal map, no vertex pinned."""

from __future__ import annotations

from dataclasses import replace

from pgcp.methods.base import Method
from pgcp.methods.pgcp import Welds, to_target, welds_and_exact

METHOD = Method(
    name="scp",
    targets=("free",),
    summary="spectral conformal map of the undivided mesh: an eigenvector on the boundary, no vertex pinned",
    guarantees="the same map for any cuts, to about 1e-9 of its extent",
    reference="Mullen, Tong, Alliez, Desbrun 2008",
    mapper=Welds,
    attempts=welds_and_exact,
    options=lambda options: replace(options, seams="exact", flatten="scp"),
    to_target=to_target,
)
