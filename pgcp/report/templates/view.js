"use strict";
// The two views of the page: the surface, which turns, and its map. WebGL 2, no library.

const VERTEX = `#version 300 es
in vec3 point, normal, image;
in float scale;
uniform bool onMap;
uniform mat3 turn;
uniform vec3 centre;
uniform vec4 place;   // scale of x, y; shift of x, y
uniform vec4 close;   // the same once more: a single pixel is drawn as large as the view, to see which face it shows
uniform float depth;
out vec3 vNormal, vImage, corner;
out float vScale;
flat out int face;
void main() {
  face = gl_VertexID / 3;
  corner = vec3(equal(ivec3(gl_VertexID % 3), ivec3(0, 1, 2)));
  vNormal = turn * (onMap ? image : normal);
  vImage = image;
  vScale = scale;
  vec3 seen = turn * ((onMap ? image : point) - centre);
  gl_Position = vec4((seen.xy * place.xy + place.zw) * close.xy + close.zw, -seen.z * depth, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
in vec3 vNormal, vImage, corner;
in float vScale;
flat in int face;
uniform int mode, hovered;   // mode: as in MODES, -1 to name the face in a colour
uniform bool isLit, onSphere, withSeams, withEdges;
uniform vec2 angles, areas;  // limit; middle and limit
uniform vec3 heat[5], coldWarm[5], dark, light;
uniform sampler2D figures, palette;
out vec4 colour;

vec3 between(vec3 stops[5], float value) {
  float at = clamp(value, 0.0, 1.0) * 4.0;
  int k = min(int(at), 3);
  return mix(stops[k], stops[k + 1], at - float(k));
}
float stripes(float u, float width, float size) {  // 0 and 1 in turns, smooth over a pixel
  float w = clamp(width / (2.0 * size), 1e-4, 0.5);
  float wave = abs(fract(u / (2.0 * size)) - 0.5) - 0.25;
  return clamp(wave / w + 0.5, 0.0, 1.0);
}
float squares(vec2 uv, vec2 width, float size) {
  float a = stripes(uv.x, width.x, size), b = stripes(uv.y, width.y, size);
  return a + b - 2.0 * a * b;
}
float darkness(vec2 uv, vec2 width, float s) {  // squares double where the map's scale does, fading over half the way
  float level = floor(s), share = smoothstep(0.25, 0.75, s - level), size = exp2(level);
  return mix(squares(uv, width, size), squares(uv, width, 2.0 * size), share);
}
vec3 checkers() {
  vec2 uv = vImage.xy, width = fwidth(vImage.xy);
  float s = vScale;
  if (onSphere) {  // by the conformal Mercator map, in turns
    vec3 p = normalize(vImage);
    float across = max(length(p.xy), 1e-12), turn = 6.283185307;
    uv = vec2(atan(p.y, p.x), asinh(p.z / across)) / turn;
    width = vec2(min(fwidth(uv.x), fwidth(fract(uv.x + 1.0))), fwidth(uv.y));
    s = min(vScale - log2(across * turn), -2.0);
  }
  return mix(light, dark, darkness(uv, width, s));
}
void main() {
  if (mode == -1) {
    int id = face + 1;
    colour = vec4(id & 255, (id >> 8) & 255, (id >> 16) & 255, 255) / 255.0;
    return;
  }
  ivec2 size = textureSize(figures, 0);
  vec4 of = texelFetch(figures, ivec2(face % size.x, face / size.x), 0);
  int across = textureSize(palette, 0).x, patchId = int(of.z);
  vec3 checked = checkers();  // slopes are known only where all pixels go the same way
  vec3 c = mode == 0 ? checked
    : mode == 1 ? between(heat, of.x / angles.x)
    : mode == 2 ? between(coldWarm, 0.5 + 0.5 * (of.y - areas.x) / areas.y)
    : mode == 3 ? texelFetch(palette, ivec2(patchId % across, patchId / across), 0).rgb
    : vec3(0.86, 0.84, 0.80);
  if (isLit) {
    vec3 n = normalize(vNormal + vec3(0, 0, 1e-9));
    if (n.z < 0.0) n = -n;
    vec3 lamp = vec3(0.35, 0.55, 0.758);
    float gloss = 0.1 * pow(max(dot(n, normalize(lamp + vec3(0, 0, 1))), 0.0), 24.0);
    c = c * (0.42 + 0.48 * max(dot(n, lamp), 0.0) + 0.14 * n.z) + gloss;
  }
  vec3 tall = 1.0 / max(fwidth(corner.zxy), 1e-6), away = corner.zxy * tall;  // pixels: heights over, and from, edges 01, 12, 20
  float dense = smoothstep(2.0, 8.0, min(tall.x, min(tall.y, tall.z)));  // edges of tiny faces would be all that is seen
  if (withEdges) c = mix(c, vec3(0.1), 0.5 * dense * (1.0 - smoothstep(0.3, 1.1, min(away.x, min(away.y, away.z)))));
  if (withSeams) {
    int bits = int(of.w);
    float nearest = 9.0;
    for (int k = 0; k < 3; k++) if (((bits >> k) & 9) != 0) nearest = min(nearest, away[k]);
    c = mix(c, vec3(0.75, 0.05, 0.15), 1.0 - smoothstep(1.2, 2.2, nearest));
  }
  if (face == hovered) c = vec3(0.0, 0.9, 1.0);
  colour = vec4(c, 1.0);
}`;

