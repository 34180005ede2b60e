"""Seams solved exactly: whatever the cuts, what one elimination of the whole mesh gives."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import cap, grid, icosphere, lifted, similarity_error, spheroid, tetrahedron
from oracles import moebius_distance
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

import pgcp
from pgcp.api import compute
from pgcp.elimination.dirichlet import choose_backend, eliminate_interior
from pgcp.interface import whole_mesh
from pgcp.interface.factor import InterfaceFactor
from pgcp.interface.merge import Merge, extend_inside, merge_operators, plan_merges
from pgcp.interface.puncture import open_at, puncture_face, straightened
from pgcp.interface.tasks import pack_load
from pgcp.methods import pgcp as welds
from pgcp.options import Options
from pgcp.patches.flatten import dncp_boundary, scp_boundary
from pgcp.patches.plan import plan_welds
from pgcp.patches.split import cut_patch, split_mesh
from pgcp.plane.curves import crosses_itself
from pgcp.runtime.cache import FACTORS, Owner
from pgcp.runtime.executors import LocalExecutor
from pgcp.runtime.job import Job
from pgcp.runtime.store import PatchStore
from pgcp.surface.operators import cotangent_laplacian
from pgcp.surface.topology import examine
from pgcp.types import Mesh


def uneven(levels=2):
    """A closed surface without symmetry."""
    mesh = icosphere(levels)
    rng = np.random.default_rng(1)
    return Mesh(mesh.vertices * (1 + 0.1 * rng.uniform(size=len(mesh.vertices)))[:, None] * [1, 1.3, 0.8], mesh.faces)


OPEN = {"hills": lifted(grid(15, 11, jitter=0.3)), "cap": cap(9)[0]}


def kept_of(mesh):
    """The boundary loop, or what is kept of a closed surface."""
    loops = examine(mesh.faces, len(mesh.vertices)).loops
    return loops[0] if loops else open_at(mesh, puncture_face(mesh)).kept


def patchwise(mesh, count, folder, kept, cache=2**30):
    """The InterfaceFactor of a mesh in so many patches."""
    topology = examine(mesh.faces, len(mesh.vertices))
    split = split_mesh(mesh, topology, count)
    patches = [cut_patch(mesh, topology, split, index) for index in range(count)]
    for patch in patches:
        PatchStore(folder).write("patch", patch.index, patch)
    job = Job(Owner(f"{mesh.name}-{count}-{folder}"), folder, "dncp", choose_backend(), cache)
    plan = plan_welds(split.table, count, closed=not examine(mesh.faces, len(mesh.vertices)).loops)
    factor = InterfaceFactor(LocalExecutor(), job, count, plan, kept, len(mesh.vertices))
    factor.eliminate_patches()
    factor.merge()
    return factor, patches, split


@pytest.mark.parametrize("cache", [0, 2**30], ids=["factors made again", "factors kept"])
@pytest.mark.parametrize(
    ("mesh", "count"),
    [(OPEN["hills"], k) for k in (1, 2, 5, 9)] + [(OPEN["cap"], 7), (uneven(), 2), (uneven(), 6)],
    ids=lambda value: getattr(value, "name", value),
)
def test_patches_give_the_operator_and_the_extension_of_the_whole(mesh, count, cache, tmp_path):
    kept = kept_of(mesh)
    factor, _, _ = patchwise(mesh, count, tmp_path, kept, cache)
    whole = eliminate_interior(cotangent_laplacian(mesh.vertices, mesh.faces), kept, "superlu")
    assert np.abs(factor.schur - whole.schur).max() < 1e-10 * np.abs(whole.schur).max()
    values = np.random.default_rng(0).normal(size=(len(kept), 2)) @ [1, 1j]
    expected = whole.extend(values)
    for _ in range(2):
        assert np.abs(factor.extend(values) - expected).max() < 1e-10 * np.abs(values).max()
    seams = factor.extend_seams(np.column_stack([values.real, values.imag, np.ones(len(kept))]))
    on_seam = seams[:, 2] != 0
    assert on_seam.sum() == len(mesh.vertices) - factor.levels[0]["eliminated"]
    assert np.array_equal(seams[on_seam, 2], np.ones(on_seam.sum()))
    assert np.abs(seams[on_seam] @ [1, 1j, 0] - expected[on_seam]).max() < 1e-10 * np.abs(values).max()


def test_every_seam_vertex_is_eliminated_once_and_not_before_all_its_patches_are_in(tmp_path):
    mesh = OPEN["hills"]
    kept = kept_of(mesh)
    factor, patches, split = patchwise(mesh, 9, tmp_path, kept)
    merges = plan_merges(plan_welds(split.table, 9), [p.vertex_ids[p.boundary] for p in patches], kept)
    held = {p.index: {p.index} for p in patches}
    holders = {}
    for patch in patches:
        for vertex in patch.vertex_ids[patch.boundary].tolist():
            holders.setdefault(vertex, set()).add(patch.index)
    assert max(len(h) for h in holders.values()) > 2
    gone = []
    for merge in merges:
        held[merge.result] = held.pop(merge.left) | held.pop(merge.right)
        for vertex in merge.eliminated.tolist():
            assert holders[vertex] <= held[merge.result]
        gone += merge.eliminated.tolist()
    assert sorted(gone) == sorted(set(holders) - set(kept.tolist()))
    counted = [sum(len(m.eliminated) for m in merges if m.level == row["level"]) for row in factor.levels[1:]]
    assert counted == [row["eliminated"] for row in factor.levels[1:]]
    files = [*tmp_path.glob("inside-*.npy"), *tmp_path.glob("pivot-*.npy")]
    stored = sum(path.stat().st_size - 128 for path in files) + 8 * len(kept) ** 2
    assert factor.nbytes == stored
    assert len(list(tmp_path.glob("operator-*.npy"))) == 1
    before = FACTORS.nbytes
    factor.release()
    assert FACTORS.nbytes < before
    assert not list(tmp_path.glob("*.npy"))


def test_values_pass_inside_in_any_number_of_columns_and_constants_exactly():
    inside = np.random.default_rng(0).dirichlet(np.ones(6), size=4)
    z = np.random.default_rng(1).normal(size=(6, 3, 2)) @ [1, 1j]
    assert np.allclose(extend_inside(inside, z), inside @ z, rtol=1e-14, atol=0)
    assert np.allclose(extend_inside(inside, z[:, 0]), inside @ z[:, 0], rtol=1e-13, atol=0)
    assert np.allclose(extend_inside(inside, z.real), inside @ z.real, rtol=1e-12, atol=0)
    assert np.array_equal(extend_inside(inside, np.full(6, 0.1 + 0.7j)), np.full(4, 0.1 + 0.7j))


def test_an_operator_that_is_not_definite_is_refused():
    ids = np.arange(3)
    merge = Merge(0, 1, 2, 1, ids, ids, np.array([2]), np.array([0, 1]))
    with pytest.raises(pgcp.errors.SolveFailedError, match="not positive definite"):
        merge_operators(-np.eye(3), np.zeros((3, 3)), merge)


def harmonic(mesh, boundary, values):
    """One sparse solve of the whole mesh's Laplace equation."""
    laplacian = csc_array(cotangent_laplacian(mesh.vertices, mesh.faces))
    inner = np.setdiff1d(np.arange(len(mesh.vertices)), boundary)
    right = -(laplacian[inner][:, boundary] @ np.column_stack([values.real, values.imag]))
    z = np.zeros(len(mesh.vertices), complex)
    z[boundary], z[inner] = values, splu(csc_array(laplacian[inner][:, inner])).solve(right) @ [1, 1j]
    return z


