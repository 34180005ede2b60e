#!/usr/bin/env python3
"""Map the files that people have: exports of modelling, brain-imaging, CAD and scanning programs, made here by other packages.

usage: exports.py [FOLDER]   (needs the development environment)
Every file is mapped with one command; a Markdown table says what it is and how the command ended. The exit status is 1 where
one failed.
"""

from __future__ import annotations

import gzip
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np


def _ball(levels: int = 3) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    ball = trimesh.creation.icosphere(levels)
    points = np.asarray(ball.vertices) * [1.0, 0.8, 0.6]
    return points * (1 + 0.1 * np.sin(4 * points[:, :1])), np.asarray(ball.faces)


def _grid(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A hilly sheet of n x n quads."""
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    points = np.column_stack([i.ravel() / n, j.ravel() / n, 0.2 * np.sin(3 * i.ravel() / n) * np.cos(4 * j.ravel() / n)])
    a = (i * (n + 1) + j)[:-1, :-1].ravel()
    return points, np.column_stack([a, a + n + 1, a + n + 2, a + 1])


def _uv_sphere(rings: int, around: int) -> tuple[np.ndarray, list[list[int]]]:
    """A ball of quads with triangles at its poles, its vertices repeated along the date line and at the poles."""
    u, v = np.meshgrid(np.linspace(0, 1, around + 1), np.linspace(0, 1, rings + 1), indexing="ij")
    angle, height = 2 * np.pi * u.ravel(), np.pi * v.ravel()
    ring = np.where((v == 0) | (v == 1), 0.0, np.sin(np.pi * v)).ravel()
    points = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), np.cos(height)])
    points[-(rings + 1) :] = points[: rings + 1]
    faces = []
    for i in range(around):
        for j in range(rings):
            a, b = i * (rings + 1) + j, (i + 1) * (rings + 1) + j
            faces.append([a, a + 1, b + 1, b] if 0 < j < rings - 1 else [a, a + 1, b + 1] if j == 0 else [a, a + 1, b])
    return points, faces


def _obj(points: np.ndarray, faces: list[list[int]], head: str = "", colours: np.ndarray | None = None) -> bytes:
    rows = points if colours is None else np.column_stack([points, colours])
    text = head + "".join("v " + " ".join(f"{x:.6f}" for x in row) + "\n" for row in rows)
    text += "".join(f"vt {x:.6f} {y:.6f}\n" for x, y in points[:, :2])
    return (text + "".join("f " + " ".join(f"{k + 1}/{k + 1}" for k in face) + "\n" for face in faces)).encode()


def _blender_obj(path: Path) -> None:
    points, faces = _uv_sphere(12, 24)
    path.with_suffix(".mtl").write_bytes(b"newmtl Material\nKd 0.8 0.8 0.8\n")
    head = f"# Blender 4.2 OBJ File\nmtllib {path.stem}.mtl\no Sphere\nusemtl Material\ns 1\n"
    path.write_bytes(_obj(points, faces, head))


def _flat_shaded(path: Path) -> None:
    import trimesh

    points, faces = _ball(2)
    soup = points[faces].reshape(-1, 3)
    mesh = trimesh.Trimesh(soup, np.arange(len(soup)).reshape(-1, 3), process=False)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=np.tile([200, 120, 40, 255], (len(soup), 1)))
    _ = mesh.vertex_normals
    if path.suffix == ".gltf":
        for name, data in trimesh.exchange.gltf.export_gltf(trimesh.Scene(mesh), include_normals=True).items():
            (path if name.endswith(".gltf") else path.with_name(name)).write_bytes(data)
    else:
        path.write_bytes(trimesh.exchange.gltf.export_glb(trimesh.Scene(mesh), include_normals=True))


def _by_trimesh(path: Path) -> None:
    import trimesh

    trimesh.Trimesh(*_ball(), process=False).export(path)


def _coloured_ply(path: Path) -> None:
    import trimesh

    points, faces = _ball()
    colours = (255 * (points - points.min(axis=0)) / np.ptp(points, axis=0)).astype(np.uint8)
    trimesh.Trimesh(points, faces, vertex_colors=colours, process=False).export(path)


def _by_nibabel(path: Path) -> None:
    import nibabel

    points, faces = _ball(4)
    if path.suffix == ".gii":
        arrays = (points.astype("f4") * 50, "NIFTI_INTENT_POINTSET"), (faces.astype("i4"), "NIFTI_INTENT_TRIANGLE")
        nibabel.save(nibabel.gifti.GiftiImage(darrays=[nibabel.gifti.GiftiDataArray(*array) for array in arrays]), path)
    else:
        nibabel.freesurfer.write_geometry(path, points * 50, faces)


def _by_pyvista(path: Path) -> None:
    import pyvista

    pyvista.PolyData.from_regular_faces(*_ball()).save(path)


def _by_meshio(path: Path) -> None:
    import meshio

    points, quads = _grid(12)
    meshio.Mesh(points, [("quad", quads)]).write(path)


def _cad_rod(path: Path) -> None:
    import trimesh

    trimesh.creation.cylinder(radius=1.0, height=8.0, sections=48).export(path, file_type="stl_ascii")


def _cad_prism(path: Path) -> None:
    n = 12
    angle = 2 * np.pi * np.arange(n) / n
    radius = np.where(np.arange(n) % 2, 1.0, 0.6)
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(n)])
    sides = [[k, (k + 1) % n, n + (k + 1) % n, n + k] for k in range(n)]
    path.write_bytes(
        _obj(np.vstack([ring, ring + np.array([0, 0, 2.0])]), [list(range(n))[::-1], list(range(n, 2 * n)), *sides])
    )


def _scan(path: Path) -> None:
    from plyfile import PlyData, PlyElement

    points, quads = _grid(30)
    rng = np.random.default_rng(1)
    points += rng.normal(0, 0.002, points.shape)
    debris = np.array([[5.0, 0, 0], [5.1, 0, 0], [5, 0.1, 0]])
    names = [(axis, "f4") for axis in ("x", "y", "z", "nx", "ny", "nz")] + [(c, "u1") for c in ("red", "green", "blue")]
    vertices = np.zeros(len(points) + 3, [*names, ("quality", "f4")])
    for k, axis in enumerate("xyz"):
        vertices[axis] = np.concatenate([points[:, k], debris[:, k]])
    vertices["nz"], vertices["red"], vertices["quality"] = 1.0, 120, rng.random(len(vertices))
    triangles = np.vstack([quads[:, :3], quads[:, [0, 2, 3]], [[len(points), len(points) + 1, len(points) + 2]]])
    faces = np.zeros(len(triangles), [("vertex_indices", "i4", (3,))])
    faces["vertex_indices"] = triangles
    PlyData([PlyElement.describe(vertices, "vertex"), PlyElement.describe(faces, "face")], byte_order="<").write(path)


def _coloured_obj(path: Path) -> None:
    points, quads = _grid(20)
    path.write_bytes(_obj(points, quads.tolist(), "# scanner\n", np.full((len(points), 3), 0.5)))


def _coff(path: Path) -> None:
    points, faces = _ball(2)
    lines = [f"COFF\n{len(points)} {len(faces)} 0\n"]
    lines += [f"{x} {y} {z} 200 100 50 255\n" for x, y, z in points.tolist()]
    path.write_text("".join([*lines, *(f"3 {a} {b} {c}\n" for a, b, c in faces.tolist())]))


def _packed_obj(path: Path) -> None:
    path.write_bytes(gzip.compress(_obj(_ball(2)[0], _ball(2)[1].tolist())))


def _arrays(path: Path) -> None:
    points, faces = _ball(2)
    np.savez(path, vertices=points, faces=faces)


EXPORTS: dict[str, tuple[str, Callable[[Path], None]]] = {
    "uv_sphere.obj": ("Blender, quads, vertices split along seams, material", _blender_obj),
    "flat.glb": ("Blender, flat shading, vertex colours", _flat_shaded),
    "flat.gltf": ("the same, buffers beside", _flat_shaded),
    "coloured.ply": ("Blender, binary, vertex colours", _coloured_ply),
    "part.stl": ("Blender, binary STL", _by_trimesh),
    "lh.pial": ("FreeSurfer", _by_nibabel),
    "rh.inflated": ("FreeSurfer", _by_nibabel),
    "midthickness.surf.gii": ("GIFTI of the Connectome Workbench", _by_nibabel),
    "slicer.vtk": ("3D Slicer, legacy VTK", _by_pyvista),
    "paraview.vtp": ("ParaView", _by_pyvista),
    "mesher.vtu": ("a mesher, quads", _by_meshio),
    "rod.stl": ("CAD, ASCII STL, needles", _cad_rod),
    "part.3mf": ("CAD, 3MF", _by_trimesh),
    "prism.obj": ("CAD, polygons of 12 corners that are not convex", _cad_prism),
    "scan.ply": ("scanner, normals, colours, quality, debris", _scan),
    "scan.obj": ("scanner, colours after the coordinates", _coloured_obj),
    "model.off": ("COFF", _coff),
    "packed.obj.gz": ("gzip", _packed_obj),
    "arrays.npz": ("NumPy", _arrays),
}


def main() -> int:
    """Make the files, map them, print the table."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp())
    folder.mkdir(parents=True, exist_ok=True)
    print(
        "| file | what it is | status | target | mean angle error | folds | said of the input |\n|---|---|---|---|---|---|---|"
    )
    failed = 0
    for name, (what, make) in EXPORTS.items():
        make(folder / name)
        command = [sys.executable, "-m", "pgcp", str(folder / name), "--json", "--no-png"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        failed += done.returncode != 0
        found = json.loads(done.stdout or "{}")
        if done.returncode:
            print(f"| {name} | {what} | {done.returncode} | {done.stderr.strip()} | | | |")
            continue
        said = "; ".join(note["message"] for note in found["input"])
        quality = found["quality"]
        print(f"| {name} | {what} | 0 | {found['target']} | {quality['angle_mean_deg']:.3f} | {quality['folds']} | {said} |")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
