// What the page does: draws both views, lights the face under the pointer in both, and changes what is shown.

const MODES = ["checker", "angle", "area", "patch", "plain"];
const byId = (id) => document.getElementById(id);

async function begin() {
  const head = JSON.parse(byId("scene-head").textContent);
  const scene = geometry(head, await unpack(head, byId("scene-data").textContent));
  const canvas = byId("canvas"), views = [byId("surface"), byId("map")];
  const painter = new Painter(canvas, head, scene), gl = painter.gl;
  const look = { mode: 0, hovered: -1, seams: false, edges: false };
  let asked = false, pointer = null;
  const redraw = () => { if (!asked) { asked = true; requestAnimationFrame(draw); } };
  const c = Math.cos(head.upright), s = Math.sin(head.upright);
  const onMap = head.closed ? head.turn : [c, -s, 0, s, c, 0, 0, 0, 1];
  const cameras = [new Camera(views[0], scene.point, head.turn, true, redraw), new Camera(views[1], scene.image, onMap, head.closed, redraw)];

  function draw() {
    asked = false;
    if (pointer) hover();
    const sharp = Math.min(window.devicePixelRatio || 1, 2), all = canvas.getBoundingClientRect();
    const [width, height] = [Math.round(all.width * sharp), Math.round(all.height * sharp)];
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    gl.enable(gl.SCISSOR_TEST);
    views.forEach((view, k) => {
      const box = view.getBoundingClientRect();
      const at = [box.left - all.left, all.bottom - box.bottom, box.width, box.height].map((x) => Math.round(x * sharp));
      gl.viewport(...at);
      gl.scissor(...at);
      painter.draw(cameras[k], k === 1, [1, 1, 0, 0], look);
    });
    mark();
  }
  /** Find the face under the pointer, and say what it is. */
  function hover() {
    const { view, at } = pointer, box = views[view];
    pointer = null;
    look.hovered = painter.pick(cameras[view], view === 1, at, [box.clientWidth, box.clientHeight]);
    const f = look.hovered;
    document.body.dataset.face = f < 0 ? "" : scene.id(f);
    if (f < 0) { byId("said").textContent = byId("said").dataset.none; return; }
    const [angle, area, patchId] = scene.figures.subarray(4 * f, 4 * f + 3);
    const ratio = 2 ** area;
    byId("said").textContent = `face ${scene.id(f)}, patch ${patchId}: angle error ${angle.toPrecision(3)}°, `
      + `area in the map / on the surface ${ratio >= 0.01 && ratio < 1000 ? ratio.toPrecision(3) : ratio.toExponential(1)}`;
  }
  /** Rings around the face in both views, as it may be too small to be seen; dashed where it looks away. */
  function mark() {
    const f = look.hovered;
    views.forEach((view, k) => {
      const ring = view.querySelector(".ring");
      ring.hidden = f < 0;
      if (f < 0) return;
      const data = (k ? scene.image : scene.point).subarray(9 * f, 9 * f + 9);
      const middle = [0, 1, 2].map((d) => (data[d] + data[3 + d] + data[6 + d]) / 3);
      const [x, y] = cameras[k].onScreen(middle);
      ring.style.left = `${x}%`;
      ring.style.top = `${y}%`;
      const normals = (k ? scene.image : scene.normal).subarray(9 * f, 9 * f + 9), turn = cameras[k].turn;
      const facing = [0, 1, 2].reduce((sum, d) => sum + turn[6 + d] * (normals[d] + normals[3 + d] + normals[6 + d]), 0);
      ring.classList.toggle("behind", facing < 0 && (k === 0 || head.closed));
    });
  }
  function choose(mode) {
    look.mode = MODES.indexOf(mode);
    document.body.dataset.mode = mode;
    for (const button of document.querySelectorAll("button[data-mode]")) button.setAttribute("aria-pressed", button.dataset.mode === mode);
    for (const legend of document.querySelectorAll("[data-legend]")) legend.hidden = legend.dataset.legend !== mode;
    redraw();
  }
  views.forEach((view, k) => {
    view.addEventListener("pointermove", (event) => {
      if (event.buttons && event.pointerType === "mouse") return;
      pointer = { view: k, at: cameras[k].at(event) };
      redraw();
    });
    view.addEventListener("pointerdown", (event) => { pointer = { view: k, at: cameras[k].at(event) }; redraw(); });
    view.addEventListener("pointerleave", () => { pointer = { view: k, at: [9, 9] }; redraw(); });
  });
  for (const button of document.querySelectorAll("button[data-mode]")) button.addEventListener("click", () => choose(button.dataset.mode));
  for (const name of ["seams", "edges"]) byId(name).addEventListener("change", (event) => { look[name] = event.target.checked; redraw(); });
  byId("reset").addEventListener("click", () => { cameras.forEach((camera) => camera.reset()); redraw(); });
  new ResizeObserver(redraw).observe(canvas);
  canvas.addEventListener("webglcontextlost", () => fail("the browser has taken the graphics memory back; load the page again"));
  choose("checker");
  document.body.dataset.ready = "yes";
}

function fail(reason) {
  byId("views").hidden = true;
  byId("no-views").hidden = false;
  byId("no-views").textContent = `The surface cannot be drawn here (${reason}). It needs a browser with WebGL 2; all figures are below.`;
}

begin().catch((problem) => fail(problem.message));
