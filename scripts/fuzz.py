#!/usr/bin/env python3
"""Fuzz the mesh readers, guided by coverage (needs the extra `fuzz`: pip install -e .[fuzz]).

usage: fuzz.py [--seconds 60] [--formats ply,obj,...] [--corpus DIR]
Every file must be read or refused with an InputError, within 5 seconds and 1 GB. What breaks that is kept in DIR/crash-*
(default a new temporary directory), and the exit status is then 1. Small good files of every format are written first.
"""

from __future__ import annotations

import argparse
import base64
import io
import json
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

FORMATS = ("ply", "obj", "stl", "off", "glb", "gltf", "npz", "sphere", "cuts")
_LIMIT_MB = 1024
_LONGEST_S = 5


def _ply(points: np.ndarray, faces: np.ndarray, form: str) -> bytes:
    header = f"ply\nformat {form} 1.0\ncomment good\nelement vertex {len(points)}\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz")
    header += f"element face {len(faces)}\nproperty list uchar int vertex_indices\n"
    if form == "ascii":
        rows = [f"{x} {y} {z}" for x, y, z in points.tolist()] + [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
        return (header + "end_header\n" + "\n".join(rows) + "\n").encode()
    order = "<" if "little" in form else ">"
    rows = np.empty(len(faces), [("n", "u1"), ("v", order + "i4", (3,)), ("m", "u1"), ("t", order + "f4", (2,))])
    rows["n"], rows["v"], rows["m"], rows["t"] = 3, faces, 2, 0.5
    header += "property list uchar float texcoord\nend_header\n"
    return header.encode() + points.astype(order + "f4").tobytes() + rows.tobytes()


def _gltf(points: np.ndarray, faces: np.ndarray, binary: bool) -> bytes:
    data = faces.astype("<u2").tobytes() + points.astype("<f4").tobytes()
    split = 6 * len(faces)
    buffer: dict[str, object] = {"byteLength": len(data)}
    if not binary:
        buffer["uri"] = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"children": [1], "scale": [2, 2, 2]}, {"mesh": 0, "rotation": [0, 0, 0, 1], "translation": [1, 0, 0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 1}, "indices": 0, "mode": 4}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5123, "count": 3 * len(faces), "type": "SCALAR"},
            {"bufferView": 1, "byteOffset": 0, "componentType": 5126, "count": len(points), "type": "VEC3"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": split},
            {"buffer": 0, "byteOffset": split, "byteLength": len(data) - split, "byteStride": 12},
        ],
        "buffers": [buffer],
    }
    text = json.dumps(document).encode()
    if not binary:
        return text
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def _npz(**arrays: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def seeds() -> dict[str, list[bytes]]:
    """Good small files by ending: a lifted grid of 4 x 4 vertices, 18 triangles, and for ``cuts`` a few of its edges."""
    i, j = (k.ravel() for k in np.meshgrid(np.arange(4), np.arange(4), indexing="ij"))
    points = np.column_stack([i, j, i * j / 8]).astype(np.float64)
    a = (4 * i + j)[(i < 3) & (j < 3)]
    faces = np.concatenate([np.column_stack([a, a + 4, a + 5]), np.column_stack([a, a + 5, a + 1])])
    v = "".join(f"v {x} {y} {z}\n" for x, y, z in points.tolist())
    rows = (faces + 1).tolist()
    objs = [
        "# good\no grid\n" + v + "".join(f"f {a} {b} {c}\n" for a, b, c in rows),
        v + "vt 0 0\nvn 0 0 1\n" + "".join(f"f {a}/1/1 {b}/1/1 {c}//1\n" for a, b, c in rows[:9]) + "f -16 -12 \\\n -11\n",
    ]
    corners = points[faces].astype("<f4")
    facets = np.zeros(len(faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets["corners"] = corners
    text = "".join(
        "facet normal 0 0 1\nouter loop\n" + "".join(f"vertex {x} {y} {z}\n" for x, y, z in f) + "endloop\nendfacet\n"
        for f in corners.tolist()
    )
    off = f"OFF\n# good\n{len(points)} {len(faces)} 0\n" + v.replace("v ", "")
    off += "".join(f"3 {a} {b} {c}\n" for a, b, c in faces.tolist())
    return {
        "ply": [_ply(points, faces, form) for form in ("ascii", "binary_little_endian", "binary_big_endian")],
        "obj": [text.encode() for text in objs],
        "stl": [b"solid".ljust(80) + struct.pack("<I", len(faces)) + facets.tobytes(), f"solid s\n{text}endsolid s\n".encode()],
        "off": [off.encode()],
        "glb": [_gltf(points, faces, True)],
        "gltf": [_gltf(points, faces, False)],
        "npz": [_npz(vertices=points, faces=faces), _npz(v=points.astype("f4"), f=faces.astype("u1"))],
        "sphere": [
            b"\xff\xff\xfecreated\n\n"
            + struct.pack(">ii", len(points), len(faces))
            + points.astype(">f4").tobytes()
            + faces.astype(">i4").tobytes()
        ],
        "cuts": [b"# cut\n0 1\n1, 5\n5 9\n"],
    }


def _fuzz_one(kind: str, corpus: Path, seconds: int) -> None:
    """Fuzz one reader in this process; does not return."""
    import resource

    import atheris

    with atheris.instrument_imports(include=["pgcp.io", "pgcp.types"]):
        from pgcp.io.read import read_cuts, read_mesh
    from pgcp.errors import InputError

    folder = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    path = folder / f"m.{kind}"
    read = read_cuts if kind == "cuts" else read_mesh
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + _LIMIT_MB * 1024**2,) * 2)

    def one(data: bytes) -> None:
        path.write_bytes(data)
        try:
            read(path)
        except InputError as problem:
            if isinstance(problem.__cause__, MemoryError) or "\n" in str(problem):
                raise AssertionError(f"not a good refusal: {problem}") from problem

    arguments = [
        f"-max_total_time={seconds}", f"-timeout={_LONGEST_S}", f"-rss_limit_mb={_LIMIT_MB}", "-max_len=8192",
        f"-artifact_prefix={corpus.parent}/crash-{kind}-", "-print_final_stats=1", str(corpus),
    ]  # fmt: skip
    atheris.Setup([sys.argv[0], *arguments], one)
    atheris.Fuzz()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=int, default=60, help="in all, shared among the formats")
    parser.add_argument("--formats", default=",".join(FORMATS))
    parser.add_argument("--corpus", type=Path, help="keeps what was found between runs")
    parser.add_argument("--one", choices=FORMATS, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    base = arguments.corpus or Path(tempfile.mkdtemp(prefix="fuzz-"))
    if arguments.one:
        _fuzz_one(arguments.one, base / arguments.one, arguments.seconds)
    kinds = arguments.formats.split(",")
    share = max(1, arguments.seconds // len(kinds))
    failed = False
    for kind in kinds:
        folder = base / kind
        folder.mkdir(parents=True, exist_ok=True)
        for number, data in enumerate(seeds()[kind]):
            (folder / f"seed-{number}").write_bytes(data)
        command = [sys.executable, __file__, "--one", kind, "--seconds", str(share), "--corpus", str(base)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        runs = next((line.split()[-1] for line in done.stderr.splitlines() if "number_of_executed_units" in line), "0")
        print(f"{kind}\t{runs} files\t{'good' if done.returncode == 0 else 'FAILED'}", flush=True)
        if done.returncode:
            failed = True
            print("\n".join((done.stdout + done.stderr).splitlines()[-40:]), file=sys.stderr)
    print(f"corpus and findings in {base}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
