"""What parameterize and compute return: the finished map, its measures by face and vertex, and ways into other packages."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pgcp.errors import BadFileError, InputError
from pgcp.finish.side_by_side import globes_in_square
from pgcp.finish.unit_square import in_unit_square, on_the_globe
from pgcp.io.files import replacing
from pgcp.io.given import given_parts
from pgcp.options import UVS
from pgcp.parallel import in_slices
from pgcp.plane.locate import Locator, Places
from pgcp.surface.distortion import angle_errors, log_area_ratios, log_scales
from pgcp.surface.operators import face_areas
from pgcp.targets.registry import TARGETS
from pgcp.types import FloatArray, IntArray, Layout, Mesh, Parameterization, Quality

if TYPE_CHECKING:
    import pyvista
    import trimesh

    from pgcp.report.notebook import Plot

_FORM = 1  # of saved results
_ARRAYS = ("coordinates", "patch", "mu", "vertex_of", "face_of")


@dataclass(frozen=True, eq=False, repr=False)
class Result(Parameterization):
    """A finished map: what ``Parameterization`` holds, measures by face and vertex, and ways into other packages."""

    @classmethod
    def of(cls, done: Parameterization) -> Result:
        """The same map as a Result."""
        return cls(**{field.name: getattr(done, field.name) for field in fields(Parameterization)})

    @property
    def faces(self) -> IntArray:
        """Faces (F, 3) of the mesh that was mapped, in the order of the input."""
        return self.mesh.faces

    @property
    def uv(self) -> FloatArray | None:
        """Coordinates (V, 2) in the plane, in the surface's unit of length or on the unit disk; None of a map to the sphere."""
        return None if self._closed else self.coordinates

    @property
    def sphere(self) -> FloatArray | None:
        """Unit vectors (V, 3); None of a map to the plane."""
        return self.coordinates if self._closed else None

    @cached_property
    def _closed(self) -> bool:
        return TARGETS.get(self.target).space.closed

    @cached_property
    def angle_error(self) -> FloatArray:
        """Mean of |angle in the map - angle on the surface| (F,) over the corners of every face, degrees (PGCP eq. 5.1).

        0 for faces without area on the surface, which have no angles.
        """
        errors = angle_errors(self.mesh, self.coordinates).mean(axis=1)
        return np.where(self._areas[0] > 0.0, errors, 0.0)

    @cached_property
    def area_ratio(self) -> FloatArray:
        """Area in the map over area on the surface (F,), each a share of its total; its logarithm is PGCP eq. 6.1.

        1 for faces without area on the surface, 0 for those without area in the map.
        """
        surface, image = self._areas
        with np.errstate(over="ignore"):
            ratios = np.exp(log_area_ratios(surface, image, (float(surface.sum()), float(image.sum()))))
        return np.where((surface > 0.0) & ~np.isnan(ratios), ratios, 1.0)

    @cached_property
    def log_scale(self) -> FloatArray:
        """Natural logarithm of length in the map over length on the surface (V,), from the areas of the faces around a vertex.

        0 for vertices around which there is no area.
        """
        return log_scales(*self._areas, self.faces, len(self.mesh.vertices))

    @cached_property
    def _areas(self) -> tuple[FloatArray, FloatArray]:
        """Areas (F,) on the surface and in the map."""
        image = np.pad(self.coordinates, ((0, 0), (0, 3 - self.coordinates.shape[1])))

        def areas(points: FloatArray) -> FloatArray:
            """Areas (F,) of the faces."""
            return np.concatenate(in_slices(lambda begin, end: face_areas(points, self.faces[begin:end]), len(self.faces)))

        return areas(self.mesh.vertices), areas(image)

    @cached_property
    def _locator(self) -> Locator:
        return Locator(self.coordinates, self.faces, self._closed)

    def inverse(self, points: Any) -> Places:
        """Where on the surface points of the map come from.

        points: (N, 2) in the map's coordinates, or (N, 3) on the sphere, of any length but 0. Returns ``faces`` (N,) int64,
        barycentric ``weights`` (N, 3), ``points`` (N, 3) on the surface, and ``inside`` (N,) bool. A point outside the map is
        taken to the nearest place on an edge, and is not inside. The first call makes a search tree.

        Raises InputError for points of another shape, or that are no finite numbers.
        """
        wanted = np.atleast_2d(np.asarray(points, np.float64))
        if wanted.shape[1:] != self.coordinates.shape[1:]:
            raise InputError(f"points have shape {np.shape(points)}, expected (N, {self.coordinates.shape[1]})")
        if not np.isfinite(wanted).all():
            raise InputError(f"point {int(np.flatnonzero(~np.isfinite(wanted).all(axis=1))[0])} is no finite number")
        if self._closed:
            length = np.linalg.norm(wanted, axis=1, keepdims=True)
            if not length.all():
                raise InputError(f"point {int(np.flatnonzero(length == 0.0)[0])} is the centre of the sphere, in no direction")
            wanted = wanted / length
        return self._locator.find(wanted, self.mesh.vertices)

    def layout(self, uv: str = "unit", up: str = "auto") -> Layout | None:
        """Texture coordinates: ``unit``, upright in [0, 1]^2, or longitude and latitude of the sphere; of ``surface`` None.

        ``surface`` stands for the map's own coordinates. up: the surface's axis that is up on the texture, x, y, z or auto.
        Raises InputError for other words.
        """
        if uv not in UVS:
            raise InputError(f"unknown texture coordinates {uv!r}; choose from {', '.join(UVS)}")
        if uv != UVS[0]:
            return None
        if not self._closed:
            return in_unit_square(self.mesh, self.coordinates, up)
        given = given_parts(self.origin, self.faces)
        polygon_of = given.polygon_of if given is not None and given.has_polygons else None
        layout = on_the_globe(self.mesh, self.coordinates, up, polygon_of)
        component_of = None if self.origin is None else self.origin.component_of
        if component_of is None:
            return layout
        return globes_in_square(layout, component_of, np.asarray(np.bincount(component_of, self._areas[0]), np.float64))

    def texture(self, image: Any = "checker", up: str = "auto") -> trimesh.Trimesh:
        """The surface as a ``trimesh.Trimesh`` with a picture on it, by the layout ``unit``.

        image: a path, an array (height, width, 3) uint8, a Pillow image, or "checker". Where the sphere's texture is cut,
        vertices are repeated at the end. Raises InputError where there is no picture.
        """
        import trimesh

        from pgcp.report.texture import as_picture

        layout = self.layout("unit", up)
        assert layout is not None
        vertices = np.concatenate([self.mesh.vertices, self.mesh.vertices[layout.copies]])
        visual = trimesh.visual.TextureVisuals(uv=layout.points, image=as_picture(image))
        return trimesh.Trimesh(vertices, layout.faces, visual=visual, process=False)

    def to_trimesh(self) -> trimesh.Trimesh:
        """The surface as a ``trimesh.Trimesh`` in the same order.

        Coordinates in the plane are its texture coordinates (``visual.uv``), coordinates on the sphere its vertex attribute
        "sphere"; patch and mu are face attributes.
        """
        from pgcp.io.trimesh_bridge import to_trimesh

        return to_trimesh(self)

    def to_pyvista(self) -> pyvista.PolyData:
        """The surface as a ``pyvista.PolyData`` in the same order.

        ``point_data`` has the coordinates ("uv", which are the texture coordinates too, or "sphere") and "log_scale",
        ``cell_data`` "patch", "mu_abs", "angle_error" and "area_ratio". Raises InputError where pyvista is not installed.
        """
        try:
            import pyvista
        except ImportError as problem:
            raise InputError("to_pyvista needs the package pyvista, which is not installed: pip install pyvista") from problem
        corners = np.column_stack([np.full(len(self.faces), 3), self.faces]).ravel()
        surface = pyvista.PolyData(self.mesh.vertices, corners)
        surface.point_data[self.coordinates_name] = self.coordinates
        if not self._closed:
            surface.active_texture_coordinates = self.coordinates
        surface.point_data["log_scale"] = self.log_scale
        for name, values in self._by_face.items():
            surface.cell_data[name] = values
        return surface

    @property
    def _by_face(self) -> dict[str, np.ndarray]:
        ratios = {"angle_error": self.angle_error, "area_ratio": self.area_ratio}
        return {"patch": self.patch, "mu_abs": np.abs(self.mu), **ratios}

    def plot(self, faces: int | None = None, height: int | None = None) -> Plot:
        """The report page for a notebook, which shows it in a frame; nothing is opened where there is none.

        faces: how many are drawn at most, 200,000 if nothing is said; height: of the frame in pixels, 640.
        Raises InputError where they are out of bounds.
        """
        from pgcp.report.notebook import Plot

        asked = {"faces": faces, "height": height}
        return Plot(self, **{name: value for name, value in asked.items() if value is not None})

    def picture(self) -> Any:
        """The picture that the command writes, as a ``PIL.Image.Image``."""
        from pgcp.report.picture import drawn_sheet

        return drawn_sheet(self)

    def page(self) -> str:
        """The report page that the command writes: HTML that needs no other file and no network."""
        from pgcp.report.page import page

        return page(self).decode()

    def save(self, path: str | Path) -> None:
        """Write all of the result into one npz file, whatever its name, that appears whole or not at all.

        Raises BadFileError where it cannot be written.
        """
        path = Path(path)
        said = {"form": _FORM, "name": self.mesh.name, "target": self.target, "coordinates_name": self.coordinates_name}
        said |= {"quality": asdict(self.quality), "report": self.report}
        arrays = {name: getattr(self, name) for name in _ARRAYS if getattr(self, name) is not None}
        arrays |= {"vertices": self.mesh.vertices, "faces": self.faces, "result": np.array(json.dumps(said))}
        try:
            with replacing(path) as stream:
                np.savez(stream, **arrays)  # type: ignore[arg-type]
        except OSError as problem:
            raise BadFileError(f"{path}: the result cannot be written: {problem.strerror}") from problem

    @classmethod
    def load(cls, path: str | Path) -> Result:
        """Read what ``save`` wrote; raises BadFileError where a file is something else."""
        path = Path(path)
        try:
            with np.load(path, allow_pickle=False) as data:
                arrays = {name: data[name] for name in data.files}
            said = json.loads(str(arrays["result"]))
            if said["form"] != _FORM:
                raise BadFileError(f"{path}: it was saved in form {said['form']!r}, this version reads form {_FORM}")
            mesh = Mesh(arrays["vertices"], arrays["faces"], said["name"])
            values: dict[str, Any] = {name: arrays.get(name) for name in _ARRAYS}
            return cls(
                mesh=mesh, quality=Quality(**said["quality"]), target=said["target"], report=said["report"],
                coordinates_name=said["coordinates_name"], **values,
            )  # fmt: skip
        except OSError as problem:
            raise BadFileError(f"{path}: the result cannot be read: {problem.strerror or problem}") from problem
        except BadFileError:
            raise
        except Exception as problem:
            raise BadFileError(
                f"{path}: it is no saved result ({type(problem).__name__}); Result.save writes them"
            ) from problem

    def __repr__(self) -> str:
        """Three lines: the surface, where it was mapped, how well."""
        q = self.quality
        covered = "" if q.degree is None else f", degree {q.degree:.0f}"
        shape = " x ".join(map(str, self.coordinates.shape))
        return (
            f"pgcp.Result of {self.mesh.name}: {len(self.mesh.vertices)} vertices, {len(self.faces)} faces\n"
            f"  target {self.target}, {self.coordinates_name} {shape}, {int(self.patch.max()) + 1} patches\n"
            f"  |angle error| mean {q.angle_mean_deg:.4f}, max {q.angle_max_deg:.2f} degrees; folds {q.folds}{covered}"
        )

    def _repr_html_(self) -> str:
        """The three lines and the report page in a frame, with at most 20,000 faces drawn, for notebooks."""
        from html import escape

        from pgcp.report.notebook import framed

        return f"<pre>{escape(repr(self))}</pre>{framed(self)}"
