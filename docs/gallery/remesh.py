"""Better triangles: a scan meshed anew through its map.

    python remesh.py [MESH]

Points are spread in the plane, where triangulations are easy, as densely as the map asks for. Carried back, they make triangles
of one size on the surface, and hardly one is thin (PGCP section 5.7.2). Without MESH, it is the built-in bust.
"""

import sys
import tempfile
from pathlib import Path

import pgcp
from pgcp.cli.apps import main
from pgcp.surface.demo import demo_mesh

with tempfile.TemporaryDirectory() as folder:
    mesh = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(folder, "bust.ply")
    if len(sys.argv) == 1:
        pgcp.write_mesh(mesh, demo_mesh(60))
    count = len(pgcp.read_mesh(mesh).vertices) // 2
    status = main(["remesh", str(mesh), "--vertices", str(count), "-o", "remesh.png"])
sys.exit(status)
