const $ = (id) => document.getElementById(id);
const facts = JSON.parse($("facts").textContent);
const canvas = $("view");
$("name").textContent = facts.name + " · " + facts.vertices + " vertices";
const list = document.createElement("dl");
const say = (term, text) => {
  const t = document.createElement("dt"), d = document.createElement("dd");
  t.textContent = term; d.textContent = text; list.append(t, d);
};
facts.decisions.forEach((d) => say(d.name + ": " + d.choice, d.evidence + (d.cost ? " Cost: " + d.cost + "." : "") + (d.next ? " Next level: " + d.next : "")));
facts.warnings.forEach((w) => say("warning", w));
facts.cuts.forEach((c) => say("cut for the budget", c));
facts.timings.forEach(([stage, seconds]) => say(stage, Number(seconds).toFixed(1) + " s"));
$("decisions").append(list);
facts.keyframes.forEach((k, i) => { if (k.picture) $("keyframe").add(new Option(k.name, i)); });

const gl = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
if (!gl) { canvas.hidden = true; $("without").hidden = false; return; }

const text = atob($("data").textContent);
const raw = new Uint8Array(text.length);
for (let i = 0; i < text.length; i++) raw[i] = text.charCodeAt(i);
const n = facts.corners, at = facts.offsets;
const positions = new Uint16Array(raw.buffer, at.positions, 4 * n);
const segments = new Uint16Array(raw.buffer, at.segment, n);
const triangles = new Uint32Array(raw.buffer, at.triangles, 3 * facts.triangles);
const where = (v) => [0, 1, 2].map((k) => facts.low[k] + positions[4 * v + k] / 65535 * facts.size[k]);

const HARMONICS = `vec3 along(vec3 light[16], vec3 d) {
    float x = d.x, y = d.y, z = d.z;
    return 0.282095*light[0] + 0.488603*(y*light[1] + z*light[2] + x*light[3]) + 1.092548*(x*y*light[4] + y*z*light[5] + x*z*light[7])
      + 0.315392*(3.0*z*z-1.0)*light[6] + 0.546274*(x*x-y*y)*light[8] + 0.590044*y*(3.0*x*x-y*y)*light[9] + 2.890611*x*y*z*light[10]
      + 0.457046*y*(5.0*z*z-1.0)*light[11] + 0.373176*z*(5.0*z*z-3.0)*light[12] + 0.457046*x*(5.0*z*z-1.0)*light[13]
      + 1.445306*z*(x*x-y*y)*light[14] + 0.590044*x*(x*x-3.0*y*y)*light[15];
  }`;
// Light meets every vertex once a frame, kept by transform feedback: a triangle's corners are shared by six triangles.
const lightVertex = `#version 300 es
  uniform vec3 low, size, eye, light[16], reached[16], gain; uniform int mode; uniform float shown; uniform highp sampler2D segments;
  layout(location=0) in vec3 position; layout(location=1) in vec3 normal; layout(location=2) in vec4 albedo;
  layout(location=3) in vec4 lit; layout(location=4) in float confidence; layout(location=5) in float segment;
  layout(location=6) in vec4 t0; layout(location=7) in vec4 t1; layout(location=8) in vec4 t2; layout(location=9) in vec4 t3;
  flat out uint packed;
  ${LAMP_VERTEX}
  uniform vec3 emissionScale;
  vec3 linear(vec3 c) { return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c)); }
  ${HARMONICS}
  void main() {
    vec3 e = t0.x*reached[0] + t0.y*reached[1] + t0.z*reached[2] + t0.w*reached[3] + t1.x*reached[4] + t1.y*reached[5] + t1.z*reached[6]
      + t1.w*reached[7] + t2.x*reached[8] + t2.y*reached[9] + t2.z*reached[10] + t2.w*reached[11] + t3.x*reached[12] + t3.y*reached[13]
      + t3.z*reached[14] + t3.w*reached[15];
    e = max(e, vec3(0.0)) + lampLight(low + position * size, normalize(normal));
    vec3 emitted = emission.rgb * emission.rgb * emissionScale * othersPower * shown;
    vec4 look = texelFetch(segments, ivec2(int(segment) & 1023, int(segment) >> 10), 0);
    vec3 a = linear(albedo.rgb), color;
    if (mode == 0) color = lit.r + lit.g + lit.b > 0.0 ? linear(lit.rgb) : a * e * shown + emitted;
    else if (mode == 1) color = a * e * shown + emitted;
    else if (mode == 2) color = a;
    else if (mode == 3) color = e * 0.5 * shown;
    else if (mode == 4) color = look.rgb;
    else if (mode == 5) color = vec3(look.a * 5.0);
    else color = vec3(1.0 - confidence, confidence, 0.2) * 0.8;
    if (mode < 2 && look.a > 0.0) {
      // Eq. (13), the share of the sky that the vertex sees standing in for the mirrored ray.
      vec3 p = low + position * size, r = reflect(normalize(p - eye), normalize(normal));
      float open = clamp(t0.x * reached[0].g / (0.282095 * max(light[0].g, 1e-6)), 0.0, 1.0);
      color += look.a * open * max(along(light, r), vec3(0.0)) * shown;
    }
    if (mode < 4) color *= gain;
    vec3 c = clamp(color, 0.0, 1.0);
    uvec3 b = uvec3(mix(c * 12.92, 1.055 * pow(max(c, vec3(1e-6)), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c)) * 255.0 + 0.5);
    packed = b.r | b.g << 8 | b.b << 16 | 0xff000000u;
  }`;