@pytest.mark.parametrize("target", ["free", "disk"])
@pytest.mark.parametrize("patches", [1, 4, 9])
def test_relaxed_is_the_harmonic_map_of_the_whole_mesh_with_the_welded_boundary(patches, target, hills):
    loop = kept_of(hills)
    results = {
        s: pgcp.parameterize(hills, patches=patches, target=target, seams=s, moebius="none", repairs=("relax",))
        for s in ("weld", "relax")
    }
    z = results["relax"].coordinates @ [1, 1j]
    assert np.abs(z - harmonic(hills, loop, z[loop])).max() < 1e-11
    welded = results["weld"].coordinates @ [1, 1j]
    assert similarity_error(z[loop], welded[loop]) < 1e-12
    assert results["relax"].report["seams"] == "relax"
    assert results["relax"].report["interface"]["vertices"] == len(loop)


@pytest.mark.parametrize(("method", "boundary_map"), [("dncp", dncp_boundary), ("scp", scp_boundary)])
def test_exact_is_the_single_domain_map_whatever_the_cuts(method, boundary_map, hills):
    loop = kept_of(hills)
    factor = eliminate_interior(cotangent_laplacian(hills.vertices, hills.faces), loop, "superlu")
    whole = factor.extend(boundary_map(factor.schur, hills.vertices[loop]))
    for patches in (1, 2, 6, 12):
        result = pgcp.parameterize(hills, patches=patches, seams="exact", flatten=method)
        assert similarity_error(result.coordinates @ [1, 1j], whole) < 1e-9
        assert result.quality.folds == 0