/** Numbers of a scene by name, from base64 of deflated byte planes (pgcp/report/scene.py has the other direction). */
async function unpack(head, text) {
  const bytes = Uint8Array.from(atob(text.trim()), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const out = {};
  let at = 0;
  for (const { name, shape: [rows, columns], delta } of head.arrays) {
    const count = rows * columns, values = new Int32Array(count);
    for (let column = 0, k = 0; column < columns; column++) {
      for (let row = 0, sum = 0; row < rows; row++, k++) {
        const whole = planes[at + k] | planes[at + count + k] << 8 | planes[at + 2 * count + k] << 16 | planes[at + 3 * count + k] << 24;
        const step = whole >>> 1 ^ -(whole & 1);
        sum = delta ? sum + step : step;
        values[row * columns + column] = sum;
      }
    }
    out[name] = values;
    at += 4 * count;
  }
  return out;
}

/** What is drawn of a scene, corner by corner, and what is known of its faces. */
function geometry(head, packed) {
  const faces = packed.faces, corners = faces.length, count = corners / 3;
  for (let k = 0, next = 0; k < corners; k++) {
    faces[k] = next - faces[k];
    if (faces[k] === next) next++;
  }
  const placed = (values, box, columns) => Float32Array.from(values, (v, k) => box.low[k % columns] + box.step * v);
  const planar = head.image.low.length;
  const points = placed(packed.points, head.points, 3), image = placed(packed.image, head.image, planar);
  const normals = new Float32Array(points.length);
  for (let f = 0; f < corners; f += 3) {
    const [a, b, c] = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]];
    const u = [0, 1, 2].map((d) => points[b + d] - points[a + d]), v = [0, 1, 2].map((d) => points[c + d] - points[a + d]);
    for (let d = 0; d < 3; d++) {
      const size = (u[(d + 1) % 3] * v[(d + 2) % 3] - u[(d + 2) % 3] * v[(d + 1) % 3]) / head.points.step ** 2;
      normals[a + d] += size; normals[b + d] += size; normals[c + d] += size;
    }
  }
  const out = { count, point: new Float32Array(3 * corners), normal: new Float32Array(3 * corners), image: new Float32Array(3 * corners), scale: new Float32Array(corners) };
  for (let k = 0; k < corners; k++) {
    const v = faces[k];
    for (let d = 0; d < 3; d++) {
      out.point[3 * k + d] = points[3 * v + d];
      out.normal[3 * k + d] = normals[3 * v + d];
      if (d < planar) out.image[3 * k + d] = image[planar * v + d];
    }
    out.scale[k] = packed.scale[v] / head.halves;
  }
  const rows = Math.ceil(count / 1024);
  out.figures = new Float32Array(4 * 1024 * rows);
  for (let f = 0; f < count; f++) {
    const angle = head.angle_max * (packed.angle[f] / 65535) ** 2;
    out.figures.set([angle, packed.area[f] / head.halves, packed.patch[f], packed.edges[f]], 4 * f);
  }
  out.id = (f) => packed.ids ? packed.ids[f] : f;
  return out;
}

const times = (a, b) => [0, 3, 6].flatMap((row) => [0, 1, 2].map((k) => a[row] * b[k] + a[row + 1] * b[3 + k] + a[row + 2] * b[6 + k]));

