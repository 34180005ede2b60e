"""A cell as a sum of spherical harmonics.

    python cell.py [MESH]

The outline of a cell is a closed surface. On its map to the sphere, x, y and z are functions with spherical harmonics; the
first few hundred coefficients are the shape. Without MESH, a blob with bumps takes the cell's place.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import trimesh

import pgcp
from pgcp.cli.apps import main

with tempfile.TemporaryDirectory() as folder:
    mesh = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(folder, "cell.ply")
    if len(sys.argv) == 1:
        ball = trimesh.creation.icosphere(subdivisions=5)
        aims = np.random.default_rng(3).standard_normal((14, 3))
        towards = ball.vertices @ (aims / np.linalg.norm(aims, axis=1)[:, None]).T
        radius = 1.0 + 0.3 * np.exp(12.0 * (towards - 1.0)).sum(axis=1)
        pgcp.write_mesh(mesh, pgcp.Mesh(ball.vertices * radius[:, None] * [1.3, 1.0, 0.8], ball.faces))
    status = main(["harmonics", str(mesh), "--degree", "16", "-o", "cell.png"])
sys.exit(status)