@pytest.mark.parametrize("target", ["free", "disk", "sphere"])
def test_exact_maps_agree_in_every_position_after_all_corrections(target, hills):
    mesh = uneven(3) if target == "sphere" else hills
    counts = (2, 6, 12) if target == "sphere" else (1, 2, 6, 12)
    results = [pgcp.parameterize(mesh, patches=count, target=target, seams="exact") for count in counts]
    for result in results:
        assert np.abs(result.coordinates - results[0].coordinates).max() < 1e-9 * np.ptp(results[0].coordinates)
    cells = results[1].report["interface"]["levels"]
    assert [row["level"] for row in cells] == list(range(len(cells)))
    assert all(row["bytes"] > 0 for row in cells)
    assert all(row["flops"] > 0 for row in cells[1:])


def test_an_exact_sphere_nears_the_conformal_map_of_the_surface():
    distances = []
    for levels in (2, 3, 4):
        mesh, image = spheroid(levels, 2.0)
        result = pgcp.parameterize(mesh, patches=4, seams="exact")
        assert result.quality.degree == pytest.approx(1.0)
        distances.append(moebius_distance(result.coordinates, image))
    assert np.log2(np.array(distances[:-1]) / distances[1:]).min() > 1.8
    assert distances[-1] < 2e-3


def test_an_affine_image_of_a_conformal_map_is_straightened():
    mesh, exact = cap(30)
    bent = exact + (0.3 - 0.2j) * exact.conj()
    assert similarity_error(straightened(mesh, bent, np.ones(len(bent), bool)), exact) < 1e-3 < similarity_error(bent, exact)


def test_either_ring_parts_an_opened_surface():
    mesh = uneven(3)
    opened = open_at(mesh, 7)
    assert sorted(opened.corners) == sorted(mesh.faces[7])
    assert opened.near[opened.corners].all()
    assert len(np.unique(opened.kept)) == len(opened.kept)
    for inside, ring in ((opened.near, opened.first), (opened.far, opened.second)):
        outside = ~inside
        outside[ring] = False
        assert not inside[ring].any()
        assert not (inside[mesh.faces].any(axis=1) & outside[mesh.faces].any(axis=1)).any()
    assert not (opened.near & opened.far).any()
    assert not (opened.far[opened.first] | opened.near[opened.second]).any()


@pytest.mark.parametrize("mesh", [tetrahedron(), icosphere(0), icosphere(1)], ids=["4", "12", "42"])
def test_small_closed_surfaces_are_mapped_exactly_too(mesh):
    result = pgcp.parameterize(mesh, patches=2, seams="exact")
    assert result.quality.folds == 0
    assert moebius_distance(result.coordinates, mesh.vertices / np.linalg.norm(mesh.vertices, axis=1)[:, None]) < 0.25


@pytest.mark.parametrize(("seams", "target"), [("exact", "disk"), ("relax", "free"), ("exact", "sphere")])
def test_workers_give_the_bits_of_the_serial_run(seams, target, hills):
    mesh = uneven(3) if target == "sphere" else hills
    serial, parallel = (pgcp.parameterize(mesh, patches=5, seams=seams, target=target, workers=workers) for workers in (0, 2))
    assert serial.coordinates.tobytes() == parallel.coordinates.tobytes()
    assert serial.mu.tobytes() == parallel.mu.tobytes()


