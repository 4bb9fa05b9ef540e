"use strict";
(() => {
  const $ = (id) => document.getElementById(id);
  const facts = JSON.parse($("facts").textContent);
  const canvas = $("view");
  $("name").textContent = facts.name + " · " + facts.vertices + " vertices";
  const list = document.createElement("dl");
  const say = (term, text) => {
    const t = document.createElement("dt"), d = document.createElement("dd");
    t.textContent = term; d.textContent = text; list.append(t, d);
  };
  facts.decisions.forEach((d) => say(d.name + ": " + d.choice, d.evidence + (d.next ? " Next level: " + d.next : "")));
  facts.warnings.forEach((w) => say("warning", w));
  facts.cuts.forEach((c) => say("cut for the budget", c));
  $("decisions").append(list);
  facts.keyframes.forEach((k, i) => { if (k.picture) $("keyframe").add(new Option(k.name, i)); });

  const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) { canvas.hidden = true; $("without").hidden = false; return; }

  const text = atob($("data").textContent);
  const raw = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) raw[i] = text.charCodeAt(i);
  const n = facts.vertices, at = facts.offsets;
  const positions = new Uint16Array(raw.buffer, at.positions, 4 * n);
  const segments = new Uint16Array(raw.buffer, at.segment, n);
  const triangles = new Uint32Array(raw.buffer, at.triangles, 3 * facts.triangles);
  const where = (v) => [0, 1, 2].map((k) => facts.low[k] + positions[4 * v + k] / 65535 * facts.size[k]);

  const scanVertex = `#version 300 es
    uniform mat4 camera; uniform vec3 low, size; uniform vec3 light[16]; uniform float scale[16];
    uniform int mode; uniform float gain, shown; uniform vec4 segmentLook[128];
    layout(location=0) in vec3 position; layout(location=1) in vec3 normal; layout(location=2) in vec4 albedo;
    layout(location=3) in vec4 lit; layout(location=4) in float confidence; layout(location=5) in float segment;
    layout(location=6) in vec4 t0; layout(location=7) in vec4 t1; layout(location=8) in vec4 t2; layout(location=9) in vec4 t3;
    out vec3 color;
    vec3 linear(vec3 c) { return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c)); }
    void main() {
      gl_Position = camera * vec4(low + position * size, 1.0);
      float t[16] = float[16](t0.x,t0.y,t0.z,t0.w,t1.x,t1.y,t1.z,t1.w,t2.x,t2.y,t2.z,t2.w,t3.x,t3.y,t3.z,t3.w);
      vec3 e = vec3(0.0);
      for (int k = 0; k < 16; k++) e += max(t[k], -1.0) * scale[k] * light[k];
      e = max(e, vec3(0.0));
      vec3 a = linear(albedo.rgb); vec4 look = segmentLook[int(segment) & 127];
      if (mode == 0) color = linear(lit.rgb) * gain;
      else if (mode == 1) color = a * e * shown * gain;
      else if (mode == 2) color = a * gain;
      else if (mode == 3) color = e * 0.5 * shown * gain;
      else if (mode == 4) color = look.rgb;
      else if (mode == 5) color = vec3(look.a);
      else color = vec3(1.0 - confidence, confidence, 0.2) * 0.8;
    }`;
  const fragment = `#version 300 es
    precision highp float; in vec3 color; out vec4 pixel;
    void main() { vec3 c = clamp(color, 0.0, 1.0);
      pixel = vec4(mix(c * 12.92, 1.055 * pow(max(c, vec3(1e-6)), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c)), 1.0); }`;
  const ballVertex = `#version 300 es
    uniform mat4 camera; uniform vec3 middle, eye, light[16]; uniform float radius, gain, shown;
    layout(location=0) in vec3 normal; out vec3 color;
    void main() {
      vec3 p = middle + radius * normal; gl_Position = camera * vec4(p, 1.0);
      vec3 d = reflect(normalize(p - eye), normal); float x = d.x, y = d.y, z = d.z;
      float s[16] = float[16](0.282095, 0.488603*y, 0.488603*z, 0.488603*x, 1.092548*x*y, 1.092548*y*z, 0.315392*(3.0*z*z-1.0),
        1.092548*x*z, 0.546274*(x*x-y*y), 0.590044*y*(3.0*x*x-y*y), 2.890611*x*y*z, 0.457046*y*(5.0*z*z-1.0),
        0.373176*z*(5.0*z*z-3.0), 0.457046*x*(5.0*z*z-1.0), 1.445306*z*(x*x-y*y), 0.590044*x*(x*x-3.0*y*y));
      vec3 l = vec3(0.0); for (int k = 0; k < 16; k++) l += s[k] * light[k];
      color = 0.9 * max(l, vec3(0.0)) * shown * gain;
    }`;
  const program = (vertex) => {
    const p = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const s = gl.createShader(kind);
      gl.shaderSource(s, source); gl.compileShader(s);
      if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(s));
      gl.attachShader(p, s);
    }
    gl.linkProgram(p);
    if (!gl.getProgramParameter(p, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(p));
    return { p, u: (name) => gl.getUniformLocation(p, name) };
  };
  const scan = program(scanVertex), ball = program(ballVertex);

  const scanArrays = gl.createVertexArray();
  gl.bindVertexArray(scanArrays);
  const attribute = (location, offset, bytes, size, type, normalised, stride, inner = 0) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, raw.subarray(offset, offset + bytes), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(location);
    gl.vertexAttribPointer(location, size, type, normalised, stride, inner);
  };
  attribute(0, at.positions, 8 * n, 3, gl.UNSIGNED_SHORT, true, 8);
  attribute(1, at.normals, 4 * n, 3, gl.BYTE, true, 4);
  attribute(2, at.albedo, 4 * n, 4, gl.UNSIGNED_BYTE, true, 4);
  attribute(3, at.lit, 4 * n, 4, gl.UNSIGNED_BYTE, true, 4);
  attribute(4, at.confidence, n, 1, gl.UNSIGNED_BYTE, true, 1);
  attribute(5, at.segment, 2 * n, 1, gl.UNSIGNED_SHORT, false, 2);
  attribute(6, at.transfer, 16 * n, 4, gl.BYTE, true, 16);
  for (let k = 1; k < 4; k++) { gl.enableVertexAttribArray(6 + k); gl.vertexAttribPointer(6 + k, 4, gl.BYTE, true, 16, 4 * k); }
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, triangles, gl.STATIC_DRAW);

  const ballArrays = gl.createVertexArray();
  gl.bindVertexArray(ballArrays);
  const normals = [], faces = [], rings = 32, sectors = 48;
  for (let i = 0; i <= rings; i++) for (let j = 0; j <= sectors; j++) {
    const a = Math.PI * i / rings, b = 2 * Math.PI * j / sectors;
    normals.push(Math.sin(a) * Math.cos(b), Math.sin(a) * Math.sin(b), Math.cos(a));
    const v = i * (sectors + 1) + j;
    if (i < rings && j < sectors) faces.push(v, v + sectors + 1, v + 1, v + 1, v + sectors + 1, v + sectors + 2);
  }
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(normals), gl.STATIC_DRAW);
  gl.enableVertexAttribArray(0); gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint16Array(faces), gl.STATIC_DRAW);

  const looks = new Float32Array(4 * 128);
  facts.segments.slice(0, 128).forEach((s, i) => {
    const hue = (i * 0.618034) % 1;
    for (let c = 0; c < 3; c++) looks[4 * i + c] = 0.1 + 0.6 * Math.max(0, Math.min(1, Math.abs(((hue + c / 3) % 1) * 6 - 3) - 1));
    looks[4 * i + 3] = Math.min(1, (s.w_s || 0) * 5);
  });

  const sub = (a, b) => a.map((x, i) => x - b[i]), dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => { const l = Math.hypot(...a) || 1; return a.map((x) => x / l); };
  const middle = [0, 1, 2].map((k) => facts.low[k] + facts.size[k] / 2);
  const extent = Math.hypot(...facts.size);
  let azimuth = 0.8, elevation = 0.6, distance = extent * 1.1, keyframe = null, sphere = null, frames = 0;

  // Camera: its axes right, down, forward in the world, its eye, and its lens (as shares of the picture).
  const camera = () => {
    const wide = canvas.width / canvas.height;
    if (keyframe) {
      const r = keyframe.pose, column = (c) => [r[0][c], r[1][c], r[2][c]];
      const fit = Math.min(1, wide / keyframe.aspect), fy = keyframe.fy * fit;
      return { right: column(0), down: column(1), forward: column(2), eye: column(3), fx: fy / wide * (keyframe.fx * keyframe.aspect / keyframe.fy),
        fy, cx: 0.5 + (keyframe.cx - 0.5) * fit * keyframe.aspect / wide, cy: 0.5 + (keyframe.cy - 0.5) * fit };
    }
    const ce = Math.cos(elevation), back = [Math.cos(azimuth) * ce, Math.sin(azimuth) * ce, Math.sin(elevation)];
    const forward = back.map((x) => -x), right = unit(cross(forward, [0, 0, 1])), down = cross(forward, right);
    const fy = wide < 1 ? 1.1 * wide : 1.1;
    return { right, down, forward, eye: middle.map((m, i) => m + back[i] * distance), fx: fy / wide, fy, cx: 0.5, cy: 0.5 };
  };
  const matrix = (c) => {
    const near = extent / 1000, far = extent * 20, m = new Float32Array(16);
    const rows = [
      [c.right, 2 * c.fx, 2 * c.cx - 1], [c.down, -2 * c.fy, 1 - 2 * c.cy],
    ].map(([axis, f, o]) => axis.map((x, i) => f * x + o * c.forward[i]));
    rows.push(c.forward.map((x) => x * (far + near) / (far - near)), c.forward);
    rows.forEach((r, i) => { for (let k = 0; k < 3; k++) m[4 * k + i] = r[k]; m[12 + i] = -dot(r, c.eye); });
    m[14] -= 2 * far * near / (far - near);
    return m;
  };

  // Light: coefficients as given, turned about +Z.
  let source = facts.light.map((c) => c.slice()), shown = facts.gain, video = null;
  const turned = () => {
    const yaw = $("yaw").value * Math.PI / 180, out = new Float32Array(48);
    source.forEach((c, k) => c.forEach((x, i) => { out[3 * k + i] = x; }));
    for (let l = 1; l < 4; l++) for (let m = 1; m <= l; m++) for (let i = 0; i < 3; i++) {
      const p = l * (l + 1) + m, q = l * (l + 1) - m, c = Math.cos(m * yaw), s = Math.sin(m * yaw);
      out[3 * p + i] = c * source[p][i] - s * source[q][i];
      out[3 * q + i] = s * source[p][i] + c * source[q][i];
    }
    return out;
  };
  const W = 64, H = 32, small = document.createElement("canvas"), basis = [];
  small.width = W; small.height = H;
  const pen = small.getContext("2d", { willReadFrequently: true });
  for (let r = 0; r < H; r++) for (let c = 0; c < W; c++) {
    const t = (r + 0.5) / H * Math.PI, a = (c + 0.5) / W * 2 * Math.PI;
    const x = Math.sin(t) * Math.sin(a), y = Math.sin(t) * Math.cos(a), z = Math.cos(t);
    const w = (Math.cos(r / H * Math.PI) - Math.cos((r + 1) / H * Math.PI)) * 2 * Math.PI / W;
    basis.push([0.282095, 0.488603 * y, 0.488603 * z, 0.488603 * x, 1.092548 * x * y, 1.092548 * y * z, 0.315392 * (3 * z * z - 1),
      1.092548 * x * z, 0.546274 * (x * x - y * y), 0.590044 * y * (3 * x * x - y * y), 2.890611 * x * y * z, 0.457046 * y * (5 * z * z - 1),
      0.373176 * z * (5 * z * z - 3), 0.457046 * x * (5 * z * z - 1), 1.445306 * z * (x * x - y * y), 0.590044 * x * (x * x - 3 * y * y)].map((b) => b * w));
  }
  const table = Array.from({ length: 256 }, (_, v) => v / 255 <= 0.04045 ? v / 255 / 12.92 : Math.pow((v / 255 + 0.055) / 1.055, 2.4));
  const project = (picture) => {
    pen.drawImage(picture, 0, 0, W, H);
    const d = pen.getImageData(0, 0, W, H).data, sum = Array.from({ length: 16 }, () => [0, 0, 0]);
    for (let i = 0; i < W * H; i++) for (let k = 0; k < 16; k++) for (let c = 0; c < 3; c++) sum[k][c] += basis[i][k] * table[d[4 * i + c]];
    return sum;
  };
  const relight = (picture, keepLevel) => {
    source = project(picture);
    // A picture's level means nothing: shown as bright as the scan was, once for all frames of a video.
    if (!keepLevel) shown = facts.gain * facts.light[0][1] / Math.max(source[0][1], 1e-6);
    if ($("mode").value === "0") $("mode").value = "1";
    draw();
  };
  const open = (file) => {
    const url = URL.createObjectURL(file);
    const sized = (w, h) => { if (Math.abs(w / h - 2) > 0.05) $("told").textContent = file.name + " is not twice as wide as high: used as if it were a panorama."; };
    if (file.type.startsWith("video/")) {
      video = document.createElement("video");
      Object.assign(video, { src: url, muted: true, loop: true, playsInline: true });
      video.onloadeddata = () => { sized(video.videoWidth, video.videoHeight); relight(video, false); video.play(); step(); };
      video.onerror = () => { $("told").textContent = file.name + " cannot be played by this browser."; };
    } else {
      const image = new Image();
      image.onload = () => { video = null; sized(image.width, image.height); relight(image, false); };
      image.onerror = () => { $("told").textContent = file.name + " is no picture that this browser reads."; };
      image.src = url;
    }
  };
  const step = () => { if (video) { relight(video, true); requestAnimationFrame(step); } };

  const draw = () => {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const w = Math.max(1, Math.round(canvas.clientWidth * ratio)), h = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    gl.viewport(0, 0, w, h);
    gl.enable(gl.DEPTH_TEST); gl.clearColor(0.09, 0.095, 0.105, 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const c = camera(), m = matrix(c), light = turned(), gain = Math.pow(2, Number($("exposure").value));
    gl.useProgram(scan.p); gl.bindVertexArray(scanArrays);
    gl.uniformMatrix4fv(scan.u("camera"), false, m);
    gl.uniform3fv(scan.u("low"), facts.low); gl.uniform3fv(scan.u("size"), facts.size);
    gl.uniform3fv(scan.u("light"), light); gl.uniform1fv(scan.u("scale"), facts.transferScale);
    gl.uniform4fv(scan.u("segmentLook"), looks); gl.uniform1i(scan.u("mode"), Number($("mode").value));
    gl.uniform1f(scan.u("gain"), gain); gl.uniform1f(scan.u("shown"), shown);
    gl.drawElements(gl.TRIANGLES, triangles.length, gl.UNSIGNED_INT, 0);
    if (sphere) {
      gl.useProgram(ball.p); gl.bindVertexArray(ballArrays);
      gl.uniformMatrix4fv(ball.u("camera"), false, m);
      gl.uniform3fv(ball.u("middle"), sphere.middle); gl.uniform1f(ball.u("radius"), sphere.radius);
      gl.uniform3fv(ball.u("eye"), c.eye); gl.uniform3fv(ball.u("light"), light);
      gl.uniform1f(ball.u("gain"), gain); gl.uniform1f(ball.u("shown"), shown);
      gl.drawElements(gl.TRIANGLES, faces.length, gl.UNSIGNED_SHORT, 0);
    }
    frames++;
    const photo = $("photo");
    photo.hidden = !keyframe;
    if (keyframe) {
      const wide = canvas.clientWidth / canvas.clientHeight, fit = Math.min(1, wide / keyframe.aspect);
      const ph = canvas.clientHeight * fit, pw = ph * keyframe.aspect;
      Object.assign(photo.style, { width: pw + "px", height: ph + "px", left: (canvas.clientWidth - pw) / 2 + "px",
        top: (canvas.clientHeight - ph) / 2 + "px", opacity: $("blend").value });
    }
  };

  // The nearest triangle under a point of the canvas (shares of its size).
  const hit = (x, y) => {
    const c = camera(), d = unit([0, 1, 2].map((i) => c.forward[i] + (x - c.cx) / c.fx * c.right[i] + (y - c.cy) / c.fy * c.down[i]));
    let best = null;
    for (let t = 0; t < triangles.length; t += 3) {
      const a = where(triangles[t]), e1 = sub(where(triangles[t + 1]), a), e2 = sub(where(triangles[t + 2]), a), p = cross(d, e2), det = dot(e1, p);
      if (Math.abs(det) < 1e-15) continue;
      const s = sub(c.eye, a), u = dot(s, p) / det; if (u < 0 || u > 1) continue;
      const q = cross(s, e1), v = dot(d, q) / det; if (v < 0 || u + v > 1) continue;
      const far = dot(e2, q) / det;
      if (far > 0 && (!best || far < best.far)) best = { far, vertex: triangles[t], point: c.eye.map((o, i) => o + far * d[i]), normal: unit(cross(e1, e2)), d };
    }
    return best;
  };
  const click = (x, y) => {
    const h = hit(x, y);
    if (!h) { $("told").textContent = "Nothing of the scan is there."; return null; }
    if ($("click").value === "sphere") {
      const radius = extent * 0.05, up = dot(h.normal, h.d) > 0 ? h.normal.map((k) => -k) : h.normal;
      sphere = { radius, middle: h.point.map((p, i) => p + up[i] * radius) };
      draw();
      return h;
    }
    const id = segments[h.vertex], s = facts.segments[id], round = (k) => k === null ? "unknown" : Number(k).toFixed(3);
    $("told").textContent = "Segment " + id + "\nw_d " + round(s.w_d) + " · w_s " + round(s.w_s) + " ± " + round(s.w_s_error) +
      "\nalbedo " + s.albedo.map(round).join(", ") + "\n" + (100 * s.share).toFixed(1) + " % of the vertices";
    return id;
  };

  const pointers = new Map();
  let moved = 0, spread = 0;
  const turn = (dx, dy) => { leave(); azimuth -= dx; elevation = Math.max(-1.5, Math.min(1.5, elevation + dy)); draw(); };
  const zoom = (f) => { leave(); distance = Math.max(extent * 0.05, Math.min(extent * 10, distance * f)); draw(); };
  const leave = () => { keyframe = null; $("keyframe").value = ""; };
  canvas.addEventListener("pointerdown", (e) => { canvas.setPointerCapture(e.pointerId); pointers.set(e.pointerId, e); moved = 0; spread = 0; });
  canvas.addEventListener("pointermove", (e) => {
    const before = pointers.get(e.pointerId);
    if (!before) return;
    pointers.set(e.pointerId, e);
    if (pointers.size === 1) {
      const dx = e.clientX - before.clientX, dy = e.clientY - before.clientY;
      moved += Math.abs(dx) + Math.abs(dy);
      if (moved > 4) turn(dx * 0.008, dy * 0.008);
    } else {
      const [a, b] = [...pointers.values()], now = Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
      if (spread) zoom(spread / now);
      spread = now; moved = 99;
    }
  });
  const up = (e) => {
    if (pointers.delete(e.pointerId) && e.type === "pointerup" && moved <= 4) {
      const box = canvas.getBoundingClientRect();
      click((e.clientX - box.left) / box.width, (e.clientY - box.top) / box.height);
    }
  };
  canvas.addEventListener("pointerup", up);
  canvas.addEventListener("pointercancel", up);
  canvas.addEventListener("wheel", (e) => { e.preventDefault(); zoom(Math.exp(e.deltaY * 0.001)); }, { passive: false });
  canvas.addEventListener("keydown", (e) => {
    const act = { ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0), ArrowUp: () => turn(0, 0.1), ArrowDown: () => turn(0, -0.1),
      "+": () => zoom(0.9), "-": () => zoom(1.1), Enter: () => click(0.5, 0.5) }[e.key];
    if (act) { e.preventDefault(); act(); }
  });
  $("panel").addEventListener("submit", (e) => e.preventDefault());
  $("panel").addEventListener("input", (e) => {
    if (e.target.id === "yaw" && $("mode").value === "0") $("mode").value = "1";
    if (e.target.id === "keyframe") {
      keyframe = e.target.value === "" ? null : facts.keyframes[e.target.value];
      if (keyframe) $("photo").src = "data:image/png;base64," + keyframe.picture;
    }
    draw();
  });
  $("light").addEventListener("change", (e) => { if (e.target.files[0]) open(e.target.files[0]); });
  document.addEventListener("dragover", (e) => e.preventDefault());
  document.addEventListener("drop", (e) => { e.preventDefault(); if (e.dataTransfer.files[0]) open(e.dataTransfer.files[0]); });
  window.addEventListener("resize", draw);
  // For tests: what a person does by hand.
  window.lumiscan = { draw, click, frames: () => frames, view: (k) => { keyframe = k === null ? null : facts.keyframes[k]; draw(); }, finish: () => { const p = new Uint8Array(4); gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, p); } };
  draw();
})();
