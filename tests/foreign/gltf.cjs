// The Khronos glTF validator: node gltf.cjs FILE.glb. Exit code 1 and its issues if there is an error.
const validator = require("gltf-validator");
const bytes = new Uint8Array(require("fs").readFileSync(process.argv[2]));
validator.validateBytes(bytes).then((report) => {
  console.log(JSON.stringify(report.issues, null, 1));
  process.exit(report.issues.numErrors || report.issues.numWarnings ? 1 : 0);
});