def with_a_flat_face(mesh):
    """The mesh with a vertex put on an edge of one of the two faces there, which leaves a face without area."""
    a, b, _ = mesh.faces[155]
    around = np.flatnonzero((mesh.faces == a).any(axis=1) & (mesh.faces == b).any(axis=1))
    other = int(around[around != 155][0])
    c = int(np.setdiff1d(mesh.faces[other], [a, b])[0])
    m = len(mesh.vertices)
    faces = np.vstack([np.delete(mesh.faces, other, axis=0), [[m, a, c], [b, m, c], [a, m, b]]])
    return Mesh(np.vstack([mesh.vertices, mesh.vertices[[a, b]].mean(axis=0)]), faces, "flat face")


@pytest.mark.parametrize("mesh", [lifted(grid(12)), uneven()], ids=["open", "closed"])
def test_a_face_without_area_is_no_obstacle(mesh):
    flat = with_a_flat_face(mesh)
    results = [compute(flat, Options(patches=k, seams="exact")) for k in (2, 5)]
    assert np.isfinite(results[0].mu).all()
    assert results[0].report["mollification"] > 0
    assert np.abs(results[0].coordinates - results[1].coordinates).max() < 1e-9
    limit = 1.2 * pgcp.parameterize(mesh, patches=2, seams="exact").quality.angle_mean_deg
    assert results[0].quality.angle_mean_deg < limit


def ramp():
    """A spiral ramp of one and a half turns: flat, it lies over itself."""
    turn, across = np.meshgrid(np.linspace(0, 3 * np.pi, 91), np.linspace(1, 2, 9), indexing="ij")
    points = np.column_stack([(across * np.cos(turn)).ravel(), (across * np.sin(turn)).ravel(), 0.3 * turn.ravel()])
    return Mesh(points, grid(90, 8).faces, "ramp")


def test_a_boundary_that_crosses_itself_is_exact_in_the_plane_and_welded_on_the_disk():
    mesh = ramp()
    result = pgcp.parameterize(mesh, patches=3, seams="exact")
    assert crosses_itself(result.coordinates[kept_of(mesh)] @ [1, 1j])
    assert result.quality.folds == 0
    assert result.report["seams"] == "exact"
    overlap = result.report["overlap"]
    assert overlap["crossings"] > 0
    assert {v for pair in overlap["edges"] for edge in pair for v in edge} <= set(kept_of(mesh).tolist())
    apart = pgcp.parameterize(mesh, patches=3, seams="exact", no_overlap=True)
    assert (apart.target, apart.quality.folds, apart.report["seams"]) == ("disk", 0, "weld")
    assert apart.report["fallback"] == {
        "from": "free", "to": "disk", "reason": f"the boundary crosses itself {overlap['crossings']} times"
    }  # fmt: skip
    assert np.linalg.norm(apart.coordinates, axis=1).max() == pytest.approx(1.0)
    disk = pgcp.parameterize(mesh, patches=3, seams="exact", target="disk")
    assert (disk.quality.folds, disk.report["seams"]) == (0, "weld")
    assert "crosses itself and cannot be brought to the disk" in disk.report["retries"][0]["reason"]
    assert pgcp.parameterize(mesh, patches=3).report["overlap"]["crossings"] == 0


@pytest.mark.parametrize("count", [1, 5, 9])
def test_loads_are_reduced_and_solved_as_by_one_factor(count, tmp_path):
    mesh = OPEN["hills"]
    kept = kept_of(mesh)
    whole = eliminate_interior(cotangent_laplacian(mesh.vertices, mesh.faces), kept)
    factor, _, _ = patchwise(mesh, count, tmp_path, kept)
    rng = np.random.default_rng(1)
    load = rng.normal(size=len(mesh.vertices)) + 1j * rng.normal(size=len(mesh.vertices))
    values = rng.normal(size=len(kept)) + 0j
    assert np.abs(factor.reduce(load) - whole.reduce(load)).max() < 1e-12
    assert np.abs(factor.solve(load, values) - whole.solve(load, values)).max() < 1e-12
    factor.release()
    assert list(tmp_path.glob("*.npy")) == []


