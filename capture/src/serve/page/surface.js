// The surface seen so far, drawn from the camera's place: surfels as discs, tinted by the weight of what was seen.

const SIDE = 4; // Blocks along the edge of a group; a group is one buffer and one draw.
const VERTEX = 12; // Bytes of a surfel in a buffer.

const VERTEX_SHADER = `#version 300 es
layout(location = 0) in vec3 place;   // in the group, a block is 255
layout(location = 1) in float weight; // 32 log2(1 + w)
layout(location = 2) in vec2 folded;  // octahedral normal
uniform mat4 camera_from_world;
uniform vec3 group;
uniform float edge, cell, good;
uniform vec4 lens;                    // fx, fy, cx, cy, in pixels of the picture
uniform vec2 size;                    // of the picture
uniform float scale;                  // pixels of the canvas per pixel of the picture
uniform float k[5];
out vec3 tint;
void main() {
  vec3 world = (group * ${SIDE}.0 + place / 255.0) * edge;
  vec3 p = (camera_from_world * vec4(world, 1.0)).xyz;
  vec3 n = vec3(folded, 1.0 - abs(folded.x) - abs(folded.y));
  if (n.z < 0.0) n.xy = (1.0 - abs(n.yx)) * vec2(n.x < 0.0 ? -1.0 : 1.0, n.y < 0.0 ? -1.0 : 1.0);
  n = mat3(camera_from_world) * normalize(n);
  float facing = -dot(n, normalize(p));
  if (p.z < 0.05 || facing < 0.02) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
  vec2 x = p.xy / p.z;
  float r = dot(x, x);
  vec2 d = x * (1.0 + r * (k[0] + r * (k[1] + r * k[4])))
         + vec2(2.0 * k[2] * x.x * x.y + k[3] * (r + 2.0 * x.x * x.x), k[2] * (r + 2.0 * x.y * x.y) + 2.0 * k[3] * x.x * x.y);
  vec2 pixel = lens.xy * d + lens.zw + 0.5;
  vec2 at = vec2(2.0, -2.0) * pixel / size + vec2(-1.0, 1.0);
  gl_Position = vec4(at, p.z / 6.0 - 1.0, 1.0);
  gl_PointSize = clamp(1.6 * cell * lens.x / p.z * scale, 2.0, 64.0);
  float seen = smoothstep(0.2 * good, good, exp2(weight / 32.0) - 1.0);
  tint = mix(vec3(1.0, 0.62, 0.27), vec3(0.31, 0.82, 0.71), seen) * (0.35 + 0.65 * facing);
}`;
const FRAGMENT_SHADER = `#version 300 es
precision mediump float;
in vec3 tint;
uniform float opacity;
out vec4 color;
void main() {
  vec2 p = gl_PointCoord - 0.5;
  if (dot(p, p) > 0.25) discard;
  color = vec4(tint * opacity, opacity);
}`;

function program(gl, vertex, fragment) {
  const p = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const s = gl.createShader(kind);
    gl.shaderSource(s, text);
    gl.compileShader(s);
    gl.attachShader(p, s);
  }
  gl.linkProgram(p);
  if (!gl.getProgramParameter(p, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(p));
  return p;
}

// An octahedral normal, as bytes of two's complement.
function normal(a, b) {
  let [x, y] = [a, b].map((v) => (v > 127 ? v - 256 : v) / 127);
  const z = 1 - Math.abs(x) - Math.abs(y);
  if (z < 0) [x, y] = [(1 - Math.abs(y)) * (x < 0 ? -1 : 1), (1 - Math.abs(x)) * (y < 0 ? -1 : 1)];
  const n = Math.hypot(x, y, z);
  return [x / n, y / n, z / n];
}

export class Surface {
  constructor(canvas) {
    this.canvas = canvas;
    this.blocks = new Map();
    this.generation = 0;
    this.change = 0;
    this.voxel = 0;
    this.surfels = 0;
    this.good = 0;
    this.opacity = 0.55;
    this.setUp();
    canvas.addEventListener("webglcontextlost", (e) => { e.preventDefault(); this.gl = null; });
    canvas.addEventListener("webglcontextrestored", () => this.setUp());
  }

  setUp() {
    const gl = this.gl = this.canvas.getContext("webgl2", { antialias: false });
    this.groups = new Map();
    for (const key of this.blocks.keys()) this.group(key).stale = true;
    if (!gl) return;
    this.program = program(gl, VERTEX_SHADER, FRAGMENT_SHADER);
    this.uniform = Object.fromEntries(["camera_from_world", "group", "edge", "cell", "good", "lens", "size", "scale", "k", "opacity"]
      .map((name) => [name, gl.getUniformLocation(this.program, name)]));
    gl.enable(gl.DEPTH_TEST);
  }

  compile(vertex, fragment) {
    return program(this.gl, vertex, fragment);
  }

  group(key) {
    const at = key.split(",").map((c) => Math.floor(c / SIDE));
    const name = at.join();
    let group = this.groups.get(name);
    if (!group) this.groups.set(name, group = { at, keys: new Set(), count: 0, stale: true });
    group.keys.add(key);
    return group;
  }

  clear() {
    for (const g of this.groups.values()) if (g.buffer) this.gl?.deleteBuffer(g.buffer);
    this.blocks.clear();
    this.groups.clear();
    this.change = this.surfels = 0;
  }

