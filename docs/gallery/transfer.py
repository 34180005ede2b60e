"""Values carried from one surface to another.

    python transfer.py [A B]

Both closed surfaces are mapped to the sphere, and the spheres are turned until the scales of the maps are most alike. Then each
vertex of one surface has a place on the other. Without A and B, they are two meshes of one lumpy surface, one of them turned.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import trimesh

import pgcp
from pgcp.cli.apps import main

with tempfile.TemporaryDirectory() as folder:
    words = sys.argv[1:3]
    for name, levels, turn in (("a", 4, 0.0), ("b", 5, 1.0)) if not words else ():
        ball = trimesh.creation.icosphere(subdivisions=levels)
        ball.apply_transform(trimesh.transformations.rotation_matrix(turn, [1, 2, 3]))
        aims = np.array([[0.9, 0.2, 0.3], [-0.3, 0.8, 0.5], [0.2, -0.3, -0.93]])
        radius = 1.0 + np.exp(7.0 * (ball.vertices @ aims.T - 1.0)) @ [0.5, -0.3, 0.7]
        pgcp.write_mesh(Path(folder, f"{name}.ply"), pgcp.Mesh(ball.vertices * radius[:, None] * [1.0, 1.2, 0.8], ball.faces))
    words = words or [str(Path(folder, "a.ply")), str(Path(folder, "b.ply"))]
    status = main(["transfer", *words, "-o", "transfer.png"])
sys.exit(status)