@pytest.mark.parametrize("method", ["dncp", "scp", "cdcp", "cem", "ccem"])
def test_methods_of_the_undivided_mesh_do_not_depend_on_the_cuts(method):
    mesh = OPEN["hills"]
    results = [pgcp.parameterize(mesh, patches=count, method=method) for count in (1, 3, 7)]
    for result in results:
        assert np.abs(result.coordinates - results[0].coordinates).max() < 1e-9 * np.ptp(results[0].coordinates)
        assert result.target == ("free" if method in ("dncp", "scp") else "disk")
    report = results[-1].report
    assert report["options"]["method"] == method
    assert len(report["interface"]["levels"]) > 1
    iterations = report["iterations"]
    assert (len(iterations) > 0) == (method in ("cem", "ccem"))
    energy = report["quality"]["conformal_energy"]
    assert (energy is None) == (results[0].target == "free")
    if method == "ccem":
        assert energy == pytest.approx(min(step["energy"] for step in iterations), rel=1e-6)
        assert energy <= pgcp.parameterize(mesh, patches=3, method="cem").quality.conformal_energy


def test_cdcp_is_corrected_unless_that_is_left_out():
    mesh = OPEN["hills"]
    corrected, plain = (pgcp.parameterize(mesh, method="cdcp", moebius=m).quality for m in ("auto", "none"))
    assert corrected.angle_mean_deg <= plain.angle_mean_deg
    assert corrected.angle_mean_deg < 1.05 * pgcp.parameterize(mesh, target="disk", polish="none").quality.angle_mean_deg


def test_what_cannot_be_done_is_refused(hills):
    with pytest.raises(pgcp.InputError, match="seams cannot be relaxed on a sphere"):
        pgcp.parameterize(icosphere(2), patches=2, seams="relax")
    with pytest.raises(pgcp.InputError, match="unknown treatment of seams 'sewn'"):
        pgcp.parameterize(hills, seams="sewn")


@pytest.mark.slow
@pytest.mark.parametrize("target", ["free", "disk"])
@pytest.mark.parametrize("name", ["human_brain", "stanford_bunny", "mount_st_helens_dem"])
def test_real_surfaces_have_one_exact_map(name, target, mesh_folder):
    mesh = pgcp.read_mesh(mesh_folder / "open" / f"{name}.ply")
    loop = kept_of(mesh)
    results = [pgcp.parameterize(mesh, patches=k, target=target, seams="exact", moebius="none") for k in (1, 2, 6, 12, 32)]
    first = results[0].coordinates
    z = first @ [1, 1j]
    assert np.abs(z - harmonic(mesh, loop, z[loop])).max() < 1e-9 * np.ptp(first)
    # every holomorphic map has next to no conformal energy: of a free boundary, rounding moves the least one by that much more
    bound = 1e-8 if target == "free" else 1e-9
    for result in results:
        assert result.quality.folds == 0
        assert np.abs(result.coordinates - first).max() < bound * np.ptp(first)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["brain", "chinese_lion"])
def test_real_closed_surfaces_have_one_exact_map(name, mesh_folder):
    mesh = pgcp.read_mesh(mesh_folder / "closed" / f"{name}.ply")
    results = [pgcp.parameterize(mesh, patches=k, seams="exact", moebius="none") for k in (2, 6, 12, 32)]
    for result in results:
        assert result.quality.folds == 0
        assert result.quality.degree == pytest.approx(1.0)
        assert np.abs(result.coordinates - results[0].coordinates).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", ["human_brain", "stanford_bunny", "mount_st_helens_dem"])
def test_real_surfaces_are_relaxed_to_the_harmonic_map_of_the_whole(name, mesh_folder):
    mesh = pgcp.read_mesh(mesh_folder / "open" / f"{name}.ply")
    loop = kept_of(mesh)
    for target in ("free", "disk"):
        result = pgcp.parameterize(mesh, patches=6, target=target, seams="relax", moebius="none", polish="none")
        z = result.coordinates @ [1, 1j]
        assert result.quality.folds == 0
        assert np.abs(z - harmonic(mesh, loop, z[loop])).max() < 1e-9 * np.ptp(result.coordinates)


