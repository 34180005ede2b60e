"""BFF: flat surfaces come back exactly, prescribed boundaries are what was prescribed, and cuts do not matter."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import cap, grid, icosphere, lifted, similarity_error, spheroid, tetrahedron
from oracles import moebius_distance

import pgcp
from pgcp.cli.main import main
from pgcp.elimination.dirichlet import eliminate_mesh
from pgcp.methods.bff import star_of
from pgcp.methods.common.boundary_first import BoundaryFlattening, closed_lengths, integrated_curvature
from pgcp.surface.distortion import angle_errors
from pgcp.surface.topology import examine
from pgcp.types import Mesh


def flat(result):
    return result.coordinates @ [1, 1j]


def mapped(mesh, **named):
    return pgcp.parameterize(mesh, method="bff", **{"moebius": "none", **named})


def rim(mesh):
    return examine(mesh.faces, len(mesh.vertices)).loops[0]


def boundary_of(mesh, z=None):
    """The boundary as BFF sees it; z (V,): positions that its flat metric is given by."""
    vertices = mesh.vertices if z is None else np.column_stack([z.real, z.imag, 0 * z.real])
    loop, used = rim(mesh), np.ones(len(vertices), bool)
    factor = eliminate_mesh(vertices, mesh.faces, loop)
    kappa = factor.reduce(integrated_curvature(vertices, mesh.faces, loop, used).astype(complex)).real
    return BoundaryFlattening(factor.schur, kappa, np.linalg.norm(vertices[np.roll(loop, -1)] - vertices[loop], axis=1))


def turning_of(polygon):
    steps = np.roll(polygon, -1) - polygon
    return np.angle(steps / np.roll(steps, 1))


def rolled(mesh, radius):
    """A planar mesh rolled around a cylinder whose axis is y: developable where its faces lie between lines x = const."""
    x, y = mesh.vertices[:, 0], mesh.vertices[:, 1]
    return Mesh(np.column_stack([radius * np.sin(x / radius), y, radius * np.cos(x / radius)]), mesh.faces, "rolled")


@pytest.mark.parametrize("patches", [1, 4])
def test_a_flat_surface_comes_back(patches):
    mesh = grid(16, 10, jitter=0.3)
    result = mapped(mesh, patches=patches)
    assert similarity_error(flat(result), mesh.vertices[:, :2] @ [1, 1j]) < 1e-9
    surface = rolled(grid(16, 10), 0.4)
    assert angle_errors(surface, mapped(surface, patches=patches).coordinates).max() < 1e-6


@pytest.mark.parametrize("target", ["free", "disk", "sphere"])
def test_cuts_do_not_matter(target):
    mesh = spheroid(3, 1.4)[0] if target == "sphere" else lifted(grid(20))
    fewest = 2 if target == "sphere" else 1
    one, four = (mapped(mesh, target=target, patches=patches).coordinates for patches in (fewest, 4))
    assert np.abs(one - four).max() < 1e-9 * np.abs(one).max()


def test_a_free_boundary_keeps_its_lengths():
    mesh = lifted(grid(20))
    z, loop = flat(mapped(mesh)), rim(mesh)
    there = np.abs(np.roll(z[loop], -1) - z[loop])
    here = np.linalg.norm(np.roll(mesh.vertices[loop], -1, axis=0) - mesh.vertices[loop], axis=1)
    ratio = there / here
    assert np.ptp(ratio) < 1e-3 * ratio.mean()


def test_scale_factors_give_the_turning_angles_of_a_conformal_image():
    mesh = grid(40)
    z = mesh.vertices[:, :2] @ [1, 1j]
    image = z + z**2 / 4
    loop = rim(mesh)
    boundary = boundary_of(mesh)
    factors = np.log(np.abs(1 + z[loop] / 2))
    wanted, got = turning_of(image[loop]), boundary.turning(factors)
    assert np.abs(wanted - boundary.kappa).max() > 0.01
    assert np.abs(got - wanted).max() < 1e-3
    assert got.sum() == pytest.approx(2 * np.pi)
    # and back
    assert np.abs(boundary.factors(got) - (factors - factors.mean())).max() < 1e-9


def test_a_round_cap_goes_to_the_disk_as_it_is_known():
    errors = [similarity_error(flat(mapped(mesh, target="disk")), exact) for mesh, exact in (cap(6), cap(12))]
    assert errors[1] < 0.3 * errors[0] < 0.01


def test_the_sphere_comes_back_up_to_a_moebius_map():
    mesh = icosphere(3)
    assert moebius_distance(mapped(mesh).coordinates, mesh.vertices) < 0.01
    surface, exact = spheroid(4, 1.5)
    assert moebius_distance(mapped(surface).coordinates, exact) < 0.02


def test_the_smallest_surfaces_are_mapped():
    assert mapped(tetrahedron()).quality.folds == 0
    one = Mesh(np.array([[0.0, 0, 0], [2, 0, 0], [0.5, 1, 0]]), np.array([[0, 1, 2]]))
    assert similarity_error(flat(mapped(one)), one.vertices[:, :2] @ [1, 1j]) < 1e-12


def test_a_star_has_its_ring_along_the_rest():
    mesh = tetrahedron()
    star = star_of(mesh.faces, 3)
    assert star.faces.tolist() == [False, True, True, True]
    assert star.ring.tolist() == [0, 1, 2]
    assert star.kept.tolist() == [0, 1, 2, 3]


def test_edges_that_least_squares_would_turn_round_stay_above_zero():
    along = np.exp(2j * np.pi * np.arange(8) / 8)
    lengths = np.array([1, 1, 5, 1, 1, 1e-3, 1e-3, 1e-3])
    found = closed_lengths(lengths, along, np.ones(8))
    assert (found > 0).all()
    assert abs((found * along).sum()) < 1e-12 * found.sum()
    with pytest.raises(pgcp.errors.SolveFailedError, match="cannot be closed"):
        closed_lengths(np.ones(4), np.exp(0.1j * np.arange(4)), np.ones(4))


# What is prescribed -----------------------------------------------------------------------------------------------------------


def write(path, rows):
    path.write_text("# prescribed\n" + "\n".join(" ".join(map(str, row)) for row in rows) + "\n")
    return path


CORNERS = [0, 12, 168, 156]  # of grid(12), in some order


def test_four_right_angles_make_a_rectangle(tmp_path):
    mesh = lifted(grid(12))
    path = write(tmp_path / "angles.txt", [(corner, 90) for corner in CORNERS])
    one, four = (mapped(mesh, boundary=f"angles:{path}", patches=patches) for patches in (1, 4))
    assert np.abs(one.coordinates - four.coordinates).max() < 1e-9
    turns = np.degrees(turning_of(flat(one)[rim(mesh)]))
    corner = np.isin(rim(mesh), CORNERS)
    assert np.abs(turns[corner] - 90).max() < 1e-6
    assert np.abs(turns[~corner]).max() < 1e-6
    assert one.quality.folds == 0


def test_lengths_of_a_conformal_image_give_the_image(tmp_path):
    mesh = grid(30)
    z = mesh.vertices[:, :2] @ [1, 1j]
    image, loop = 7 * (z + z**2 / 4), rim(mesh)
    rows = zip(np.roll(loop, -1), loop, np.abs(np.roll(image[loop], -1) - image[loop]), strict=True)
    path = write(tmp_path / "lengths.txt", rows)
    found = flat(mapped(mesh, boundary=f"lengths:{path}"))
    assert similarity_error(found, image) < 1e-3 < 0.1 < similarity_error(z, image)


def test_the_command_records_which_boundary_it_was(tmp_path):
    mesh = lifted(grid(12))
    pgcp.write_mesh(tmp_path / "hills.ply", mesh)
    out = tmp_path / "hills_pgcp" / "report.json"
    assert main([str(tmp_path / "hills.ply"), "--method", "bff", "--boundary", "disk", "--no-png", "--quiet"]) == 0
    assert '"boundary": "disk"' in out.read_text()
    assert '"target": "disk"' in out.read_text()


@pytest.mark.parametrize(
    ("named", "sentence"),
    [
        ({"boundary": "square"}, "unknown boundary 'square'; choose from auto, isometric, disk, angles:FILE, lengths:FILE"),
        ({"boundary": "angles"}, "unknown boundary 'angles'"),
        ({"boundary": "angles:nowhere.txt"}, "nowhere.txt: No such file"),
        ({"boundary": "disk", "target": "free"}, "the boundary disk is one for the target disk, not free"),
        ({"boundary": "isometric", "target": "disk"}, "the boundary isometric is one for the target free, not disk"),
        ({"boundary": "disk", "method": "cem"}, "the method cem has no option boundary; it goes with the method bff"),
    ],
)
def test_a_wrong_boundary_is_refused(named, sentence):
    with pytest.raises(pgcp.InputError, match=sentence):
        pgcp.parameterize(grid(3), **{"method": "bff", **named})


@pytest.mark.parametrize(
    ("kind", "text", "sentence"),
    [
        ("angles", "", "the file is empty; each line must be a vertex id and an angle in degrees"),
        ("angles", "0 x", "line 1 is not a vertex id and an angle in degrees: '0 x'"),
        ("angles", "0 90 3", "line 1 is not"),
        ("angles", "0 nan", "line 1 is not"),
        ("angles", "5 90", "line 1: vertex 5 is not on the boundary"),
        ("angles", "0 90\n0 90", "line 2: vertex 0 is named twice"),
        ("angles", "0 180", "line 1: the boundary cannot turn by 180.0 degrees"),
        ("angles", "0 90\n3 90", "the angles add up to 180 degrees, a boundary turns by 360 in all"),
        ("lengths", "0 5 1", "line 1: 0 5 is no edge of the boundary"),
        ("lengths", "0 1 -2", "line 1: an edge cannot be -2.0 long"),
        ("lengths", "0 1 2\n1 0 2", "line 2: the edge 1 0 is named twice"),
        ("lengths", "0 1 2", "11 of 12 boundary edges have no length"),
        ("lengths", "0 1", "line 1 is not two vertex ids and a length"),
    ],
)
def test_a_wrong_file_is_refused(tmp_path, kind, text, sentence):
    (tmp_path / "file.txt").write_text(text)
    with pytest.raises(pgcp.BadFileError, match=sentence):
        mapped(grid(3), boundary=f"{kind}:{tmp_path / 'file.txt'}")


def test_a_file_that_is_no_text_and_ids_that_may_change_are_refused(tmp_path):
    (tmp_path / "file.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(pgcp.BadFileError, match="the file is no text"):
        mapped(grid(3), boundary=f"angles:{tmp_path / 'file.txt'}")
    write(tmp_path / "file.txt", [(0, 90)])
    with pytest.raises(pgcp.InputError, match="the file names vertices that --fix may renumber"):
        mapped(grid(3), boundary=f"angles:{tmp_path / 'file.txt'}", fix=True)


# Real meshes ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "mean"), [("camel_head", 1.399), ("max_planck_disk", 1.411)])
def test_angle_errors_are_those_of_geometry_central(mesh_folder, name, mean):
    result = mapped(mesh_folder / "open" / f"{name}.ply", target="free")
    assert result.quality.angle_mean_deg == pytest.approx(mean, rel=0.01)
    assert result.quality.folds == 0


def test_angle_errors_on_the_sphere_are_below_those_of_the_authors(mesh_folder):
    result = pgcp.parameterize(mesh_folder / "closed" / "david_head.ply", method="bff")
    assert result.quality.angle_mean_deg < 0.912
    assert result.quality.folds == 0
