// The light found so far: a grey and a silver ball in it, and the directions that no surface has told of.
import { $ } from "./common.js";

// Real orthonormal spherical harmonics to l = 3, index l (l + 1) + m.
function harmonics([x, y, z]) {
  return [0.282095, 0.488603 * y, 0.488603 * z, 0.488603 * x, 1.092548 * x * y, 1.092548 * y * z, 0.315392 * (3 * z * z - 1),
    1.092548 * x * z, 0.546274 * (x * x - y * y), 0.590044 * y * (3 * x * x - y * y), 2.890611 * x * y * z, 0.457046 * y * (5 * z * z - 1),
    0.373176 * z * (5 * z * z - 3), 0.457046 * x * (5 * z * z - 1), 1.445306 * z * (x * x - y * y), 0.590044 * x * (x * x - 3 * y * y)];
}

// Weights of the bands in reflected light of a white diffuse surface: the cosine lobe over pi.
const DIFFUSE = [1, 2 / 3, 2 / 3, 2 / 3, 1 / 4, 1 / 4, 1 / 4, 1 / 4, 1 / 4];

function sum(coefficients, basis, weights) {
  const out = [0, 0, 0];
  const n = Math.min(coefficients.length, basis.length, weights.length);
  for (let k = 0; k < n; k++) {
    const b = basis[k] * weights[k];
    for (let c = 0; c < 3; c++) out[c] += b * coefficients[k][c];
  }
  return out;
}

// A Hann window over the bands: so few of them ring around bright light.
const WINDOW = [0, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3].map((l) => (1 + Math.cos(Math.PI * l / 4)) / 2);

export const radiance = (light, direction) => sum(light.coefficients, harmonics(direction), WINDOW).map((v) => Math.max(0, v));
const diffuse = (light, normal) => sum(light.coefficients, harmonics(normal), DIFFUSE).map((v) => Math.max(0, v));
const encode = (v) => 255 * Math.min(1, v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055);

const SILVER = 0.9, GREY = 0.5;

// Balls as they would look from the camera.
export function balls(canvas, light, pose) {
  const side = canvas.height, pen = canvas.getContext("2d"), image = pen.createImageData(2 * side, side);
  const world = (v) => [0, 1, 2].map((r) => pose[4 * r] * v[0] + pose[4 * r + 1] * v[1] + pose[4 * r + 2] * v[2]);
  for (let i = 0; i < side; i++) {
    for (let j = 0; j < side; j++) {
      const x = (2 * j + 1) / side - 1, y = (2 * i + 1) / side - 1, r2 = x * x + y * y;
      if (r2 >= 1) continue;
      const n = [x, y, -Math.sqrt(1 - r2)], towards = [-2 * n[2] * n[0], -2 * n[2] * n[1], 1 - 2 * n[2] * n[2]];
      const seen = [diffuse(light, world(n)).map((v) => GREY * v), radiance(light, world(towards)).map((v) => SILVER * v)];
      seen.forEach((color, ball) => image.data.set([...color.map(encode), 255], 4 * (i * 2 * side + ball * side + j)));
    }
  }
  pen.putImageData(image, 0, 0);
}

// The sky from above, as the map lies: its middle is above, its rim below.
export function sky(canvas, light) {
  const side = canvas.width, pen = canvas.getContext("2d"), image = pen.createImageData(side, side);
  for (let i = 0; i < side; i++) {
    for (let j = 0; j < side; j++) {
      const x = (2 * j + 1) / side - 1, y = 1 - (2 * i + 1) / side, r = Math.hypot(x, y);
      if (r >= 1) continue;
      const s = Math.sin(Math.PI * r) / (r || 1), d = [x * s, y * s, Math.cos(Math.PI * r)];
      let near = 0, best = -2;
      light.directions.forEach((e, k) => {
        const cos = d[0] * e[0] + d[1] * e[1] + d[2] * e[2];
        if (cos > best) [best, near] = [cos, k];
      });
      const told = light.told[near];
      const color = told > 0.5 ? radiance(light, d).map((v) => 40 + 0.84 * encode(v)) : [255, 159, 69].map((v) => v * ((i + j) % 6 < 3 ? 0.75 : 0.4));
      image.data.set([...color, 255], 4 * (i * side + j));
    }
  }
  pen.putImageData(image, 0, 0);
}

// Where light is missing from, seen from the camera, in words; empty if nearly every direction above the horizon is told.
export function missing(light, pose) {
  const open = light.directions.filter((d, k) => light.told[k] < 0.5 && d[2] > -0.2);
  const above = light.directions.filter((d) => d[2] > -0.2);
  if (open.length < 0.1 * above.length) return "";
  const axes = { "the right": [0, 1], "the left": [0, -1], "behind": [2, -1], "the front": [2, 1] };
  let worst = "above", most = open.filter((d) => d[2] > 0.7).length / Math.max(1, above.filter((d) => d[2] > 0.7).length);
  for (const [name, [axis, sign]] of Object.entries(axes)) {
    const from = (d) => sign * (d[0] * pose[axis] + d[1] * pose[4 + axis] + d[2] * pose[8 + axis]) > 0.6;
    const share = open.filter(from).length / Math.max(1, above.filter(from).length);
    if (share > most) [worst, most] = [name, share];
  }
  return `No surface yet faces light from ${worst}`;
}

// Keeps the newest light, and shows it.
export class Light {
  constructor() {
    this.light = null;
    this.number = 0;
  }

  async follow(number) {
    if (number === this.number) return;
    this.number = number;
    if (!number) {
      this.light = null;
    } else {
      const answer = await fetch("/api/light");
      if (answer.ok) this.light = await answer.json();
    }
    $("light").hidden = !this.light;
    if (this.light) sky($("sky"), this.light);
  }

  draw(pose) {
    if (!this.light || !pose) return;
    balls($("balls"), this.light, pose);
    $("missing").textContent = missing(this.light, pose);
  }
}
