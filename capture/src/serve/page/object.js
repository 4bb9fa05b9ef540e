// A virtual object on the real surface: two clay balls and a silver one, lit by the light found so far, with their shadow. It
// is traced per pixel; the surface hides it where the surface is nearer.
import { radiance } from "./light.js";

const N = 64;

const VERTEX_SHADER = `#version 300 es
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }`;
const FRAGMENT_SHADER = `#version 300 es
precision highp float;
uniform mat3 turn;            // world from camera
uniform vec3 eye, base, up;
uniform vec4 lens;
uniform vec2 size, canvas;
uniform float radius;
uniform vec3 towards[${N}], light[${N}];
out vec4 color;
const vec3 CLAY = vec3(0.55, 0.5, 0.45);

vec4 ball(int i) {            // centre, radius
  vec3 side = normalize(cross(up, abs(up.x) < 0.8 ? vec3(1, 0, 0) : vec3(0, 1, 0)));
  if (i == 0) return vec4(base + up * radius, radius);
  if (i == 1) return vec4(base + up * 2.5 * radius, 0.62 * radius);
  return vec4(base + side * 1.9 * radius + up * 0.7 * radius, 0.7 * radius);
}
float hit(vec3 from, vec3 d, vec4 b) {
  vec3 o = from - b.xyz;
  float p = dot(o, d), q = p * p - dot(o, o) + b.w * b.w;
  return q < 0.0 ? -1.0 : -p - sqrt(q);
}
bool blocked(vec3 from, vec3 d) {
  for (int i = 0; i < 3; i++) if (hit(from, d, ball(i)) > 1e-4) return true;
  return false;
}
vec3 ground(vec3 p) {         // irradiance over pi of the surface, in the objects' shadow
  vec3 sum = vec3(0);
  for (int i = 0; i < ${N}; i++) {
    float c = dot(up, towards[i]);
    if (c > 0.0 && !blocked(p, towards[i])) sum += c * light[i];
  }
  return sum * 4.0 / ${N}.0;
}
vec3 received(vec3 p, vec3 n) {
  vec3 sum = vec3(0), bounced = 0.4 * ground(base + up * 0.001 + up * 4.0 * radius);
  for (int i = 0; i < ${N}; i++) {
    float c = dot(n, towards[i]);
    if (c <= 0.0) continue;
    sum += c * (dot(up, towards[i]) < 0.0 ? bounced : blocked(p + n * 1e-3, towards[i]) ? vec3(0) : light[i]);
  }
  return sum * 4.0 / ${N}.0;
}
vec3 mirrored(vec3 p, vec3 r) {
  if (dot(up, r) < 0.0) return 0.4 * ground(p + r * max(0.0, dot(base - p, up) / dot(r, up)) + up * 1e-3);
  vec3 sum = vec3(0);
  float weight = 1e-6;
  for (int i = 0; i < ${N}; i++) {
    float w = exp(14.0 * (dot(r, towards[i]) - 1.0));
    sum += w * light[i];
    weight += w;
  }
  return sum / weight;
}
vec3 encode(vec3 v) { return mix(12.92 * v, 1.055 * pow(max(v, 1e-5), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, v)); }
void main() {
  vec2 pixel = vec2(gl_FragCoord.x, canvas.y - gl_FragCoord.y) / canvas * size - 0.5;
  vec3 ray = vec3((pixel - lens.zw) / lens.xy, 1.0);
  vec3 d = normalize(turn * ray);
  float t = 1e9;
  int found = -1;
  for (int i = 0; i < 3; i++) {
    float h = hit(eye, d, ball(i));
    if (h > 0.01 && h < t) { t = h; found = i; }
  }
  if (found >= 0) {
    vec4 b = ball(found);
    vec3 p = eye + t * d, n = (p - b.xyz) / b.w;
    vec3 seen = found == 2 ? 0.9 * mirrored(p, reflect(d, n)) : CLAY * received(p, n);
    color = vec4(encode(min(seen, 1.0)), 1.0);
    gl_FragDepth = (t / length(ray) - 0.01) / 12.0;
    return;
  }
  t = dot(base - eye, up) / dot(d, up);
  vec3 p = eye + t * d;
  float far = length(p - base) / radius;
  if (t < 0.01 || far > 7.0) discard;
  vec3 open = vec3(0);
  for (int i = 0; i < ${N}; i++) open += max(0.0, dot(up, towards[i])) * light[i];
  float kept = dot(ground(p + up * 1e-3), vec3(1)) / max(1e-6, dot(open, vec3(4.0 / ${N}.0)));
  // As an encoded picture is darkened.
  float alpha = (1.0 - pow(clamp(kept, 0.0, 1.0), 1.0 / 2.2)) * smoothstep(7.0, 5.0, far);
  if (alpha < 0.01) discard;
  color = vec4(0, 0, 0, alpha);
  gl_FragDepth = (t / length(ray) - 0.03) / 12.0;
}`;

const directions = Array.from({ length: N }, (_, i) => {
  const z = 1 - (2 * i + 1) / N, r = Math.sqrt(1 - z * z), turn = i * 2.3999632;
  return [r * Math.cos(turn), r * Math.sin(turn), z];
});

export class VirtualObject {
  constructor() {
    this.place = null;
  }

  // Stands on the surface at a pixel of the picture (in its own pixels); false if there is none.
  put(surface, camera, pose, u, v) {
    const found = surface.pick(camera, pose, u, v);
    if (!found) return false;
    // On a table or a floor it stands upright.
    const up = found.normal[2] > 0.85 ? [0, 0, 1] : found.normal;
    this.place = { base: found.point, up, radius: 0.05 * found.depth };
    return true;
  }

  draw(surface, light, camera, pose) {
    const gl = surface.gl;
    if (!gl || !this.place || !light || !pose || !camera) return;
    if (this.context !== gl) [this.context, this.program] = [gl, surface.compile(VERTEX_SHADER, FRAGMENT_SHADER)];
    const u = (name) => gl.getUniformLocation(this.program, name), { width, height, fx, fy, cx, cy } = camera.intrinsics;
    gl.useProgram(this.program);
    gl.uniformMatrix3fv(u("turn"), false, [0, 1, 2].flatMap((c) => [pose[c], pose[4 + c], pose[8 + c]]));
    gl.uniform3f(u("eye"), pose[3], pose[7], pose[11]);
    gl.uniform3fv(u("base"), this.place.base);
    gl.uniform3fv(u("up"), this.place.up);
    gl.uniform1f(u("radius"), this.place.radius);
    gl.uniform4f(u("lens"), fx, fy, cx, cy);
    gl.uniform2f(u("size"), width, height);
    gl.uniform2f(u("canvas"), gl.drawingBufferWidth, gl.drawingBufferHeight);
    gl.uniform3fv(u("towards"), directions.flat());
    gl.uniform3fv(u("light"), directions.flatMap((d) => radiance(light, d)));
    for (const i of [0, 1, 2]) gl.disableVertexAttribArray(i);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.disable(gl.BLEND);
  }
}
