"""A run that is killed half-way, and taken up where it was.

    python resume.py [MESH]

The run is killed (SIGKILL) as soon as the first patches are solved. Run again with `--resume`, it finds what was finished
in the store, and does the rest only. The map is that of an undisturbed run, to the last bit.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import pgcp
from pgcp.surface.demo import demo_mesh

mesh = pgcp.read_mesh(sys.argv[1]) if len(sys.argv) > 1 else demo_mesh(300)
with tempfile.TemporaryDirectory() as folder:
    store = Path(folder, "store")
    store.mkdir()
    pgcp.write_mesh(Path(folder, "mesh.ply"), mesh)
    command = [sys.executable, "-m", "pgcp", "mesh.ply", "--patches=12", "--write=npz", "--no-html", "--quiet"]
    subprocess.run([*command, "--output-dir=undisturbed"], cwd=folder, check=True)
    resumed = [*command, "--output-dir=out", "--store=store", "--resume"]
    process = subprocess.Popen(resumed, cwd=folder)
    while process.poll() is None and len(list(store.rglob("map-*.npz"))) < 4:
        time.sleep(0.01)
    process.kill()
    process.wait()
    print(f"killed when {len(list(store.rglob('map-*.npz')))} of 12 patches were solved")
    subprocess.run(resumed, cwd=folder, check=True)
    maps = [np.load(Path(folder, name, "mesh.npz"))["uv"] for name in ("undisturbed", "out")]
    print(f"the maps are {'equal to the last bit' if (maps[0] == maps[1]).all() else 'different'}")
    Path("resume.png").write_bytes(Path(folder, "out", "mesh.png").read_bytes())
