// three.js reads what is exported: node three.cjs FOLDER (with result.glb, light.hdr, light.exr). Prints what it found.
const fs = require("fs"), path = require("path"), { pathToFileURL } = require("url");
const addon = (name) => import(pathToFileURL(path.join(path.dirname(require.resolve("three")), "../examples/jsm/loaders", name)));
const buffer = (name) => { const b = fs.readFileSync(path.join(process.argv[2], name)); return b.buffer.slice(b.byteOffset, b.byteOffset + b.length); };
globalThis.self = globalThis;
// Node decodes no pictures: what matters here is that three.js finds the texture's bytes.
globalThis.createImageBitmap = async (blob) => {
  const b = new DataView(await blob.arrayBuffer());
  for (let at = 2; ; at += 2 + b.getUint16(at + 2)) {
    if (b.getUint8(at + 1) === 0xc0) return { width: b.getUint16(at + 7), height: b.getUint16(at + 5), close: () => {} };
  }
};
(async () => {
  const { GLTFLoader } = await addon("GLTFLoader.js");
  const gltf = await new GLTFLoader().parseAsync(buffer("result.glb"), "");
  const found = { vertices: new Set(), triangles: 0, cameras: gltf.cameras.length, materials: new Set(), textured: true, sizes: new Set(), lamps: [] };
  gltf.scene.updateMatrixWorld(true);
  gltf.scene.traverse((o) => {
    if (o.isPointLight) found.lamps.push({ place: o.parent.localToWorld(o.position.clone()).toArray(), color: o.color.toArray(), intensity: o.intensity });
    if (!o.isMesh) return;
    found.vertices.add(o.geometry.attributes.position.count);
    found.triangles += o.geometry.index.count / 3;
    found.materials.add(o.material.name);
    found.textured &&= !!o.geometry.attributes.uv && !!o.material.map;
    if (o.material.map) found.sizes.add(o.material.map.image.width + "x" + o.material.map.image.height);
  });
  const hdr = new (await addon("HDRLoader.js")).HDRLoader().parse(buffer("light.hdr"));
  const exr = new (await addon("EXRLoader.js")).EXRLoader().parse(buffer("light.exr"));
  console.log(JSON.stringify({ vertices: [...found.vertices], triangles: found.triangles, cameras: found.cameras,
    materials: found.materials.size, textured: found.textured, sizes: [...found.sizes], lamps: found.lamps, hdr: [hdr.width, hdr.height], exr: [exr.width, exr.height] }));
})().catch((e) => { console.error(e.stack); process.exit(1); });