/** A rotation (by rows) turned by so many radians around the vertical and the horizontal of the screen. */
function turned(rotation, x, y) {
  const [c, s, d, t] = [Math.cos(x), Math.sin(x), Math.cos(y), Math.sin(y)];
  return times([1, 0, 0, 0, d, -t, 0, t, d], times([c, 0, s, 0, 1, 0, -s, 0, c], rotation));
}

/** Where one of the two views looks from; turned, moved and zoomed by mouse, fingers and keys. */
class Camera {
  constructor(element, data, start, turns, redraw) {
    Object.assign(this, { element, turns, start, redraw });
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (let k = 0; k < data.length; k++) {
      if (data[k] < low[k % 3]) low[k % 3] = data[k];
      if (data[k] > high[k % 3]) high[k % 3] = data[k];
    }
    this.centre = low.map((x, d) => 0.5 * (x + high[d]));
    let reach = 1e-30, wide = 1e-30, tall = 1e-30;
    for (let k = 0; k < data.length; k += 3) {
      const [x, y, z] = this.seen([data[k], data[k + 1], data[k + 2]], start);
      reach = Math.max(reach, x * x + y * y + z * z);
      wide = Math.max(wide, Math.abs(x));
      tall = Math.max(tall, Math.abs(y));
    }
    Object.assign(this, { wide, tall, depth: 0.99 / Math.sqrt(reach) });
    this.reset();
    this.pointers = new Map();
    element.addEventListener("pointerdown", (event) => this.down(event));
    element.addEventListener("pointermove", (event) => this.move(event));
    for (const end of ["pointerup", "pointercancel"]) element.addEventListener(end, (event) => this.pointers.delete(event.pointerId));
    element.addEventListener("wheel", (event) => { event.preventDefault(); this.zoomAt(event, Math.exp(-0.0015 * event.deltaY)); }, { passive: false });
    element.addEventListener("dblclick", () => { this.reset(); redraw(); });
    element.addEventListener("keydown", (event) => this.key(event));
    element.addEventListener("contextmenu", (event) => event.preventDefault());
  }
  reset() { this.turn = this.start; this.zoom = 1; this.shift = [0, 0]; }
  seen(p, turn = this.turn) {
    const q = p.map((x, d) => x - this.centre[d]);
    return [0, 3, 6].map((row) => turn[row] * q[0] + turn[row + 1] * q[1] + turn[row + 2] * q[2]);
  }
  /** Scale and shift from what is seen to the view, which reaches from -1 to 1. */
  get place() {
    const { clientWidth: w, clientHeight: h } = this.element;
    const pixels = 0.46 * this.zoom * Math.min(w / this.wide, h / this.tall);
    return [2 * pixels / w, 2 * pixels / h, ...this.shift];
  }
  at(event) {
    const box = this.element.getBoundingClientRect();
    return [2 * (event.clientX - box.left) / box.width - 1, 1 - 2 * (event.clientY - box.top) / box.height];
  }
  onScreen(p) {
    const [x, y] = this.seen(p), [a, b, c, d] = this.place;
    return [50 * (1 + x * a + c), 50 * (1 - y * b - d)];
  }
  zoomAt(event, factor) {
    const at = this.at(event), zoom = Math.min(Math.max(this.zoom * factor, 0.2), 1e5);
    this.shift = this.shift.map((s, d) => at[d] + (s - at[d]) * zoom / this.zoom);
    this.zoom = zoom;
    this.redraw();
  }
  down(event) {
    this.element.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, event);
  }
  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    this.pointers.set(event.pointerId, event);
    const x = event.clientX - before.clientX, y = event.clientY - before.clientY, size = this.element.clientHeight;
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const apart = (e) => Math.hypot(e.clientX - other.clientX, e.clientY - other.clientY);
      this.zoomAt(other, apart(event) / Math.max(apart(before), 1));
    } else if (this.turns && !event.shiftKey && !(event.buttons & 2)) {
      this.turn = turned(this.turn, 4 * x / size, 4 * y / size);
    } else {
      this.shift = [this.shift[0] + 2 * x / this.element.clientWidth, this.shift[1] - 2 * y / size];
    }
    this.redraw();
  }
  key(event) {
    const [x, y] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key] ?? [0, 0];
    if (x || y) {
      event.preventDefault();
      if (this.turns) this.turn = turned(this.turn, 0.1 * x, 0.1 * y);
      else this.shift = [this.shift[0] - 0.1 * x, this.shift[1] + 0.1 * y];
    } else if (event.key === "+" || event.key === "=") this.zoom *= 1.25;
    else if (event.key === "-") this.zoom /= 1.25;
    else if (event.key === "0") this.reset();
    else return;
    this.redraw();
  }
}