const drawVertex = `#version 300 es
  uniform mat4 camera; layout(location=0) in vec3 position; layout(location=1) in vec4 shade; out vec3 color;
  layout(location=2) in vec2 place; layout(location=3) in vec4 albedo; out vec2 texel; out vec3 smoothAlbedo;
  void main() { gl_Position = camera * vec4(position, 1.0); color = shade.rgb; texel = place; smoothAlbedo = albedo.rgb; }`;
// The texture's albedo over that of the vertices, as encoded: a ratio of powers is the power of the ratio.
const drawFragment = `#version 300 es
  precision highp float; in vec3 color; in vec2 texel; in vec3 smoothAlbedo; out vec4 pixel;
  uniform sampler2D sharp; uniform bool textured;
  void main() {
    vec3 detail = textured ? texture(sharp, texel).rgb / max(smoothAlbedo, vec3(0.02)) : vec3(1.0);
    pixel = vec4(color * detail, 1.0);
  }`;
const objectVertex = `#version 300 es
  uniform mat4 camera; uniform vec3 foot, eye, light[16], gain; uniform float size, shown;
  layout(location=0) in vec3 position; layout(location=1) in vec3 normal; layout(location=2) in vec4 look; out vec3 color;
  ${HARMONICS}
  ${LAMP_OBJECT}
  void main() {
    vec3 p = foot + size * position, n = normalize(normal);
    gl_Position = camera * vec4(p, 1.0);
    // Eq. (8) in the open: the cosine's factors of the bands.
    vec3 soft[16]; for (int k = 0; k < 16; k++) soft[k] = light[k] * (k == 0 ? 1.0 : k < 4 ? 0.666667 : k < 9 ? 0.25 : 0.0);
    // What a mirror shows, under a Hann window: few harmonics ring.
    vec3 seen[16]; for (int k = 0; k < 16; k++) seen[k] = light[k] * (k == 0 ? 1.0 : k < 4 ? 0.904508 : k < 9 ? 0.654508 : 0.345492);
    vec3 mirrored = reflect(normalize(p - eye), n);
    vec3 c = look.rgb * (mix(max(along(soft, n), vec3(0.0)), max(along(seen, mirrored), vec3(0.0)), look.a)
      + lampLight(p, n, mirrored, look.a)) + glow;
    c = clamp(c * shown * gain, 0.0, 1.0);
    color = mix(c * 12.92, 1.055 * pow(max(c, vec3(1e-6)), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
  }`;
const fragment = `#version 300 es
  precision highp float; in vec3 color; out vec4 pixel;
  void main() { pixel = vec4(color, 1.0); }`;
const nothing = `#version 300 es
  precision highp float; out vec4 pixel;
  void main() { pixel = vec4(0.0); }`;
