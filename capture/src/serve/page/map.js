// The map from above: what was seen and how well, the camera's path, kept frames, and where the camera looks.

const MARGIN = 16;

export class Map2d {
  constructor(canvas) {
    this.canvas = canvas;
    this.path = [];
  }

  clear() {
    this.path = [];
  }

  moved(pose) {
    const last = this.path.at(-1), here = [pose[3], pose[7]];
    if (!last || Math.hypot(here[0] - last[0], here[1] - last[1]) > 0.01) this.path.push(here);
    if (this.path.length > 2000) this.path = this.path.filter((_, i) => i % 2);
  }

  draw(surface, keyframes, pose, lost) {
    const pen = this.canvas.getContext("2d"), side = this.canvas.width;
    pen.clearRect(0, 0, side, side);
    const edge = 8 * surface.voxel;
    // The highest block of each column.
    const columns = new Map();
    for (const { coord, data, weight } of surface.blocks.values()) {
      if (!data.length) continue;
      const key = `${coord[0]},${coord[1]}`, known = columns.get(key);
      if (!known || coord[2] > known.coord[2]) columns.set(key, { coord, weight });
    }
    const points = [...columns.values()].flatMap(({ coord }) => [[coord[0] * edge, coord[1] * edge], [(coord[0] + 1) * edge, (coord[1] + 1) * edge]])
      .concat(keyframes, this.path, pose ? [[pose[3], pose[7]]] : []);
    if (!points.length) return;
    const low = [0, 1].map((a) => points.reduce((m, p) => Math.min(m, p[a]), Infinity));
    const high = [0, 1].map((a) => points.reduce((m, p) => Math.max(m, p[a]), -Infinity));
    const scale = (side - 2 * MARGIN) / Math.max(high[0] - low[0], high[1] - low[1], 0.5);
    const x = (p) => side / 2 + (p[0] - (low[0] + high[0]) / 2) * scale;
    const y = (p) => side / 2 - (p[1] - (low[1] + high[1]) / 2) * scale;
    for (const { coord, weight } of columns.values()) {
      const seen = Math.min(1, Math.max(0, weight / (surface.good || 12)));
      pen.fillStyle = `rgb(${255 - 176 * seen} ${158 + 51 * seen} ${69 + 112 * seen} / .75)`;
      pen.fillRect(x([coord[0] * edge]), y([0, (coord[1] + 1) * edge]), edge * scale + .7, edge * scale + .7);
    }
    pen.lineWidth = 2;
    pen.strokeStyle = "#fff";
    pen.beginPath();
    for (const p of this.path) pen.lineTo(x(p), y(p));
    pen.stroke();
    pen.fillStyle = "#8ecbff";
    for (const p of keyframes) {
      pen.beginPath();
      pen.arc(x(p), y(p), 4, 0, 7);
      pen.fill();
    }
    if (!pose) return;
    const here = [pose[3], pose[7]], ahead = [pose[2], pose[6]], n = Math.hypot(...ahead) || 1;
    const [ax, ay] = [ahead[0] / n * 26, -ahead[1] / n * 26];
    pen.fillStyle = lost ? "#ff7b72" : "#fff";
    pen.beginPath();
    pen.moveTo(x(here), y(here));
    pen.lineTo(x(here) + ax - ay / 2, y(here) + ay + ax / 2);
    pen.lineTo(x(here) + ax + ay / 2, y(here) + ay - ax / 2);
    pen.fill();
  }
}
