"""DNCP of the undivided mesh: the free boundary that minimises the conformal energy, two vertices pinned (PGCP section 4.2)."""

from __future__ import annotations

from dataclasses import replace

from pgcp.methods.base import Method
from pgcp.methods.pgcp import Welds, to_target, welds_and_exact

METHOD = Method(
    name="dncp",
    targets=("free",),
    summary="discrete natural conformal map of the undivided mesh, two boundary vertices pinned",
    guarantees="the same map for any cuts, to about 1e-9 of its extent",
    reference="Desbrun, Meyer, Alliez 2002; PGCP section 4.2",
    mapper=Welds,
    attempts=welds_and_exact,
    options=lambda options: replace(options, seams="exact", flatten="dncp"),
    to_target=to_target,
)