const program = (vertex, fragments, kept) => {
  const p = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragments]]) {
    const s = gl.createShader(kind);
    gl.shaderSource(s, source); gl.compileShader(s);
    if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(s));
    gl.attachShader(p, s);
  }
  if (kept) gl.transformFeedbackVaryings(p, kept, gl.INTERLEAVED_ATTRIBS);
  gl.linkProgram(p);
  if (!gl.getProgramParameter(p, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(p));
  const places = {};
  return { p, u: (name) => places[name] ??= gl.getUniformLocation(p, name) };
};
const lit = program(lightVertex, nothing, ["packed"]), scan = program(drawVertex, drawFragment), thing = program(objectVertex, fragment);

const store = (data, target = gl.ARRAY_BUFFER, use = gl.STATIC_DRAW) => {
  const buffer = gl.createBuffer();
  gl.bindBuffer(target, buffer); gl.bufferData(target, data, use);
  return buffer;
};
const attribute = (location, size, type, normalised, stride, inner = 0) => {
  gl.enableVertexAttribArray(location); gl.vertexAttribPointer(location, size, type, normalised, stride, inner);
};
const part = (offset, bytes) => store(raw.subarray(offset, offset + bytes));
const lightArrays = gl.createVertexArray();
gl.bindVertexArray(lightArrays);
const places = part(at.positions, 8 * n);
attribute(0, 3, gl.UNSIGNED_SHORT, true, 8);
part(at.normals, 4 * n); attribute(1, 3, gl.BYTE, true, 4);
const albedos = part(at.albedo, 4 * n); attribute(2, 4, gl.UNSIGNED_BYTE, true, 4);
part(at.lit, 4 * n); attribute(3, 4, gl.UNSIGNED_BYTE, true, 4);
part(at.confidence, n); attribute(4, 1, gl.UNSIGNED_BYTE, true, 1);
part(at.segment, 2 * n); attribute(5, 1, gl.UNSIGNED_SHORT, false, 2);
part(at.transfer, 16 * n);
for (let k = 0; k < 4; k++) attribute(6 + k, 4, gl.BYTE, true, 16, 4 * k);
if (facts.lamps.length) { part(at.lamps, 4 * n); attribute(10, 4, gl.UNSIGNED_BYTE, true, 4); }
if (facts.hasOthers) {
  part(at.others, 4 * n); attribute(11, 4, gl.UNSIGNED_BYTE, true, 4);
  part(at.emission, 4 * n); attribute(12, 4, gl.UNSIGNED_BYTE, true, 4);
}

const scanArrays = gl.createVertexArray();
gl.bindVertexArray(scanArrays);
gl.bindBuffer(gl.ARRAY_BUFFER, places); attribute(0, 3, gl.UNSIGNED_SHORT, true, 8);
const shades = store(4 * n, gl.ARRAY_BUFFER, gl.DYNAMIC_COPY); attribute(1, 4, gl.UNSIGNED_BYTE, true, 4);
if (facts.texture) { part(at.coordinates, 8 * n); attribute(2, 2, gl.FLOAT, false, 8); }
gl.bindBuffer(gl.ARRAY_BUFFER, albedos); attribute(3, 4, gl.UNSIGNED_BYTE, true, 4);
store(triangles, gl.ELEMENT_ARRAY_BUFFER);
gl.bindVertexArray(null);
gl.bindBuffer(gl.ARRAY_BUFFER, null);
const feedback = gl.createTransformFeedback();

// Colour and w_s of every segment.
const rows = Math.max(1, Math.ceil(facts.segments.length / 1024)), looks = new Float32Array(4 * 1024 * rows);
facts.segments.forEach((s, i) => {
  const hue = (i * 0.618034) % 1;
  for (let c = 0; c < 3; c++) looks[4 * i + c] = 0.1 + 0.6 * Math.max(0, Math.min(1, Math.abs(((hue + c / 3) % 1) * 6 - 3) - 1));
  looks[4 * i + 3] = s.w_s || 0;
});
gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, 1024, rows, 0, gl.RGBA, gl.FLOAT, looks);
gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);

