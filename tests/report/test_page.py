"""The report page: what it holds, as text, and what a browser makes of it."""

from __future__ import annotations

import base64
import io
import json
import re
import zlib
from dataclasses import replace

import numpy as np
import pytest
from browser import headless, opened
from markupsafe import escape
from meshes import grid, lifted, spheroid
from PIL import Image

import pgcp
from pgcp.cli import main as command
from pgcp.report.page import _of_moderate_size, page
from pgcp.report.scene import _edges, packed, scene_of
from pgcp.report.timeline import timeline
from pgcp.report.words import course

NASTY = "a </script><img src=x onerror=alert(1)> & 日本 \u202e.ply"
BLUE, CREAM, CYAN = (51, 97, 158), (250, 240, 214), (0, 229, 255)


@pytest.fixture(scope="module")
def plane():
    return pgcp.parameterize(lifted(grid(24)), patches=4)


@pytest.fixture(scope="module")
def ball():
    return pgcp.parameterize(spheroid(3, 1.5)[0], patches=2, target="sphere")


def unpacked(shown):
    """Arrays by name, as the page's script has them."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(shown.text)), np.uint8)
    out, at = {}, 0
    for array in shown.head["arrays"]:
        rows, columns = array["shape"]
        own = planes[at : at + 4 * rows * columns].reshape(4, -1).astype(np.int64)
        whole = (own << np.array([[0], [8], [16], [24]])).sum(axis=0)
        steps = ((whole >> 1) ^ -(whole & 1)).reshape(columns, rows)
        out[array["name"]] = (steps.cumsum(axis=1) if array["delta"] else steps).T
        at += 4 * rows * columns
    assert at == len(planes)
    flat, new = out["faces"].reshape(-1), 0
    faces = np.empty_like(flat)
    for k, back in enumerate(flat.tolist()):
        faces[k] = new - back
        new += back == 0
    return {**out, "faces": faces.reshape(-1, 3)}


@pytest.mark.parametrize("kind", ["plane", "ball"])
def test_a_page_holds_the_surface_its_map_and_the_figures_of_every_face(kind, request):
    result = request.getfixturevalue(kind)
    scene = scene_of(result)
    shown = packed(result, scene)
    found = unpacked(shown)
    assert np.array_equal(scene.points[scene.faces], result.mesh.vertices[result.mesh.faces])
    assert np.array_equal(found["faces"], scene.faces)
    for name, points, steps in (("points", scene.points, 65_535), ("image", scene.image, (1 << 24) - 1)):
        box = shown.head[name]
        wanted = points if name == "image" and kind == "ball" else (points - points.min(axis=0)) / np.ptp(points, axis=0).max()
        assert np.abs(np.array(box["low"]) + box["step"] * found[name] - wanted).max() <= 0.51 * box["step"]
        assert np.ptp(wanted, axis=0).max() == pytest.approx(steps * box["step"])
    angles = shown.head["angle_max"] * (found["angle"][:, 0] / 65_535) ** 2
    assert np.abs(angles - result.angle_error).max() < 1e-4 * max(result.angle_error.max(), 1.0)
    assert np.abs(2.0 ** (found["area"][:, 0] / shown.head["halves"]) / result.area_ratio - 1).max() < 1e-3
    assert np.array_equal(found["patch"][:, 0], result.patch)


@pytest.mark.parametrize("kind", ["plane", "ball"])
def test_the_scale_of_the_squares_is_that_of_the_map(kind, request):
    result = request.getfixturevalue(kind)
    scene = scene_of(result)
    scales = np.empty(len(result.mesh.vertices))
    scales[result.mesh.faces] = unpacked(packed(result, scene))["scale"][scene.faces, 0] / 1024
    assert np.ptp(scales - result.log_scale / np.log(2.0)) < 0.01
    assert np.ptp(scales) > 0.3


@pytest.mark.parametrize("size", [1e-200, 1e200])
@pytest.mark.parametrize("kind", ["plane", "ball"])
def test_a_page_does_not_depend_on_the_unit_of_length_or_on_the_origin(kind, size, request):
    result = request.getfixturevalue(kind)
    flat = size if kind == "plane" else 1.0
    mesh = replace(result.mesh, vertices=size * (result.mesh.vertices + 100.0))
    moved = replace(result, mesh=mesh, coordinates=flat * result.coordinates)
    here, there = (unpacked(packed(r, scene_of(r))) for r in (result, _of_moderate_size(moved)))
    assert np.array_equal(here["faces"], there["faces"])
    for name in ("points", "image", "scale", "area"):
        assert np.abs(here[name] - there[name]).max() <= 2, name
    for most in (10_000, 300):
        head = re.search(r'id="scene-head">(.*?)</script>', page(moved, most=most).decode())[1]
        json.loads(head, parse_constant=pytest.fail)  # neither NaN nor Infinity


def test_edges_are_seams_or_ends_or_neither():
    faces, patch = np.array([[0, 1, 2], [2, 1, 3], [4, 2, 3]]), np.array([0, 0, 7])
    bits = _edges(faces, patch)
    assert bits[0] == 8 + 32  # 01 and 20 are ends, 12 is inside its patch
    assert bits[1] == 4 + 16  # 21 inside, 13 an end, 32 a seam
    assert bits[2] == 2 + 8 + 32  # 42 and 34 are ends, 23 the seam


@pytest.mark.parametrize("kind", ["plane", "ball"])
@pytest.mark.parametrize("most", [700, 150])
def test_a_large_surface_is_drawn_with_fewer_faces_that_keep_their_place_in_both(kind, most, request):
    result = request.getfixturevalue(kind)
    scene = scene_of(result, most)
    assert most / 4 < len(scene.faces) <= most
    assert (np.sort(scene.faces, axis=1)[:, 1:] != np.sort(scene.faces, axis=1)[:, :-1]).all()
    # where a point of the few faces is on the map is near where the surface is mapped there
    side = np.sqrt(6.0 * np.ptp(result.mesh.vertices, axis=0).max() ** 2 / len(scene.faces))
    corners = result.mesh.vertices[result.mesh.faces[scene.face_ids]]
    assert np.linalg.norm(scene.points[scene.faces] - corners, axis=-1).max() < 2.0 * side
    here = np.linalg.norm(scene.image[scene.faces] - result.coordinates[result.mesh.faces[scene.face_ids]], axis=-1)
    assert here.max() < 2.0 * side * np.exp(result.log_scale.max())
    found = unpacked(packed(result, scene))
    assert np.array_equal(found["ids"][:, 0], scene.face_ids)
    assert np.array_equal(found["patch"][:, 0], result.patch[scene.face_ids])
    assert f"Drawn with {len(scene.faces):,} of {len(result.mesh.faces):,} faces" in page(result, most=most).decode()


def test_the_two_sides_of_a_thin_sheet_stay_apart():
    flat, _ = spheroid(4, 1.0)
    sheet = pgcp.Mesh(flat.vertices * [1, 1, 0.001], flat.faces, "sheet")
    result = replace(pgcp.parameterize(flat, patches=2, target="sphere"), mesh=sheet)
    scene = scene_of(result, 600)
    # each few vertices have one place on the sphere: their mean is not far inside it
    edges = np.linalg.norm(scene.image[scene.faces] - np.roll(scene.image[scene.faces], 1, axis=1), axis=-1)
    assert edges.max() < 0.9


def test_names_and_commands_are_escaped(plane, tmp_path):
    result = replace(plane, mesh=replace(plane.mesh, name=NASTY))
    text = page(result, ("pgcp-run", NASTY, "\udcff.ply")).decode()
    assert "<img" not in text
    assert text.count("</script>") == text.count("<script")
    assert text.count(str(escape(NASTY))) == 3  # title, heading and command
    assert not re.search(r'(src|href)="(?!data:)|https?:|@import|url\(', text)


def test_the_command_or_the_call_that_made_a_map_is_named(plane):
    assert (
        "pgcp-run &#39;my mesh.ply&#39; --target free" in page(plane, ("pgcp-run", "my mesh.ply", "--target", "free")).decode()
    )
    assert re.search(r"pgcp\.parameterize\(&#39;.*&#39;, patches=4\)</pre>", plane.page())


def test_tasks_are_rows_of_their_workers():
    stages = [
        {"name": "read", "begin": 0.0, "seconds": 1.0, "peak_bytes": 5 * 10**8},
        {"name": "solve", "begin": 1.0, "seconds": 3.0, "peak_bytes": 10**9},
    ]
    times = [(1, 1.0, 1.0), (2, 1.0, 2.0), (1, 2.0, 1.5), (0, 1.0, 2.0), (0, 1.5, 2.0)]
    tasks = [{"stage": "solve", "worker": w, "begin": b, "seconds": s} for w, b, s in times]
    drawn = timeline({"stages": stages, "timeline": tasks})
    assert [(row["label"], len(row["bars"])) for row in drawn["rows"]] == [
        ("stages", 2), ("thread 1", 1), ("thread 2", 1), ("worker 1", 2), ("worker 2", 1),
    ]  # fmt: skip
    for row in drawn["rows"]:
        for left, right in zip(row["bars"], row["bars"][1:], strict=False):
            assert left["x"] + left["width"] <= right["x"] + 1e-6
    first, second = drawn["rows"][0]["bars"]
    assert second["width"] == pytest.approx(3 * first["width"], abs=0.1)
    assert "1.00 GB" in drawn["memory"]["label"]
    assert timeline({}) is None


def test_a_timeline_of_very_many_tasks_says_what_it_leaves_out():
    stages = [{"name": "solve", "begin": 0.0, "seconds": 9.0, "peak_bytes": 0}]
    tasks = [{"stage": "solve", "worker": 1 + k % 80, "begin": k * 1e-3, "seconds": 1.0 + k * 1e-6} for k in range(5000)]
    drawn = timeline({"stages": stages, "timeline": tasks})
    assert len(drawn["rows"]) == 64
    assert drawn["left_out"].startswith("Not shown: the 1,000 shortest tasks and ")
    assert drawn["memory"] is None


TRIED = {"patches": 4, "seed": 0, "route": "weld", "folds": 3, "reason": "seams cross"}
REPAIRED = {"method": "relax", "rings": 1, "folds_before": 5, "folds_after": 0, "moved_vertices": 9}
IN_PLACE = {"from": "free", "to": "disk", "reason": "it overlaps"}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"retries": [TRIED]}, "Attempt 1, with 4 patches and seed 0, which left 3 folds, did not serve: seams cross."),
        ({"repairs": [REPAIRED]}, "Repaired by relax: 5 folds to 0."),
        ({"fallback": IN_PLACE}, "Instead of free, mapped to disk: it overlaps."),
        ({"fixes": [{"message": "3 faces dropped"}]}, "The mesh was mended: 3 faces dropped."),
        ({}, "The first attempt served; nothing had to be tried again or repaired."),
    ],
)
def test_what_happened_is_said_in_words(plane, change, said):
    assert said in course(replace(plane, report={**plane.report, **change}))


def test_every_task_of_a_run_is_on_the_timeline(plane):
    tasks = plane.report["timeline"]
    assert {stage: sum(task["stage"] == stage for task in tasks) for stage in plane.report["tasks"]} == {
        stage: taken["count"] for stage, taken in plane.report["tasks"].items()
    }
    spans = {stage["name"]: (stage["begin"], stage["begin"] + stage["seconds"]) for stage in plane.report["stages"]}
    assert all(left[1] <= right[0] + 1e-3 for left, right in zip(spans.values(), [*spans.values()][1:], strict=False))
    for task in tasks:
        begin, end = spans[task["stage"]]
        assert begin - 0.05 <= task["begin"] <= task["begin"] + task["seconds"] <= end + 0.05


def test_the_page_of_fifty_thousand_vertices_is_small():
    mesh = grid(225, jitter=0.2)
    rough = pgcp.Mesh(mesh.vertices + np.random.default_rng(0).normal(0.0, 1e-4, mesh.vertices.shape), mesh.faces, "rough")
    few = pgcp.parameterize(grid(4), patches=1)
    result = replace(
        few,
        mesh=rough,
        coordinates=mesh.vertices[:, :2].copy(),
        patch=np.zeros(len(mesh.faces), int),
        mu=np.zeros(len(mesh.faces), complex),
    )
    assert len(mesh.vertices) > 50_000
    assert len(page(result)) < 3_000_000


@pytest.fixture
def mesh_file(tmp_path):
    pgcp.write_mesh(tmp_path / "hills.ply", lifted(grid(12)))
    return tmp_path / "hills.ply"


def test_the_command_writes_a_page_unless_told_otherwise(mesh_file, tmp_path, monkeypatch):
    def wrote(*words):
        out = tmp_path / "out"
        assert command.main([str(mesh_file), "--patches", "2", "--quiet", "--no-png", "--output-dir", str(out), *words]) == 0
        report = json.loads((out / "report.json").read_text())
        assert ("hills.html" in report["files"]) == (out / "hills.html").exists()
        return (out / "hills.html").exists()

    assert wrote()
    assert "pgcp-run" in (tmp_path / "out" / "hills.html").read_text()
    assert not wrote("--no-html")
    monkeypatch.setattr(command, "PAGE_VERTICES", 100)
    assert not wrote()
    assert wrote("--html")


def test_a_page_alone_is_written_by_its_suffix(mesh_file, tmp_path):
    wanted = tmp_path / "here" / "Seite.HTML"
    assert command.main([str(mesh_file), "--patches", "2", "--quiet", "-o", str(wanted)]) == 0
    assert wanted.read_bytes().startswith(b"<!DOCTYPE html>")
    assert [path.name for path in wanted.parent.iterdir()] == ["Seite.HTML"]


@pytest.fixture(scope="module")
def browser():
    with headless() as found:
        yield found


def pixels(page, selector):
    return np.asarray(Image.open(io.BytesIO(page.locator(selector).screenshot())).convert("RGB")).astype(int)


def share(image, colour, reach=40):
    """How much of an image has about this colour."""
    return float((np.abs(image - np.array(colour)).max(axis=-1) < reach).mean())


def middle(page, selector):
    box = page.locator(selector).bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


@pytest.mark.parametrize("kind", ["plane", "ball"])
def test_a_browser_shows_the_checkerboard_and_lights_a_face_in_both_views(kind, request, browser, tmp_path):
    result = request.getfixturevalue(kind)
    (tmp_path / "page.html").write_bytes(page(result))
    with opened(browser, tmp_path / "page.html") as shown:
        for view in ("#surface", "#map"):
            image = pixels(shown, view)
            assert share(image, BLUE, 60) > 0.05
            assert share(image, CREAM, 60) > 0.05
        shown.mouse.move(*middle(shown, "#surface"))
        shown.wait_for_function("document.body.dataset.face")
        face = int(shown.locator("body").get_attribute("data-face"))
        for view in ("#surface", "#map"):
            assert shown.locator(f"{view} .ring").is_visible()
            assert share(pixels(shown, view), CYAN, 30) > 1e-4
        assert f"face {face}, patch {result.patch[face]}" in shown.inner_text("#said")
        if "behind" not in shown.locator("#map .ring").get_attribute("class"):
            shown.mouse.move(*middle(shown, "#map .ring"))
            shown.wait_for_timeout(200)
            assert int(shown.locator("body").get_attribute("data-face")) == face
        shown.mouse.move(2, 2)
        shown.wait_for_function("!document.body.dataset.face")
        assert not shown.locator("#map .ring").is_visible()
        assert shown.said == []


def test_a_face_under_the_pointer_is_the_one_that_lies_there(plane, browser, tmp_path):
    (tmp_path / "page.html").write_bytes(page(plane))
    with opened(browser, tmp_path / "page.html") as shown:
        seen = set()
        for share_x in (0.35, 0.5, 0.6):
            box = shown.locator("#map").bounding_box()
            shown.mouse.move(box["x"] + share_x * box["width"], box["y"] + 0.45 * box["height"])
            shown.wait_for_timeout(200)
            face = int(shown.locator("body").get_attribute("data-face"))
            seen.add(face)
            shown.mouse.move(*middle(shown, "#surface .ring"))
            shown.wait_for_timeout(200)
            assert int(shown.locator("body").get_attribute("data-face")) == face
        assert len(seen) == 3


def test_a_click_changes_what_is_shown_and_dragging_turns_the_surface(plane, browser, tmp_path):
    (tmp_path / "page.html").write_bytes(page(plane))
    with opened(browser, tmp_path / "page.html") as shown:
        before = {"checker": pixels(shown, "#map")}
        for mode in ("angle", "area", "patch", "plain"):
            shown.click(f"button[data-mode={mode}]")
            shown.mouse.move(2, 2)
            shown.wait_for_timeout(150)
            assert shown.locator(f"button[data-mode={mode}]").get_attribute("aria-pressed") == "true"
            assert shown.locator(f"[data-legend={mode}]").is_visible()
            image = pixels(shown, "#map")
            assert all(np.abs(image - other).mean() > 1.0 for other in before.values()), mode
            before[mode] = image
        for name in ("seams", "edges"):
            shown.check(f"#{name}")
            shown.wait_for_timeout(150)
            assert np.abs(pixels(shown, "#map") - before["plain"]).mean() > 0.3
            shown.uncheck(f"#{name}")
        unturned = pixels(shown, "#surface")
        x, y = middle(shown, "#surface")
        shown.mouse.move(x, y)
        shown.mouse.down()
        shown.mouse.move(x + 120, y + 40, steps=4)
        shown.mouse.up()
        shown.mouse.move(2, 2)
        shown.wait_for_timeout(200)
        assert np.abs(pixels(shown, "#surface") - unturned).mean() > 2.0
        shown.click("#reset")
        shown.mouse.move(2, 2)
        shown.wait_for_timeout(200)
        assert np.abs(pixels(shown, "#surface") - unturned).mean() < 0.5
        assert shown.said == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_name_of_any_script_is_shown_as_it_is(plane, scheme, browser, tmp_path):
    (tmp_path / "page.html").write_bytes(page(replace(plane, mesh=replace(plane.mesh, name=NASTY)), ("pgcp-run", NASTY)))
    with opened(browser, tmp_path / "page.html", scheme) as shown:
        assert shown.inner_text("h1") == NASTY
        assert NASTY in shown.inner_text("#command")
        assert shown.locator("img").count() == 0
        corner = np.asarray(Image.open(io.BytesIO(shown.screenshot())).convert("RGB"))[2, 2]
        assert (corner.mean() > 200) == (scheme == "light")
        assert shown.said == []


def test_without_webgl_the_page_says_so_and_shows_the_figures(plane, browser, tmp_path):
    text = (
        page(plane).decode().replace("<head>", "<head><script>HTMLCanvasElement.prototype.getContext = () => null</script>", 1)
    )
    (tmp_path / "page.html").write_text(text)
    with opened(browser, tmp_path / "page.html") as shown:
        assert "cannot be drawn here (no WebGL 2)" in shown.inner_text("#no-views")
        assert f"{plane.quality.angle_mean_deg:.4f}°" in shown.inner_text("table")
        assert shown.said == []


def test_a_narrow_page_has_the_views_below_each_other(plane, browser, tmp_path):
    (tmp_path / "page.html").write_bytes(page(plane))
    with opened(browser, tmp_path / "page.html") as shown:
        shown.set_viewport_size({"width": 400, "height": 800})
        shown.wait_for_timeout(300)
        above, below = (shown.locator(view).bounding_box() for view in ("#surface", "#map"))
        assert above["y"] + above["height"] <= below["y"]
        assert shown.evaluate("document.documentElement.scrollWidth") <= 400
        for view in ("#surface", "#map"):
            assert share(pixels(shown, view), BLUE, 60) > 0.05
