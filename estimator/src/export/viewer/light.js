// Light: sixteen spherical harmonics (real, orthonormal, no Condon–Shortley phase, index l(l+1)+m) of three channels.
const harmonics = (x, y, z) => [0.282095, 0.488603 * y, 0.488603 * z, 0.488603 * x, 1.092548 * x * y, 1.092548 * y * z,
  0.315392 * (3 * z * z - 1), 1.092548 * x * z, 0.546274 * (x * x - y * y), 0.590044 * y * (3 * x * x - y * y), 2.890611 * x * y * z,
  0.457046 * y * (5 * z * z - 1), 0.373176 * z * (5 * z * z - 3), 0.457046 * x * (5 * z * z - 1), 1.445306 * z * (x * x - y * y),
  0.590044 * x * (x * x - 3 * y * y)];

// A small equirectangular grid: row r at θ = (r + ½)/H · π from +Z, column c at azimuth 2π (c + ½)/W from +Y, clockwise from above.
const GRID_WIDTH = 64, GRID_HEIGHT = 32;
const grid = Array.from({ length: GRID_WIDTH * GRID_HEIGHT }, (_, i) => {
  const r = Math.floor(i / GRID_WIDTH), c = i % GRID_WIDTH;
  const t = (r + 0.5) / GRID_HEIGHT * Math.PI, a = (c + 0.5) / GRID_WIDTH * 2 * Math.PI;
  const direction = [Math.sin(t) * Math.sin(a), Math.sin(t) * Math.cos(a), Math.cos(t)];
  const weight = (Math.cos(r / GRID_HEIGHT * Math.PI) - Math.cos((r + 1) / GRID_HEIGHT * Math.PI)) * 2 * Math.PI / GRID_WIDTH;
  return { direction, weighted: harmonics(...direction).map((y) => y * weight) };
});
const toLinear = Array.from({ length: 256 }, (_, v) => v / 255 <= 0.04045 ? v / 255 / 12.92 : Math.pow((v / 255 + 0.055) / 1.055, 2.4));
const reducer = document.createElement("canvas");
reducer.width = GRID_WIDTH; reducer.height = GRID_HEIGHT;
const pen = reducer.getContext("2d", { willReadFrequently: true });

// Coefficients of radiance(i) → [r, g, b] over the grid.
const projected = (radiance) => {
  const sum = Array.from({ length: 16 }, () => [0, 0, 0]);
  grid.forEach(({ weighted }, i) => {
    const color = radiance(i);
    for (let k = 0; k < 16; k++) for (let c = 0; c < 3; c++) sum[k][c] += weighted[k] * color[c];
  });
  return sum;
};

// Coefficients of a panorama: a picture or a frame of a video.
const ofPicture = (picture) => {
  pen.drawImage(picture, 0, 0, GRID_WIDTH, GRID_HEIGHT);
  const d = pen.getImageData(0, 0, GRID_WIDTH, GRID_HEIGHT).data;
  return projected((i) => [0, 1, 2].map((c) => toLinear[d[4 * i + c]]));
};

// Light turned about +X (radian), so that what came from +Y comes from higher up.
const tilted = (light, angle) => {
  if (angle === 0) return light;
  const c = Math.cos(angle), s = Math.sin(angle);
  return projected((i) => {
    const [x, y, z] = grid[i].direction, basis = harmonics(x, c * y + s * z, c * z - s * y);
    return [0, 1, 2].map((channel) => light.reduce((sum, l, k) => sum + l[channel] * basis[k], 0));
  });
};

// Light turned about +Z, counter-clockwise from above: [3 k + channel].
const yawed = (light, yaw) => {
  const out = new Float32Array(48);
  light.forEach((l, k) => l.forEach((x, i) => { out[3 * k + i] = x; }));
  for (let l = 1; l < 4; l++) for (let m = 1; m <= l; m++) for (let i = 0; i < 3; i++) {
    const p = l * (l + 1) + m, q = l * (l + 1) - m, c = Math.cos(m * yaw), s = Math.sin(m * yaw);
    out[3 * p + i] = c * light[p][i] - s * light[q][i];
    out[3 * q + i] = s * light[p][i] + c * light[q][i];
  }
  return out;
};
