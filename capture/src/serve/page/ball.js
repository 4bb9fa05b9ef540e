// A ball of radius 1 that stands on the origin, as a GLB file: what the viewer puts on the surface, for the box to render.
export function ball(color, metallic) {
  const rings = 48, sectors = 96, positions = [], normals = [], triangles = [];
  for (let i = 0; i <= rings; i++) for (let j = 0; j <= sectors; j++) {
    const a = Math.PI * i / rings, b = 2 * Math.PI * j / sectors;
    const n = [Math.sin(a) * Math.cos(b), Math.cos(a), -Math.sin(a) * Math.sin(b)];
    normals.push(...n);
    positions.push(n[0], n[1] + 1, n[2]);
    if (i === rings || j === sectors) continue;
    const k = i * (sectors + 1) + j, below = k + sectors + 1;
    triangles.push(k, below, k + 1, k + 1, below, below + 1);
  }
  const parts = [new Float32Array(positions), new Float32Array(normals), new Uint16Array(triangles)];
  let start = 0;
  const views = parts.map((p) => { const view = { buffer: 0, byteOffset: start, byteLength: p.byteLength }; start += p.byteLength; return view; });
  const count = positions.length / 3;
  const json = {
    asset: { version: "2.0" }, scene: 0, scenes: [{ nodes: [0] }], nodes: [{ mesh: 0 }],
    meshes: [{ primitives: [{ attributes: { POSITION: 0, NORMAL: 1 }, indices: 2, material: 0 }] }],
    materials: [{ pbrMetallicRoughness: { baseColorFactor: [...color, 1], metallicFactor: metallic, roughnessFactor: metallic ? 0 : 1 } }],
    accessors: [
      { bufferView: 0, componentType: 5126, count, type: "VEC3", min: [-1, 0, -1], max: [1, 2, 1] },
      { bufferView: 1, componentType: 5126, count, type: "VEC3" },
      { bufferView: 2, componentType: 5123, count: triangles.length, type: "SCALAR" },
    ],
    bufferViews: views, buffers: [{ byteLength: start }],
  };
  const text = new TextEncoder().encode(JSON.stringify(json)), padding = (4 - text.length % 4) % 4;
  const word = (...values) => new Uint32Array(values);
  return new Blob([
    word(0x46546c67, 2, 28 + text.length + padding + start, text.length + padding, 0x4e4f534a), text, " ".repeat(padding),
    word(start, 0x004e4942), ...parts,
  ]);
}
