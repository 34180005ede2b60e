"""Real meshes. A chosen few run always; the whole matrix is marked slow (scripts/test --all)."""

from __future__ import annotations

import numpy as np
import pytest

import pgcp

LISTED = [
    "camel_head", "human_face", "hand", "human_brain", "stanford_bunny", "man_bust", "cow_head", "chinese_lion_head",
    "lion_vase_disk", "david_head_disk", "max_planck_disk", "bunny_simplified", "igea_disk", "mount_st_helens_dem",
]  # fmt: skip
LIMIT = {2: 1.05, 4: 1.05, 6: 1.05, 8: 1.10, 12: 1.10}


def compare(folder, name, patches):
    mesh = pgcp.read_mesh(folder / "open" / f"{name}.ply")
    whole = pgcp.parameterize(mesh, patches=1).quality
    for count in patches:
        quality = pgcp.parameterize(mesh, patches=count).quality
        assert quality.folds == 0
        assert quality.angle_mean_deg <= LIMIT[count] * whole.angle_mean_deg, (count, quality.angle_mean_deg)


@pytest.mark.parametrize("name", ["camel_head", "cow_head", "max_planck_disk"])
def test_patches_are_as_good_as_one_piece(name, mesh_folder):
    compare(mesh_folder, name, (2, 6, 12))


@pytest.mark.slow
@pytest.mark.parametrize("name", LISTED)
def test_all_listed_meshes(name, mesh_folder):
    compare(mesh_folder, name, (2, 4, 6, 8, 12))


@pytest.mark.parametrize("patches", [1, 6, 12])
def test_a_planar_silhouette_comes_back(patches, mesh_folder):
    mesh = pgcp.read_mesh(mesh_folder / "open" / "alligator.ply")
    quality = pgcp.parameterize(mesh, patches=patches).quality
    assert quality.angle_max_deg < 1e-4


@pytest.mark.parametrize(("name", "patches"), [("ogre", 6), ("human_figure", 6)])
def test_bodies_behind_a_small_boundary(name, patches, mesh_folder):
    """Patches whose own free boundary crosses itself are flattened in halves."""
    mesh = pgcp.read_mesh(mesh_folder / "open" / f"{name}.ply")
    result = pgcp.parameterize(mesh, patches=patches)
    assert max(p["pieces"] for p in result.report["patches"]) > 1
    assert result.quality.angle_mean_deg < 1.02 * pgcp.parameterize(mesh, patches=1).quality.angle_mean_deg


def test_serial_and_workers_agree_to_the_bit_on_a_scan(mesh_folder):
    path = mesh_folder / "open" / "human_brain.ply"
    serial = pgcp.parameterize(path, patches=6)
    workers = pgcp.parameterize(path, patches=6, workers=2)
    assert serial.coordinates.tobytes() == workers.coordinates.tobytes()


REJECTED = {
    "nonmanifold_edge_fin.ply": "1 edges have more than two faces",
    "bowtie_two_triangles.ply": "non-manifold",
    "inconsistent_orientation.ply": "disagree in orientation",
    "duplicate_faces.ply": "listed twice",
    "nan_vertex.ply": "not a finite number",
    "nan_text.obj": "not a finite number",
    "two_components.ply": "2 separate components",
    "torus_genus1.ply": "genus 1",
    "rocker_arm_genus1_real.ply": "genus 1",
    "annulus_pinhole.ply": "2 boundary loops",
    "moebius.ply": "not orientable",
    "empty_file.ply": "empty",
    "empty_mesh.ply": "no faces",
    "truncated_binary_faces.ply": "not a readable PLY",
    "truncated_header.ply": "not a readable PLY",
    "face_count_too_large.ply": "not a readable PLY",
    "face_count_short_ascii.ply": "not a readable PLY",
    "index_out_of_range.ply": "uses vertex 7",
    "index_out_of_range.obj": "uses vertex 8",
    "quads.obj": "not triangles",
    "point_cloud.ply": "no face element",
    "collinear.ply": "zero area",
    "text_garbage.ply": "not a readable PLY",
    "lfs_pointer.ply": "not a readable PLY",
}
ACCEPTED = [
    "all_reversed.ply", "unwelded.stl", "zero_area_triangle.ply", "unreferenced_vertices.ply", "trailing_garbage.ply",
    "relative_indices.obj", "single_triangle.ply", "fan_one_interior.ply", "big_endian.ply",
    "obj_with_uv_normals_and_comments.obj", "tetrahedron.ply", "cow_nonmanifold_real.off",
]  # fmt: skip


@pytest.mark.parametrize("name", REJECTED)
def test_defective_files_are_refused_by_name(name, mesh_folder):
    with pytest.raises(pgcp.InputError, match=REJECTED[name]) as caught:
        pgcp.parameterize(mesh_folder / "bad" / name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ACCEPTED)
def test_odd_but_legal_files_are_mapped(name, mesh_folder):
    result = pgcp.parameterize(mesh_folder / "bad" / name)
    assert np.isfinite(result.coordinates).all()
    assert result.quality.folds == 0