let sharp = null;
if (facts.texture) {
  const image = new Image();
  image.onload = () => {
    sharp = gl.createTexture();
    gl.activeTexture(gl.TEXTURE1); gl.bindTexture(gl.TEXTURE_2D, sharp);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, gl.RGB, gl.UNSIGNED_BYTE, image);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    gl.activeTexture(gl.TEXTURE0);
    draw();
  };
  image.src = "data:image/jpeg;base64," + facts.texture;
}

const middle = [0, 1, 2].map((k) => facts.low[k] + facts.size[k] / 2);
const extent = Math.hypot(...facts.size);
let azimuth = 0.8, elevation = 0.6, distance = extent * 1.1, keyframe = null, thingShown = null, frames = 0;

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
// Clip space from what is at low + p · size.
const matrix = (c, low, size) => {
  const near = extent / 1000, far = extent * 20, m = new Float32Array(16);
  const rows = [
    [c.right, 2 * c.fx, 2 * c.cx - 1], [c.down, -2 * c.fy, 1 - 2 * c.cy],
  ].map(([axis, f, o]) => axis.map((x, i) => f * x + o * c.forward[i]));
  rows.push(c.forward.map((x) => x * (far + near) / (far - near)), c.forward);
  rows.forEach((r, i) => { for (let k = 0; k < 3; k++) m[4 * k + i] = r[k] * size[k]; m[12 + i] = dot(r, sub(low, c.eye)); });
  m[14] -= 2 * far * near / (far - near);
  return m;
};

// A changed lamp shows in the relit scan.
const near = lampControls(facts, () => { if ($("mode").value === "0") $("mode").value = "1"; draw(); });
const bulb = ballCorners([0, 0, 0], 0), bulbArrays = gl.createVertexArray();
gl.bindVertexArray(bulbArrays); store(bulb);
const corners = () => { attribute(0, 3, gl.FLOAT, false, 4 * FLOATS); attribute(1, 3, gl.FLOAT, false, 4 * FLOATS, 12); attribute(2, 4, gl.FLOAT, false, 4 * FLOATS, 24); };
corners();
gl.bindVertexArray(null);

