"""Pictures that are put on surfaces."""

from __future__ import annotations

import io

import numpy as np
import pytest
from meshes import grid, lifted, spheroid
from PIL import Image

import pgcp
from pgcp.errors import BadFileError, InputError
from pgcp.report.texture import as_picture, as_png, checkerboard


def test_the_checkerboard_has_squares_of_two_kinds():
    board = np.asarray(checkerboard(64, 8)).astype(int).sum(axis=2).reshape(8, 8, 8, 8).mean(axis=(1, 3))
    dark = board < 400
    assert np.array_equal(dark, np.indices((8, 8)).sum(axis=0) % 2 == dark[0, 0] * 0 + (0 if dark[0, 0] else 1))
    assert checkerboard().size == (1024, 1024)


def test_pictures_come_from_files_arrays_and_pictures(tmp_path):
    array = np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8)
    Image.fromarray(array).save(tmp_path / "p.png")
    for source in (array, Image.fromarray(array), tmp_path / "p.png", str(tmp_path / "p.png")):
        assert np.array_equal(np.asarray(as_picture(source)), array)
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(as_png(array)))), array)


def test_what_is_no_picture_is_refused(tmp_path):
    (tmp_path / "x.png").write_text("text")
    (tmp_path / "cut.png").write_bytes(as_png("checker")[:200])
    for source, kind, words in (
        (tmp_path / "no.png", BadFileError, "No such file"),
        (tmp_path / "x.png", BadFileError, "it is no picture"),
        (tmp_path / "cut.png", BadFileError, "the picture cannot be read"),
        (np.zeros((3, 3)), InputError, r"shape \(3, 3\)"),
        (3, InputError, "not int"),
    ):
        with pytest.raises(kind, match=words):
            as_picture(source)


def test_a_result_with_a_texture_is_a_trimesh_with_a_picture():
    for mesh in (lifted(grid(6)), spheroid(2, 1.5)[0]):
        result = pgcp.parameterize(mesh, patches=2)
        textured = result.texture()
        layout = result.layout()
        assert np.array_equal(textured.vertices[: len(mesh.vertices)], mesh.vertices)
        assert np.array_equal(textured.vertices[textured.faces], mesh.vertices[mesh.faces])
        assert np.array_equal(textured.visual.uv[textured.faces], layout.points[layout.faces])
        assert textured.visual.material.image.size == (1024, 1024)
        assert result.layout("surface") is None
        with pytest.raises(InputError, match="unknown texture coordinates 'x'"):
            result.layout("x")
