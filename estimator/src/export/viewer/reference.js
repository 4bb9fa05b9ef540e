// The line for `lumiscan estimate` that states the albedo of a point of the surface.

// Pixel (column, row) of a point in a keyframe and its distance from the picture's nearest edge; null outside the picture.
const pixelOf = (k, point) => {
  const d = sub(point, [0, 1, 2].map((i) => k.pose[i][3]));
  const [x, y, z] = [0, 1, 2].map((c) => dot(d, [0, 1, 2].map((i) => k.pose[i][c])));
  if (z <= 0) return null;
  // Brown's model, as cameras are stored.
  const [k1, k2, p1, p2, k3] = k.lens, u = x / z, v = y / z, r2 = u * u + v * v, radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3));
  const column = (k.cx + k.fx * (u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u))) * k.width - 0.5;
  const row = (k.cy + k.fy * (v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v)) * k.height - 0.5;
  const inside = Math.min(column, row, k.width - 1 - column, k.height - 1 - row);
  return inside >= 0 ? { column, row, inside: inside / Math.min(k.width, k.height) } : null;
};

// The keyframe that shows the point best: frontally, and not at its edge. Null if none shows it.
const referenceAt = (point, normal) => {
  const shows = facts.keyframes.map((k, i) => {
    const pixel = pixelOf(k, point), eye = [0, 1, 2].map((r) => k.pose[r][3]), to = sub(point, eye);
    return pixel && { i, pixel, eye, to, score: Math.abs(dot(unit(to), normal)) * Math.min(1, 0.2 + 4 * pixel.inside) };
  }).filter((s) => s).sort((a, b) => b.score - a.score);
  const seen = shows.find((s) => { const first = nearest(s.eye, unit(s.to)), far = Math.hypot(...s.to); return !first || first.far > far - 0.002 * extent; });
  return seen ? `--reference keyframe:${seen.i}:${Math.round(seen.pixel.column)},${Math.round(seen.pixel.row)}=0.9` : null;
};
