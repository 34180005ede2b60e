"""Patches, their boundary curves and maps, and the plan by which they are welded: plain data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgcp.types import ComplexArray, FloatArray, IntArray, Positions


@dataclass(frozen=True, slots=True, eq=False)
class FaceOrder:
    """A patch's faces (Fp,) as the first pass has dissected them."""

    order: IntArray


@dataclass(frozen=True, slots=True)
class SolveReport:
    """What the second pass says of a patch; its arrays are in the store. reused_factor: that of the first pass."""

    patch: int
    fold_count: int
    first_fold_count: int
    raised_weights: int
    mu_max: float
    reused_factor: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """One piece of a mesh, a topological disk.

    vertices (Vp, 3); faces (Fp, 3) local; vertex_ids (Vp,) and face_ids (Fp,) in the mesh;
    boundary (Bp,) local ids, counter-clockwise, from the lowest mesh vertex id on it;
    parts (Bp,) into how many parts the edge from each of them on is subdivided for welding; mollification: how much
    longer edges of faces without area are taken to be at the most, 0 where every face has an area.
    """

    index: int
    vertices: FloatArray
    faces: IntArray
    vertex_ids: IntArray
    face_ids: IntArray
    boundary: IntArray
    parts: IntArray
    mollification: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class PatchOutline:
    """What is remembered of a patch that lies in the store: counts, and its boundary_ids (Bp,) in the mesh."""

    index: int
    vertex_count: int
    face_count: int
    boundary_ids: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class EdgeTable:
    """All seam and boundary edges of a split: sorted keys ``low * vertex_count + high`` (E,), and parts (E,).

    ``parts`` says into how many equal parts each edge is subdivided for welding, the same from either side. The node
    inserted as the t-th from the lower vertex has a number of its own, from vertex_count upwards. Every edge is taken to
    be at least ``mollification`` long.
    """

    keys: IntArray
    parts: IntArray
    vertex_count: int
    mollification: float = 0.0

    def rank(self, tails: IntArray, heads: IntArray) -> IntArray:
        """Positions in the table of edges given by their ends."""
        wanted = np.minimum(tails, heads) * self.vertex_count + np.maximum(tails, heads)
        return np.searchsorted(self.keys, wanted)

    def inserted_node(self, rank: IntArray, t: IntArray) -> IntArray:
        """Number of the t-th (1 .. parts - 1) node inserted into an edge, counted from its lower vertex."""
        first = np.cumsum(self.parts - 1) - (self.parts - 1)
        return self.vertex_count + first[rank] + t - 1


@dataclass(frozen=True, slots=True, eq=False)
class BoundaryCurve:
    """The boundary of a flattened patch, all that travels for welding.

    vertex_ids (B,) in order, counter-clockwise; z positions, for every edge its tail and the points that subdivide it.
    ``pieces`` is 1, or the number of pieces the patch was flattened in because its free boundary crossed itself.
    """

    patch: int
    vertex_ids: IntArray
    z: ComplexArray
    pieces: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class Component:
    """A welded union of patches.

    nodes (N,) distinct node ids, below vertex_count those of mesh vertices, and z (N,) their positions; loop (B,) indices
    into them, counter-clockwise, none where the union is closed (one position is then infinity); edges (M, 2) indices,
    with their lengths (M,) on the surface.
    """

    nodes: IntArray
    z: ComplexArray
    loop: IntArray
    edges: IntArray
    lengths: FloatArray
    vertex_count: int

    @property
    def corners(self) -> IntArray:
        """Positions in the loop that hold mesh vertices, not inserted nodes."""
        return np.flatnonzero(self.nodes[self.loop] < self.vertex_count)


@dataclass(frozen=True, slots=True, eq=False)
class SeamPositions:
    """Where the seam and boundary vertices lie in the target: vertex_ids (N,), points (N,) complex or (N, 3) unit vectors.

    smallest_gap is the least distance between neighbours on the circle or sphere (0 for the plane); spread_count how many
    of them had to be moved apart to be told from each other.
    """

    vertex_ids: IntArray
    points: Positions
    smallest_gap: float = 0.0
    spread_count: int = 0


@dataclass(frozen=True, slots=True)
class WeldStep:
    """Weld component ``left`` and component ``right`` into component ``result``.

    Components 0..K-1 are the patches; later ones are unions. ``level`` is the step's depth in the tree:
    steps of one level are independent of each other. A closed step joins two disks along their whole boundaries.
    """

    left: int
    right: int
    result: int
    level: int
    seam_edge_count: int
    closed: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class WeldPlan:
    """All welds, in an order in which every component exists before it is used."""

    patch_count: int
    steps: tuple[WeldStep, ...]

    @property
    def levels(self) -> tuple[tuple[WeldStep, ...], ...]:
        """Steps grouped by level."""
        depth = max((step.level for step in self.steps), default=0)
        return tuple(tuple(s for s in self.steps if s.level == level) for level in range(1, depth + 1))


@dataclass(frozen=True, slots=True, eq=False)
class PatchMap:
    """The solved map of one patch, and what the fold check saw.

    points: complex (Vp,) in the plane or unit vectors (Vp, 3) on the sphere; mu (Fp,) on its faces. fold_count folds are
    left of first_fold_count, for which raised_weights weights of the Laplacian were made positive.
    """

    patch: int
    points: Positions
    mu: ComplexArray
    fold_count: int
    mu_max: float
    first_fold_count: int = 0
    raised_weights: int = 0
