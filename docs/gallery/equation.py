"""An equation on a surface, solved on the sphere.

    python equation.py [MESH]

Phases separate on a closed surface (Allen-Cahn). The map turns the surface's Laplacian into that of the sphere over the ratio
of areas, so spherical harmonics solve it (PGCP section 5.7.3). Finite elements on the surface itself agree.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import trimesh

import pgcp
from pgcp.cli.apps import main

with tempfile.TemporaryDirectory() as folder:
    mesh = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(folder, "blob.ply")
    if len(sys.argv) == 1:
        ball = trimesh.creation.icosphere(subdivisions=5)
        x, y, z = 3.0 * ball.vertices.T
        radius = 1.0 + 0.12 * np.sin(x + 1.0) * np.sin(y) * np.cos(z) + 0.1 * np.cos(x - y)
        pgcp.write_mesh(mesh, pgcp.Mesh(ball.vertices * radius[:, None], ball.faces))
    status = main(["solve", str(mesh), "--equation", "allen-cahn", "-o", "equation.png"])
sys.exit(status)
