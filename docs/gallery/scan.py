"""A scan of 10 million vertices on two workers.

    python scan.py [RINGS]

The mesh is the bust of `pgcp-run --demo`, with as many rings of points as are asked for: 1826 make 10 million vertices.
Patches are flattened, welded and solved by worker processes. The patches lie in files, so that memory stays bounded.
"""

import sys
import time

import pgcp
from pgcp.surface.demo import demo_mesh

if __name__ == "__main__":  # worker processes import this file
    mesh = demo_mesh(int(sys.argv[1]) if len(sys.argv) > 1 else 1826)
    began = time.perf_counter()
    result = pgcp.parameterize(mesh, target="disk", workers=2)
    seconds = time.perf_counter() - began
    print(result)
    million = len(mesh.vertices) / 1e6
    print(f"{million:.2f} million vertices in {seconds:.1f} s: {seconds / million:.1f} s a million")
    for stage in result.report["stages"]:
        if stage["seconds"] > 0.02 * seconds:
            print(f"  {stage['name']:9} {stage['seconds']:6.1f} s")
    result.picture().save("scan.png")
