"""Small good files of the formats that are read through trimesh: the lifted grid of scripts/fuzz.py."""

from __future__ import annotations

import io
import zipfile

import numpy as np

_I, _J = (k.ravel() for k in np.meshgrid(np.arange(4), np.arange(4), indexing="ij"))
POINTS = np.column_stack([_I, _J, _I * _J / 8]).astype(np.float64)
_A = (4 * _I + _J)[(_I < 3) & (_J < 3)]
FACES = np.concatenate([np.column_stack([_A, _A + 4, _A + 5]), np.column_stack([_A, _A + 5, _A + 1])])


def zipped(files: dict[str, str | bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return stream.getvalue()


def numbers(array: np.ndarray) -> str:
    return " ".join(f"{value:g}" for value in array.ravel())


def threemf_object(number: int, points: np.ndarray = POINTS, faces: np.ndarray = FACES) -> str:
    vertices = "".join(f'<vertex x="{x:g}" y="{y:g}" z="{z:g}"/>' for x, y, z in points)
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in faces)
    return f'<object id="{number}"><mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh></object>'


def threemf_text(objects: str, items: str) -> str:
    space = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
    return f'<model unit="millimeter" xmlns="{space}"><resources>{objects}</resources><build>{items}</build></model>'


def threemf(objects: str, items: str) -> bytes:
    return zipped({"3D/3dmodel.model": threemf_text(objects, items)})


def dae_text(corners: str = "", positions: str = "", before: str = "") -> str:
    corners, positions = corners or numbers(FACES), positions or numbers(POINTS)
    axes = "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ")
    return f"""<?xml version="1.0"?>{before}<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>2020-01-01T00:00:00</created><modified>2020-01-01T00:00:00</modified></asset>
<library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="f" count="{len(positions.split())}">{positions}</float_array><technique_common>
<accessor source="#f" count="{len(positions.split()) // 3}" stride="3">{axes}</accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles count="{len(corners.split()) // 3}"><input semantic="VERTEX" source="#v" offset="0"/><p>{corners}</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="vs"><node id="n"><instance_geometry url="#g"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#vs"/></scene></COLLADA>"""


def xaml_text() -> str:
    positions = " ".join(",".join(f"{value:g}" for value in point) for point in POINTS)
    normals = " ".join(["0,0,1"] * len(POINTS))
    brush = '<SolidColorBrush Color="#FFFFFFFF" Opacity="1"/>'
    return (
        '<Viewport3D xmlns="http://schemas.microsoft.com/winfx/2006/xaml/presentation"><GeometryModel3D>'
        f"<GeometryModel3D.Material><DiffuseMaterial><DiffuseMaterial.Brush>{brush}</DiffuseMaterial.Brush></DiffuseMaterial>"
        '</GeometryModel3D.Material><GeometryModel3D.Geometry><MeshGeometry3D Positions="'
        f'{positions}" Normals="{normals}" TriangleIndices="{numbers(FACES)}"/></GeometryModel3D.Geometry>'
        "</GeometryModel3D></Viewport3D>"
    )


ITEM = '<item objectid="1"/>'
# inner texts by format; those of archives have the names of their members
TEXTS: dict[str, dict[str, str]] = {
    "3mf": {"3D/3dmodel.model": threemf_text(threemf_object(1), ITEM)},
    "dae": {"": dae_text()},
    "zae": {"m.dae": dae_text()},
    "xaml": {"": xaml_text()},
}


def packed(files: dict[str, str | bytes]) -> bytes:
    return files[""].encode() if "" in files else zipped(files)


SEEDS = {kind: packed(files) for kind, files in TEXTS.items()}


def vtk_files() -> dict[str, bytes]:
    """The same surface in the formats of VTK and in GIFTI, as text."""
    count, rows = len(POINTS), " ".join(f"{a} {b} {c}" for a, b, c in FACES.tolist())
    points = " ".join(map(str, POINTS.ravel().tolist()))
    ends = " ".join(str(3 * k + 3) for k in range(len(FACES)))
    cells = (
        f'<DataArray type="Int64" Name="connectivity" format="ascii">{rows}</DataArray>'
        f'<DataArray type="Int64" Name="offsets" format="ascii">{ends}</DataArray>'
    )
    place = (
        f'<Points><DataArray type="Float64" Name="Points" NumberOfComponents="3" format="ascii">{points}</DataArray></Points>'
    )
    head = '<?xml version="1.0"?><VTKFile type="{0}" version="1.0" byte_order="LittleEndian" header_type="UInt64"><{0}>'
    kinds = f'<DataArray type="UInt8" Name="types" format="ascii">{" ".join(["5"] * len(FACES))}</DataArray>'
    legacy = f"# vtk DataFile Version 3.0\nm\nASCII\nDATASET POLYDATA\nPOINTS {count} double\n{points}\n"
    legacy += f"POLYGONS {len(FACES)} {4 * len(FACES)}\n" + "".join(f"3 {a} {b} {c}\n" for a, b, c in FACES.tolist())
    arrays = "".join(
        f'<DataArray Intent="NIFTI_INTENT_{intent}" DataType="NIFTI_TYPE_{kind}" ArrayIndexingOrder="RowMajorOrder" '
        f'Dimensionality="2" Dim0="{n}" Dim1="3" Encoding="ASCII" Endian="LittleEndian" ExternalFileName="" '
        f'ExternalFileOffset=""><MetaData/><Data>{data}</Data></DataArray>'
        for intent, kind, n, data in (("POINTSET", "FLOAT32", count, points), ("TRIANGLE", "INT32", len(FACES), rows))
    )
    gifti = '<?xml version="1.0" encoding="UTF-8"?><GIFTI Version="1.0" NumberOfDataArrays="2"><MetaData/><LabelTable/>'
    gifti += f"{arrays}</GIFTI>"
    return {
        "vtk": legacy.encode(),
        "vtp": (
            head.format("PolyData")
            + f'<Piece NumberOfPoints="{count}" NumberOfPolys="{len(FACES)}">{place}<Polys>{cells}</Polys>'
            "</Piece></PolyData></VTKFile>"
        ).encode(),
        "vtu": (
            head.format("UnstructuredGrid")
            + f'<Piece NumberOfPoints="{count}" NumberOfCells="{len(FACES)}">{place}<Cells>{cells}{kinds}</Cells></Piece>'
            "</UnstructuredGrid></VTKFile>"
        ).encode(),
        "gii": gifti.encode(),
        "surf.gii": gifti.encode(),
    }


THROUGH_OTHERS = vtk_files()