  // Takes an answer of /api/surface; returns its number of bytes.
  take(buffer) {
    const view = new DataView(buffer);
    if (buffer.byteLength < 24 || view.getUint32(0, true) !== 0x4652534c) return 0;
    const generation = view.getUint32(4, true);
    if (generation !== this.generation) this.clear();
    this.generation = generation;
    this.change = Number(view.getBigUint64(8, true));
    this.voxel = view.getFloat32(16, true);
    let at = 24;
    for (let n = view.getUint32(20, true); n > 0; n--) {
      const coord = [0, 4, 8].map((i) => view.getInt32(at + i, true));
      const count = view.getUint32(at + 12, true);
      const data = new Uint8Array(buffer.slice(at + 16, at + 16 + 8 * count));
      const key = coord.join();
      this.surfels += count - (this.blocks.get(key)?.data.length ?? 0) / 8;
      let sum = 0;
      for (let i = 7; i < data.length; i += 8) sum += data[i];
      this.blocks.set(key, { coord, data, weight: count ? 2 ** (sum / count / 32) - 1 : 0 });
      this.group(key).stale = true;
      at += 16 + 8 * count;
    }
    return buffer.byteLength;
  }

  upload(group) {
    const gl = this.gl;
    const all = [...group.keys].map((key) => this.blocks.get(key)).filter((b) => b && b.data.length);
    group.count = all.reduce((n, b) => n + b.data.length / 8, 0);
    group.stale = false;
    const out = new DataView(new ArrayBuffer(VERTEX * group.count));
    let at = 0;
    for (const { coord, data } of all) {
      const base = coord.map((c, i) => (c - SIDE * group.at[i]) * 255);
      for (let i = 0; i < data.length; i += 8, at += VERTEX) {
        for (let a = 0; a < 3; a++) out.setUint16(at + 2 * a, base[a] + data[i + 2 + a], true);
        out.setUint8(at + 6, data[i + 7]);
        out.setUint8(at + 8, data[i + 5]);
        out.setUint8(at + 9, data[i + 6]);
      }
    }
    group.buffer ??= gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, group.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, out, gl.DYNAMIC_DRAW);
  }

  blank() {
    this.gl?.clearColor(0, 0, 0, 0);
    this.gl?.clear(this.gl.COLOR_BUFFER_BIT);
  }

  // Draws from a camera: `camera` as /api/status has it, `pose` world_from_camera as 16 numbers, rows.
  draw(camera, pose) {
    const { gl, uniform } = this;
    if (!gl || !camera || !pose) return;
    const { width, height, fx, fy, cx, cy } = camera.intrinsics;
    const { k1, k2, p1, p2, k3 } = camera.distortion;
    const w = Math.min(1280, Math.round(this.canvas.clientWidth * devicePixelRatio)) || 320, h = Math.round(w * height / width);
    if (this.canvas.width !== w || this.canvas.height !== h) Object.assign(this.canvas, { width: w, height: h });
    gl.viewport(0, 0, w, h);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.useProgram(this.program);
    const r = (row, column) => pose[4 * row + column];
    const turned = [0, 1, 2].map((i) => -(r(0, i) * r(0, 3) + r(1, i) * r(1, 3) + r(2, i) * r(2, 3)));
    // Column by column, the inverse of a rigid transform.
    gl.uniformMatrix4fv(uniform.camera_from_world, false, [0, 1, 2].flatMap((c) => [r(c, 0), r(c, 1), r(c, 2), 0]).concat(turned, 1));
    gl.uniform1f(uniform.edge, 8 * this.voxel);
    gl.uniform1f(uniform.cell, 2 * this.voxel);
    gl.uniform1f(uniform.good, this.good || 12);
    gl.uniform4f(uniform.lens, fx, fy, cx, cy);
    gl.uniform2f(uniform.size, width, height);
    gl.uniform1f(uniform.scale, w / width);
    gl.uniform1f(uniform.opacity, this.opacity);
    // Where only the picture is shown, the surface still hides what is behind it.
    gl.colorMask(this.opacity > 0, this.opacity > 0, this.opacity > 0, this.opacity > 0);
    gl.uniform1fv(uniform.k, [k1, k2, p1, p2, k3]);
    for (const i of [0, 1, 2]) gl.enableVertexAttribArray(i);
    for (const group of this.groups.values()) {
      if (group.stale) this.upload(group);
      if (!group.count) continue;
      gl.bindBuffer(gl.ARRAY_BUFFER, group.buffer);
      gl.vertexAttribPointer(0, 3, gl.UNSIGNED_SHORT, false, VERTEX, 0);
      gl.vertexAttribPointer(1, 1, gl.UNSIGNED_BYTE, false, VERTEX, 6);
      gl.vertexAttribPointer(2, 2, gl.BYTE, true, VERTEX, 8);
      gl.uniform3fv(uniform.group, group.at);
      gl.drawArrays(gl.POINTS, 0, group.count);
    }
    gl.colorMask(true, true, true, true);
  }

  // The surface at a pixel of the picture: point, normal (world) and depth; null where there is none.
  pick(camera, pose, u, v) {
    const { fx, fy, cx, cy } = camera.intrinsics, edge = 8 * this.voxel;
    let best = null;
    for (const { coord, data } of this.blocks.values()) {
      for (let i = 0; i < data.length; i += 8) {
        const p = [0, 1, 2].map((a) => (coord[a] + data[i + 2 + a] / 255) * edge - pose[4 * a + 3]);
        const [x, y, z] = [0, 1, 2].map((c) => pose[c] * p[0] + pose[4 + c] * p[1] + pose[8 + c] * p[2]);
        if (z < 0.1 || (best && z > best.depth - edge / 4)) continue;
        const reach = Math.max(3, edge / 3 * fx / z);
        if (Math.abs(fx * x / z + cx - u) > reach || Math.abs(fy * y / z + cy - v) > reach) continue;
        const n = normal(data[i + 5], data[i + 6]);
        if (n[0] * p[0] + n[1] * p[1] + n[2] * p[2] < 0) best = { point: p.map((q, a) => q + pose[4 * a + 3]), normal: n, depth: z };
      }
    }
    return best;
  }
}