/** Program, buffers and textures of a scene. */
class Painter {
  constructor(canvas, head, scene) {
    const gl = canvas.getContext("webgl2", { antialias: true });
    if (!gl) throw new Error("no WebGL 2");
    Object.assign(this, { gl, head, scene, uniforms: {} });
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    gl.useProgram(program);
    for (const [name, size] of [["point", 3], ["normal", 3], ["image", 3], ["scale", 1]]) {
      const where = gl.getAttribLocation(program, name);
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, scene[name], gl.STATIC_DRAW);
      gl.enableVertexAttribArray(where);
      gl.vertexAttribPointer(where, size, gl.FLOAT, false, 0, 0);
    }
    for (let k = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS) - 1; k >= 0; k--) {
      const name = gl.getActiveUniform(program, k).name;
      this.uniforms[name.replace("[0]", "")] = gl.getUniformLocation(program, name);
    }
    this.texture(0, gl.RGBA32F, 1024, gl.RGBA, gl.FLOAT, scene.figures, 4);
    const rows = Math.ceil(head.palette.length / 1024), colours = new Uint8Array(3 * 1024 * rows);
    colours.set(head.palette.flat());
    this.texture(1, gl.RGB8, 1024, gl.RGB, gl.UNSIGNED_BYTE, colours, 3);
    const u = this.uniforms;
    gl.uniform1i(u.figures, 0);
    gl.uniform1i(u.palette, 1);
    gl.uniform2f(u.angles, head.angle_limit, 0);
    gl.uniform2f(u.areas, head.area_middle, head.area_limit);
    gl.uniform3fv(u.heat, head.heat.flat());
    gl.uniform3fv(u.coldWarm, head.cold_warm.flat());
    gl.uniform3fv(u.dark, head.dark);
    gl.uniform3fv(u.light, head.light);
    gl.uniform1i(u.onSphere, head.closed);
    gl.enable(gl.DEPTH_TEST);
    this.small = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.small);
    for (const [format, what] of [[gl.RGBA8, gl.COLOR_ATTACHMENT0], [gl.DEPTH_COMPONENT16, gl.DEPTH_ATTACHMENT]]) {
      gl.bindRenderbuffer(gl.RENDERBUFFER, gl.createRenderbuffer());
      gl.renderbufferStorage(gl.RENDERBUFFER, format, 1, 1);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, what, gl.RENDERBUFFER, gl.getParameter(gl.RENDERBUFFER_BINDING));
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }
  texture(unit, kind, width, format, type, data, channels) {
    const gl = this.gl;
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, kind, width, data.length / channels / width, 0, format, type, data);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
  }
  draw(camera, onMap, close, look) {
    const { gl, uniforms: u } = this;
    gl.uniform1i(u.onMap, onMap);
    gl.uniformMatrix3fv(u.turn, true, camera.turn);
    gl.uniform3fv(u.centre, camera.centre);
    gl.uniform4fv(u.place, camera.place);
    gl.uniform4fv(u.close, close);
    gl.uniform1f(u.depth, camera.depth);
    gl.uniform1i(u.mode, look.mode);
    gl.uniform1i(u.hovered, look.hovered);
    gl.uniform1i(u.isLit, !onMap || this.head.closed);
    gl.uniform1i(u.withSeams, look.seams);
    gl.uniform1i(u.withEdges, look.edges);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.drawArrays(gl.TRIANGLES, 0, 3 * this.scene.count);
  }
  /** The face that a place of a view (-1 to 1) shows, -1 for none. */
  pick(camera, onMap, [x, y], [w, h]) {
    const gl = this.gl, seen = new Uint8Array(4);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.small);
    gl.disable(gl.SCISSOR_TEST);
    gl.viewport(0, 0, 1, 1);
    this.draw(camera, onMap, [w, h, -x * w, -y * h], { mode: -1, hovered: -1 });
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, seen);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return (seen[0] | seen[1] << 8 | seen[2] << 16) - 1;
  }
}