let source = facts.light.map((c) => c.slice()), shown = facts.gain, video = null, raised = null;
const turned = () => {
  const tilt = $("tilt").value * Math.PI / 180;
  if (!raised || raised.of !== source || raised.tilt !== tilt) raised = { of: source, tilt, light: tilted(source, tilt) };
  return yawed(raised.light, $("yaw").value * Math.PI / 180);
};
const relight = (picture, keepLevel) => {
  source = ofPicture(picture);
  // A picture's level means nothing: shown as bright as the scan was, once for all frames of a video.
  if (!keepLevel) { shown = facts.gain * facts.level * facts.light[0][1] / Math.max(source[0][1], 1e-6); near.off(); }
  if ($("mode").value === "0") $("mode").value = "1";
  draw();
};
const open = (file) => {
  if (/\.glb$/i.test(file.name)) {
    file.arrayBuffer().then((b) => { own = glbCorners(b); ownFile = file; $("click").value = "file"; put(atMiddle()); })
      .catch((e) => { $("told").textContent = file.name + ": " + e.message; });
    return;
  }
  const url = URL.createObjectURL(file);
  const sized = (w, h) => { if (Math.abs(w / h - 2) > 0.05) $("told").textContent = file.name + " is not twice as wide as high: used as if it were a panorama."; };
  if (file.type.startsWith("video/")) {
    video = document.createElement("video");
    Object.assign(video, { src: url, muted: true, loop: true, playsInline: true });
    video.onloadeddata = () => { sized(video.videoWidth, video.videoHeight); relight(video, false); video.play(); step(); };
    video.onerror = () => { $("told").textContent = file.name + " cannot be played by this browser."; };
  } else {
    const image = new Image();
    image.onload = () => { video = null; panorama = file; sized(image.width, image.height); relight(image, false); };
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
  const c = camera(), light = turned(), bright = Math.pow(2, Number($("exposure").value));
  // From a keyframe's place the model is as bright as its picture.
  const gain = keyframe ? keyframe.gain.map((g) => bright * g / facts.gain) : [bright, bright, bright];
  const reached = light.map((x, i) => x * facts.transferScale[Math.floor(i / 3)]);
  gl.useProgram(lit.p); gl.bindVertexArray(lightArrays);
  gl.uniform3fv(lit.u("low"), facts.low); gl.uniform3fv(lit.u("size"), facts.size); gl.uniform3fv(lit.u("eye"), c.eye);
  gl.uniform3fv(lit.u("light"), light); gl.uniform3fv(lit.u("reached"), reached); gl.uniform3fv(lit.u("gain"), gain);
  gl.uniform1i(lit.u("mode"), Number($("mode").value)); gl.uniform1f(lit.u("shown"), shown);
  const lamps = lampUniforms(near.lamps), lampsOf = (program) => {
    gl.uniform4fv(program.u("lampPlace"), lamps.place); gl.uniform3fv(program.u("lampPower"), lamps.power);
  };
  lampsOf(lit);
  gl.uniform4fv(lit.u("lampScale"), facts.lampScale); gl.uniform3fv(lit.u("othersScale"), facts.othersScale.slice(0, 3));
  gl.uniform3fv(lit.u("othersPower"), [near.others, near.others, near.others]);
  gl.uniform3fv(lit.u("emissionScale"), facts.emissionScale.slice(0, 3));
  gl.enable(gl.RASTERIZER_DISCARD);
  gl.bindTransformFeedback(gl.TRANSFORM_FEEDBACK, feedback);
  gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, shades);
  gl.beginTransformFeedback(gl.POINTS); gl.drawArrays(gl.POINTS, 0, n); gl.endTransformFeedback();
  gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, null);
  gl.bindTransformFeedback(gl.TRANSFORM_FEEDBACK, null);
  gl.disable(gl.RASTERIZER_DISCARD);

  gl.useProgram(scan.p); gl.bindVertexArray(scanArrays);
  gl.uniformMatrix4fv(scan.u("camera"), false, matrix(c, facts.low, facts.size));
  gl.uniform1i(scan.u("sharp"), 1); gl.uniform1i(scan.u("textured"), sharp && Number($("mode").value) < 3 ? 1 : 0);
  gl.drawElements(gl.TRIANGLES, triangles.length, gl.UNSIGNED_INT, 0);
  gl.useProgram(thing.p);
  gl.uniformMatrix4fv(thing.u("camera"), false, matrix(c, [0, 0, 0], [1, 1, 1]));
  gl.uniform3fv(thing.u("eye"), c.eye); gl.uniform3fv(thing.u("light"), light);
  gl.uniform3fv(thing.u("gain"), gain); gl.uniform1f(thing.u("shown"), shown);
  lampsOf(thing); gl.uniform1fv(thing.u("lampRadius"), lamps.radius);
  const drawThing = (arrays, count, foot, size, glow) => {
    gl.bindVertexArray(arrays);
    gl.uniform3fv(thing.u("foot"), foot); gl.uniform1f(thing.u("size"), size); gl.uniform3fv(thing.u("glow"), glow);
    gl.drawArrays(gl.TRIANGLES, 0, count);
  };
  if (thingShown) drawThing(thingShown.arrays, thingShown.corners, thingShown.foot, thingShown.size, [0, 0, 0]);
  if (Number($("mode").value) < 2) near.lamps.filter((l) => l.power > 0).forEach((l) =>
    drawThing(bulbArrays, bulb.length / FLOATS, [l.place[0], l.place[1], l.place[2] - l.radius_m], l.radius_m, l.radiance.map((x) => x * l.power)));
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