def test_one_patch_of_a_closed_surface_is_the_undivided_map():
    mesh, _ = spheroid(3, 2.0)
    result = pgcp.parameterize(mesh, patches=1, polish="none")
    assert (result.report["seams"], result.quality.folds) == ("exact", 0)
    exact = pgcp.parameterize(mesh, patches=5, seams="exact")
    assert np.abs(result.coordinates - exact.coordinates).max() < 1e-9


def padded(mesh, count):
    """The mesh with vertices used by no face before and after its own."""
    stray = np.full((count, 3), 7.0)
    return Mesh(np.vstack([stray, mesh.vertices, stray]), mesh.faces + count)


@pytest.mark.parametrize("method", ["dncp", "cdcp", "cem", "ccem"])
def test_vertices_used_by_no_face_change_nothing(method):
    mesh = OPEN["hills"]
    plain, more = (pgcp.parameterize(m, patches=3, method=method) for m in (mesh, padded(mesh, 400)))
    assert np.abs(more.coordinates[400:-400] - plain.coordinates).max() < 1e-9
    assert not more.coordinates[:400].any()


def test_a_vertex_used_by_no_face_does_not_turn_the_exact_sphere():
    mesh, _ = spheroid(3, 2.0)
    plain, more = (pgcp.parameterize(m, patches=3, seams="exact") for m in (mesh, padded(mesh, 1)))
    assert more.report["seams"] == "exact"
    assert more.quality.angle_mean_deg == pytest.approx(plain.quality.angle_mean_deg, rel=1e-6)


@pytest.mark.parametrize("fails", [False, True])
def test_nothing_is_held_after_a_run(fails, monkeypatch):
    def fail(*_):
        raise pgcp.errors.WeldFailedError("made to fail")

    if fails:
        monkeypatch.setattr(welds, "weld", fail)
        monkeypatch.setattr("pgcp.retry.course.may_be_solved_in_logarithms", lambda *_: False)
        monkeypatch.setattr(whole_mesh, "whole_boundary", fail)
        monkeypatch.setattr(whole_mesh, "gathered", fail)
    before = FACTORS.nbytes
    for options in ({}, {"method": "cdcp"}, {"seams": "exact"}):
        pgcp.parameterize(OPEN["hills"], patches=3, **options)
        assert FACTORS.nbytes == before
    if fails:
        with pytest.raises(pgcp.errors.WeldFailedError):
            pgcp.parameterize(OPEN["hills"], patches=3, repairs=())
        assert FACTORS.nbytes == before


def test_exact_seams_that_give_way_to_welds_say_so(monkeypatch):
    def fail(*_):
        raise pgcp.errors.SolveFailedError("made to fail")

    monkeypatch.setattr(whole_mesh, "eliminated", fail)
    result = pgcp.parameterize(OPEN["hills"], patches=3, method="dncp")
    assert result.report["seams"] == "weld"
    assert result.report["fallback"] == {"from": "exact seams", "to": "welded ones", "reason": "made to fail"}


def test_a_load_is_sent_in_short():
    load = np.full(50_000, -0.3 + 0j)
    load[[5, 7]] = 1.0, 2.0j
    packed = pack_load(load)
    assert len(packed.ids) == 2
    assert np.array_equal(packed.unpacked(), load)
    odd = np.random.default_rng(0).normal(size=9) + 0j
    assert np.array_equal(pack_load(odd).unpacked(), odd)


@pytest.mark.parametrize("mesh", [spheroid(3, 1.5)[0], lifted(grid(20))], ids=["sphere", "open"])
def test_factors_that_an_exact_map_leaves_behind_are_not_for_the_welded_one(mesh, monkeypatch):
    def fail(*_):
        raise pgcp.errors.SolveFailedError("made to fail")

    results = []
    for where in ("gathered", "eliminated"):  # after the patches have been extended, and before anything is
        with monkeypatch.context() as patched:
            patched.setattr(whole_mesh, where, fail)
            results.append(pgcp.parameterize(mesh, patches=4, seams="exact"))
    after, without = results
    assert after.report["seams"] == without.report["seams"] == "weld"
    assert after.coordinates.tobytes() == without.coordinates.tobytes()
