// Things put on the surface: a ball, or the triangles of a GLB file. Each is one list of corners: position, normal, colour
// and how much of a mirror it is, ten floats a corner.
const FLOATS = 10;

const ballCorners = (color, metallic) => {
  const out = [], rings = 32, sectors = 48;
  const corner = (i, j) => {
    const a = Math.PI * i / rings, b = 2 * Math.PI * j / sectors;
    const n = [Math.sin(a) * Math.cos(b), Math.sin(a) * Math.sin(b), Math.cos(a)];
    out.push(n[0], n[1], n[2] + 1, ...n, ...color, metallic);
  };
  for (let i = 0; i < rings; i++) for (let j = 0; j < sectors; j++) {
    corner(i, j); corner(i + 1, j); corner(i, j + 1); corner(i, j + 1); corner(i + 1, j); corner(i + 1, j + 1);
  }
  return new Float32Array(out);
};

const glbCorners = (buffer) => {
  const view = new DataView(buffer);
  if (view.byteLength < 20 || view.getUint32(0, true) !== 0x46546c67) throw new Error("is no GLB file");
  const jsonLength = view.getUint32(12, true), binary = 28 + jsonLength;
  const json = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 20, jsonLength)));
  const sizes = { 5121: 1, 5123: 2, 5125: 4, 5126: 4 }, getters = { 5121: "getUint8", 5123: "getUint16", 5125: "getUint32", 5126: "getFloat32" };
  const values = (index, count) => {
    const a = json.accessors[index], v = json.bufferViews[a.bufferView], size = sizes[a.componentType];
    if (!size || v.buffer) throw new Error("has data in a form that this page does not read");
    const start = binary + (v.byteOffset || 0) + (a.byteOffset || 0), step = v.byteStride || size * count;
    if (start + (a.count - 1) * step + size * count > buffer.byteLength) throw new Error("is truncated");
    return (i, k) => view[getters[a.componentType]](start + i * step + k * size, true);
  };
  const multiply = (a, b) => a.map((_, i) => [0, 1, 2, 3].reduce((s, k) => s + a[4 * k + i % 4] * b[4 * Math.floor(i / 4) + k], 0));
  const matrixOf = (n) => {
    if (n.matrix) return n.matrix;
    const [x, y, z, w] = n.rotation || [0, 0, 0, 1], s = n.scale || [1, 1, 1], t = n.translation || [0, 0, 0];
    return [(1 - 2 * (y * y + z * z)) * s[0], 2 * (x * y + z * w) * s[0], 2 * (x * z - y * w) * s[0], 0,
      2 * (x * y - z * w) * s[1], (1 - 2 * (x * x + z * z)) * s[1], 2 * (y * z + x * w) * s[1], 0,
      2 * (x * z + y * w) * s[2], 2 * (y * z - x * w) * s[2], (1 - 2 * (x * x + y * y)) * s[2], 0, ...t, 1];
  };
  const out = [];
  const add = (primitive, m) => {
    if ((primitive.mode ?? 4) !== 4) return;
    const position = values(primitive.attributes.POSITION, 3), count = json.accessors[primitive.attributes.POSITION].count;
    const normal = primitive.attributes.NORMAL === undefined ? null : values(primitive.attributes.NORMAL, 3);
    const index = primitive.indices === undefined ? null : values(primitive.indices, 1);
    const look = (json.materials || [])[primitive.material] || {}, pbr = look.pbrMetallicRoughness || {};
    const color = (pbr.baseColorFactor || [1, 1, 1]).slice(0, 3), metallic = pbr.metallicFactor ?? 1;
    const n = primitive.indices === undefined ? count : json.accessors[primitive.indices].count;
    // glTF's +Y up becomes +Z up.
    const place = (read, i, w) => {
      const [x, y, z] = [0, 1, 2].map((k) => read(i, k));
      const at = [0, 1, 2].map((k) => m[k] * x + m[4 + k] * y + m[8 + k] * z + w * m[12 + k]);
      return [at[0], -at[2], at[1]];
    };
    for (let t = 0; t + 2 < n; t += 3) {
      const corner = [0, 1, 2].map((k) => index ? index(t + k, 0) : t + k);
      if (corner.some((i) => i >= count)) throw new Error("refers to vertices that are not there");
      const p = corner.map((i) => place(position, i, 1));
      const flat = unit(cross(sub(p[1], p[0]), sub(p[2], p[0])));
      corner.forEach((i, k) => out.push(...p[k], ...(normal ? unit(place(normal, i, 0)) : flat), ...color, metallic));
    }
  };
  const visit = (index, parent, depth) => {
    const node = json.nodes[index];
    if (!node || depth > 64) throw new Error("has nodes that are not there, or a loop of them");
    const m = multiply(parent, matrixOf(node));
    if (node.mesh !== undefined) json.meshes[node.mesh].primitives.forEach((p) => add(p, m));
    (node.children || []).forEach((child) => visit(child, m, depth + 1));
  };
  const identity = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
  ((json.scenes || [])[json.scene || 0]?.nodes || (json.nodes || []).map((_, i) => i)).forEach((n) => visit(n, identity, 0));
  if (!out.length) throw new Error("has no triangles");
  if (out.some((x) => !Number.isFinite(x))) throw new Error("has numbers that are not finite");
  return new Float32Array(out);
};