// The nearest triangle from an eye along a unit direction.
const nearest = (eye, d) => {
  let best = null;
  for (let t = 0; t < triangles.length; t += 3) {
    const a = where(triangles[t]), e1 = sub(where(triangles[t + 1]), a), e2 = sub(where(triangles[t + 2]), a), p = cross(d, e2), det = dot(e1, p);
    if (Math.abs(det) < 1e-15) continue;
    const s = sub(eye, a), u = dot(s, p) / det; if (u < 0 || u > 1) continue;
    const q = cross(s, e1), v = dot(d, q) / det; if (v < 0 || u + v > 1) continue;
    const far = dot(e2, q) / det;
    if (far > 0 && (!best || far < best.far)) best = { far, vertex: triangles[t], point: eye.map((o, i) => o + far * d[i]), normal: unit(cross(e1, e2)), d };
  }
  return best;
};
// The same under a point of the canvas (shares of its size).
const hit = (x, y) => {
  const c = camera();
  return nearest(c.eye, unit([0, 1, 2].map((i) => c.forward[i] + (x - c.cx) / c.fx * c.right[i] + (y - c.cy) / c.fy * c.down[i])));
};
const atMiddle = () => hit(0.5, 0.5) || { point: middle };
// Puts a ball or the dropped object where a ray met the surface.
let own = null, ownFile = null, panorama = null, picked = null;
const put = (h) => {
  const kind = $("click").value;
  if (kind === "file" && !own) { $("told").textContent = "Drop a GLB file onto the page first."; return; }
  const list = kind === "file" ? own : kind === "grey" ? ballCorners([0.5, 0.5, 0.5], 0) : ballCorners([0.95, 0.95, 0.95], 1);
  const arrays = gl.createVertexArray();
  gl.bindVertexArray(arrays);
  store(list);
  corners();
  gl.bindVertexArray(null);
  if (thingShown) gl.deleteVertexArray(thingShown.arrays);
  thingShown = { kind, arrays, corners: list.length / FLOATS, foot: h.point, size: kind === "file" ? 1 : extent * 0.05 };
  draw();
};
const click = (x, y) => {
  const h = hit(x, y);
  if (!h) { $("told").textContent = "Nothing of the scan is there."; return null; }
  if ($("click").value !== "pick") { put(h); return h; }
  picked = h.point;
  const id = segments[h.vertex], s = facts.segments[id], round = (k) => k === null ? "unknown" : Number(k).toFixed(3);
  $("told").textContent = "Segment " + id + "\nw_d " + round(s.w_d) + " · w_s " + round(s.w_s) + " ± " + round(s.w_s_error) +
    "\nalbedo " + s.albedo.map(round).join(", ") + "\n" + (100 * s.share).toFixed(1) + " % of the vertices";
  const reference = referenceAt(h.point, h.normal);
  if (reference) $("told").textContent += "\nTo state its albedo (here 0.9): lumiscan estimate scan.lscan " + reference;
  return id;
};

const pointers = new Map();
let moved = 0, spread = 0;
const turn = (dx, dy) => { leave(); azimuth -= dx; elevation = Math.max(-1.5, Math.min(1.5, elevation + dy)); draw(); };
const turnLight = (dx, dy) => {
  $("yaw").value = (Number($("yaw").value) + dx * 0.5 + 540) % 360 - 180;
  $("tilt").value = Number($("tilt").value) + dy * 0.5;
  if ($("mode").value === "0") $("mode").value = "1";
  draw();
};
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
    if (moved > 4 && (e.shiftKey || $("drag").value === "light")) turnLight(dx, -dy); else if (moved > 4) turn(dx * 0.008, dy * 0.008);
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
    "<": () => turnLight(-30, 0), ">": () => turnLight(30, 0),
    "+": () => zoom(0.9), "-": () => zoom(1.1), Enter: () => click(0.5, 0.5) }[e.key];
  if (act) { e.preventDefault(); act(); }
});
$("panel").addEventListener("submit", (e) => e.preventDefault());
$("panel").addEventListener("input", (e) => {
  if (["yaw", "tilt"].includes(e.target.id) && $("mode").value === "0") $("mode").value = "1";
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
// A page around this one may ask what is shown, to have the box render it.
window.addEventListener("message", (e) => {
  if (window.parent === window || e.source !== window.parent || e.data?.lumiscan !== "shown?") return;
  e.source.postMessage({ lumiscan: "shown", ...whatIsShown() }, "*");
});
// For tests: what a person does by hand.
window.lumiscan = { draw, click, open, near, frames: () => frames, view: (k) => { keyframe = k === null ? null : facts.keyframes[k]; draw(); }, finish: () => { const p = new Uint8Array(4); gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, p); } };
draw();
