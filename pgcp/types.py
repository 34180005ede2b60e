"""Plain data that passes between stages. Nothing here computes; arrays are checked once, at the border."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from pgcp.errors import DegenerateError, InputError

if TYPE_CHECKING:
    import networkx

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
IntArray = npt.NDArray[np.integer[Any]]
BoolArray = npt.NDArray[np.bool_]
Positions = npt.NDArray[Any]  # complex (n,) in the plane, or unit vectors (n, 3) on the sphere


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A triangle mesh: vertices (V, 3) float64, faces (F, 3) integers, kept as int32, counter-clockwise from outside.

    The last ``filler`` faces close holes: they are mapped with the others, but neither measured nor given out.
    Raises InputError where shapes, indices or coordinates are not those of a mesh.
    """

    vertices: FloatArray
    faces: IntArray
    name: str = "mesh"
    filler: int = 0

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, np.float64)
        faces = np.ascontiguousarray(self.faces)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise InputError(f"{self.name}: vertices have shape {vertices.shape}, expected (V, 3)")
        if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
            raise InputError(f"{self.name}: faces have shape {faces.shape} and type {faces.dtype}, expected (F, 3) integers")
        if len(faces) == 0:
            raise InputError(f"{self.name}: the mesh has no faces")
        low, high = int(faces.min()), int(faces.max())
        if low < 0 or high >= len(vertices):
            bad = int(np.flatnonzero((faces < 0).any(1) | (faces >= len(vertices)).any(1))[0])
            raise InputError(
                f"{self.name}: face {bad} uses vertex {high if high >= len(vertices) else low}, "
                f"but the mesh has vertices 0 to {len(vertices) - 1}"
            )
        # a sum is finite only where all terms are, but may overflow
        with np.errstate(over="ignore", invalid="ignore"):
            finite = np.isfinite(vertices.sum())
        if not finite and not np.isfinite(vertices).all():
            bad = int(np.flatnonzero(~np.isfinite(vertices).all(axis=1))[0])
            raise DegenerateError(f"{self.name}: vertex {bad} has a coordinate that is not a finite number")
        if not 0 <= self.filler < len(faces):
            raise InputError(f"{self.name}: {self.filler} of {len(faces)} faces cannot be filler")
        small = len(vertices) < 2**31
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces.astype(np.int32 if small else np.int64, copy=False))

    @property
    def bare(self) -> Mesh:
        """The mesh without its filler."""
        return Mesh(self.vertices, self.faces[: len(self.faces) - self.filler], self.name) if self.filler else self


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """One piece of a mesh, a topological disk.

    vertices (Vp, 3); faces (Fp, 3) local; vertex_ids (Vp,) and face_ids (Fp,) in the mesh;
    boundary (Bp,) local ids, counter-clockwise, from the lowest mesh vertex id on it;
    parts (Bp,) into how many parts the edge from each of them on is subdivided for welding; mollification: how much
    longer every edge is taken to be, 0 where every face has an area.
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
    be longer by ``mollification``.
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

    def tree(self) -> networkx.DiGraph:
        """The welds as a graph, to look at: an edge from each component to the union it goes into, with the seam's edges."""
        import networkx  # a tenth of a second that a run has no use for

        graph: networkx.DiGraph = networkx.DiGraph()
        graph.add_nodes_from(range(self.patch_count))
        for step in self.steps:
            for part in (step.left, step.right):
                graph.add_edge(part, step.result, seam_edges=step.seam_edge_count)
        return graph


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


@dataclass(frozen=True, slots=True, eq=False)
class Quality:
    """How good a map is, over all 3F corners and F faces.

    Angles in degrees of |angle in the map - angle on the surface| (PGCP eq. 5.1); ``log_area_mean`` is the mean
    of |d_area| (PGCP eq. 6.1); folds counts faces whose signed area in the map is not positive, on the sphere seen from
    outside. degree: how often a sphere is covered, None in the plane. conformal_energy: of a disk map, E_C = 1/2 f* L f less
    the area of the image, with the surface's cotangent Laplacian L (CCEM eq. 2.4), None elsewhere.
    """

    angle_mean_deg: float
    angle_sd_deg: float
    angle_median_deg: float
    angle_p99_deg: float
    angle_max_deg: float
    mu_mean: float
    mu_max: float
    folds: int
    log_area_mean: float
    degree: float | None = None
    conformal_energy: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Parameterization:
    """The finished map: coordinates, patch (F,), mu (F,), quality, and the report as plain data.

    coordinates (V, 2) in the plane (targets free and disk) or unit vectors (V, 3) (target sphere). Where the mesh was to be
    fixed, ``mesh`` is the fixed one, and vertex_of (V,) and face_of (F,) say which vertex and face of the input each of its
    own is; else they are None.
    """

    mesh: Mesh
    coordinates: FloatArray
    patch: IntArray
    mu: ComplexArray
    quality: Quality
    target: str
    report: dict[str, Any] = field(repr=False, default_factory=dict)
    vertex_of: IntArray | None = None
    face_of: IntArray | None = None
