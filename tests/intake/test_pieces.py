"""Several components: the largest, one by name or number, or all of them beside each other."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

import pgcp
from pgcp.cli.main import main
from pgcp.errors import InputError, NotSimplyConnectedError
from pgcp.finish.shelves import on_shelves


def sheet(n, size, shift):
    """Quads of a bent sheet of n x n cells."""
    ticks = np.linspace(0, size, n + 1)
    x, y = (grid.ravel() for grid in np.meshgrid(ticks, ticks, indexing="ij"))
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    points = np.column_stack([x + shift, y, 0.2 * np.sin(2 * x) * np.cos(y)])
    return points, np.column_stack([a, a + n + 1, a + n + 2, a + 1])


PARTS = {
    "Small": sheet(4, 0.5, 0.0), "Big": sheet(12, 2.0, 3.0), "Mid": sheet(8, 1.0, 8.0),
    "Ball": (trimesh.creation.icosphere(1).vertices - 9.0, trimesh.creation.icosphere(1).faces),
    "Ring": (trimesh.creation.torus(1.0, 0.3, 8, 4).vertices + 20.0, trimesh.creation.torus(1.0, 0.3, 8, 4).faces),
}  # fmt: skip


def write(path, *names):
    lines, count = [], 1
    for name in names:
        points, faces = PARTS[name]
        lines.append(f"o {name}")
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
        lines += ["f " + " ".join(map(str, face)) for face in (faces + count).tolist()]
        count += len(points)
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def scene(tmp_path):
    return write(tmp_path / "scene.obj", "Small", "Big", "Ball", "Mid", "Ring")


@pytest.mark.parametrize(
    ("component", "name"), [("largest", "Big"), ("Mid", "Mid"), ("1", "Big"), ("4", "Ring"), ("5", "Small")]
)
def test_one_component_is_mapped_and_the_others_are_named(scene, component, name):
    if name == "Ring":
        with pytest.raises(NotSimplyConnectedError, match=r"genus 1.*it is component 4 of 5, the others are 1 'Big'"):
            pgcp.parameterize(scene, component=component)
        return
    result = pgcp.parameterize(scene, component=component, patches=1)
    assert np.allclose(result.mesh.vertices, PARTS[name][0])
    assert np.array_equal(pgcp.read_mesh(scene).vertices[result.vertex_of], result.mesh.vertices)
    said = next(note["message"] for note in result.report["input"] if note["step"] == "component")
    assert f"'{next(other for other in PARTS if other != name)}'" in said
    assert "--component all" in said


@pytest.mark.parametrize("component", ["Nose", "0", "6", ""])
def test_a_component_that_is_not_there_is_refused(scene, component):
    with pytest.raises(InputError, match=r"there is no component .*components 1 to 5, and parts named Small, Big, Ball, Mid"):
        pgcp.parameterize(scene, component=component)


def boxes(points, faces, component_of):
    return [
        (points[faces[component_of == k]].min((0, 1)), points[faces[component_of == k]].max((0, 1)))
        for k in range(max(component_of) + 1)
    ]


def apart(found):
    return all(
        (low >= high2 - 1e-12).any() or (low2 >= high - 1e-12).any()
        for k, (low, high) in enumerate(found)
        for low2, high2 in found[k + 1 :]
    )


@pytest.mark.parametrize("target", ["auto", "disk"])
def test_all_open_components_lie_beside_each_other_by_area(scene, tmp_path, target):
    out = tmp_path / "out"
    arguments = [str(scene), "--component", "all", "--target", target, "--output-dir", str(out), "--write", "obj,glb,ply,npz"]
    assert main([*arguments, "--quiet"]) == 0
    report = json.loads((out / "report.json").read_text())
    assert [row["name"].split("'")[1] for row in report["components"]] == ["Big", "Mid", "Small"]
    said = report["input"][-1]["message"]
    assert said.startswith("3 of 5 components are mapped; left out: component 3 'Ball' is ")
    assert "component 4 'Ring' is a surface of genus 1" in said
    text = (out / "scene.obj").read_text().splitlines()
    faces = np.array([[int(c.split("/")[0]) - 1 for c in line.split()[1:]] for line in text if line.startswith("f ")])
    uv = np.array([line.split()[1:] for line in text if line.startswith("vt ")], float)
    assert [line for line in text if line[0] == "o"] == ["o Small", "o Big", "o Mid"]
    component_of = np.repeat([2, 0, 1], [16, 144, 64])
    assert apart(boxes(uv, faces, component_of))
    assert uv.min() >= 0.0
    assert uv.max() <= 1.0
    a, b, c, d = (uv[faces[:, i]] for i in range(4))
    image = 0.5 * np.abs((c - a)[:, 0] * (d - b)[:, 1] - (c - a)[:, 1] * (d - b)[:, 0])
    shares = np.bincount(component_of, image)
    assert np.allclose(shares[1:] / shares[0], [0.25, 0.0625], rtol=0.1)
    with np.load(out / "scene.npz") as data:
        assert len(data["uv"]) == len(data["vertex_of"]) == len(uv)
        assert np.isfinite(data["uv"]).all()


def test_all_spheres_share_one_square(tmp_path):
    path = write(tmp_path / "balls.obj", "Ball", "Ring", "Small")
    text = path.read_text()
    count = text.count("\nv ") + text.startswith("v ")
    points, faces = PARTS["Ball"]
    path.write_text(text + "o Moon\n" + "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in (0.5 * points).tolist())
                    + "".join(f"f {a} {b} {c}\n" for a, b, c in (faces + count + 1).tolist()))  # fmt: skip
    result = pgcp.parameterize(path, component="all", target="sphere")
    assert [row["name"] for row in result.report["components"]] == ["component 1 'Ball'", "component 2 'Moon'"]
    assert np.allclose(np.linalg.norm(result.sphere, axis=1), 1.0)
    assert result.quality.degree == pytest.approx(1.0)
    layout = result.layout()
    assert apart(boxes(layout.points, layout.faces, result.origin.component_of))
    assert layout.points.min() >= 0.0
    assert layout.points.max() <= 1.0
    assert result.picture() is not None


def test_a_file_of_one_component_is_all_of_it(tmp_path):
    path = write(tmp_path / "one.obj", "Mid")
    all_of_it, plain = pgcp.parameterize(path, component="all"), pgcp.parameterize(path)
    assert np.allclose(np.ptp(all_of_it.uv, axis=0).max() / np.ptp(plain.uv, axis=0).max(), 1.0, atol=0.5)
    assert all_of_it.quality.angle_mean_deg == pytest.approx(plain.quality.angle_mean_deg, rel=1e-9)


def test_where_nothing_can_be_mapped_the_first_reason_is_given(tmp_path):
    with pytest.raises(NotSimplyConnectedError, match="genus 1"):
        pgcp.parameterize(write(tmp_path / "ring.obj", "Ring"), component="all")


def test_a_centre_goes_with_one_component(scene):
    with pytest.raises(InputError, match="a centre, cuts and a cut along given edges are of one component"):
        pgcp.parameterize(scene, component="all", centre=3)


@pytest.mark.parametrize("seed", range(5))
def test_boxes_on_shelves_do_not_overlap_and_fill_most_of_a_square(seed):
    sizes = np.random.default_rng(seed).uniform(0.1, 1.0, (40, 2))
    places = on_shelves(sizes)
    found = list(zip(places, places + sizes, strict=True))
    assert apart(found)
    assert places.min() >= 0.0
    assert sizes.prod(axis=1).sum() > 0.55 * (places + sizes).max() ** 2


def test_check_only_says_what_would_be_mapped(scene, capsys):
    assert main([str(scene), "--check-only", "--component", "Ball"]) == 0
    said = capsys.readouterr().out
    assert "component 3 of 5 is mapped, 80 of" in said
    assert "then it is a closed surface of genus 0 (a sphere)\n  targets that fit: sphere" in said
