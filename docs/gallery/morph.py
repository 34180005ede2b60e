"""One shape turned into another.

    python morph.py [A B]

Vertices of the first surface move to the places on the second that their maps to the sphere give them, after the surfaces are
brought into line. Without A and B, a blob with three horns turns into an egg.
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
    if not words:
        ball = trimesh.creation.icosphere(subdivisions=5)
        aims = np.array([[1.0, 0.0, 0.2], [-0.5, 0.8, 0.3], [-0.4, -0.7, 0.6]])
        horns = np.exp(16.0 * (ball.vertices @ (aims / np.linalg.norm(aims, axis=1)[:, None]).T - 1.0)).sum(axis=1)
        shapes = {"horned": 1.0 + 1.2 * horns, "egg": 1.0 + 0.3 * ball.vertices[:, 2]}
        for name, radius in shapes.items():
            pgcp.write_mesh(Path(folder, f"{name}.ply"), pgcp.Mesh(ball.vertices * radius[:, None], ball.faces))
        words = [str(Path(folder, f"{name}.ply")) for name in shapes]
    status = main(["morph", *words, "-o", "morph.png"])
sys.exit(status)
