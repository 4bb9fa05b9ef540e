// Drives the page of a result in headless Chromium: node viewer.cjs PAGE RENDERING PANORAMA OBJECT LAMP_PAGE LAMP_RENDERING
// LAMP_PAGE is the page of a result with a lamp, LAMP_RENDERING what `lumiscan render --lamp 0=*2` shows of it.
// Prints what it measured as JSON; exit code 1 and the reasons if the page misbehaves. Needs playwright-core (NODE_PATH).
const { chromium } = require("playwright-core");
const fs = require("fs");

const [page, rendering, panorama, object, lampPage, lampRendering] = process.argv.slice(2);
const problems = [], told = {};
const check = (holds, what) => { if (!holds) problems.push(what); };
const software = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--no-sandbox"];
const executablePath = process.env.CHROMIUM || "/usr/bin/chromium";

const open = async (args, width, height, options = {}, file = page) => {
  const browser = await chromium.launch({ executablePath, args });
  const context = await browser.newContext({ viewport: { width, height }, offline: true, ...options });
  const tab = await context.newPage();
  tab.on("console", (m) => { if (m.type() === "error") problems.push("console: " + m.text()); });
  tab.on("pageerror", (e) => problems.push("error: " + e.message));
  tab.on("request", (r) => { if (!/^(file|data|blob):/.test(r.url())) problems.push("the page asks the network for " + r.url()); });
  await tab.goto("file://" + file);
  return { browser, tab };
};
// Keeps what the canvas shows under a name, in the page.
const keep = (tab, name) => tab.evaluate((name) => {
  const gl = document.getElementById("view").getContext("webgl2"), w = gl.drawingBufferWidth, h = gl.drawingBufferHeight;
  const p = new Uint8Array(4 * w * h);
  gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, p);
  (window.kept ??= {})[name] = p;
  return [w, h];
}, name);
// Share of values by which what is shown now differs from what was kept.
const changed = async (tab, name) => {
  await keep(tab, "now");
  return tab.evaluate((name) => {
    const a = window.kept[name], b = window.kept.now;
    let n = 0;
    for (let i = 0; i < a.length; i++) if (Math.abs(a[i] - b[i]) > 8) n++;
    return n / a.length;
  }, name);
};
const set = (tab, id, value) => tab.evaluate(([id, value]) => {
  const e = document.getElementById(id);
  e.value = value; e.dispatchEvent(new Event("input", { bubbles: true }));
}, [id, value]);
// Squared differences and count of the values where what was kept as "own" shows the scan, against a picture.
const against = (tab, picture) => tab.evaluate(async (url) => {
  const image = new Image();
  image.src = url; await image.decode();
  const c = document.createElement("canvas"), w = c.width = image.width, h = c.height = image.height;
  const pen = c.getContext("2d");
  pen.drawImage(image, 0, 0);
  const theirs = pen.getImageData(0, 0, w, h).data, own = window.kept.own;
  // The page shows nothing beyond the scan, and a rendering blurs what is beyond into the outline.
  const outline = 3, near = new Uint8Array(w * h);
  for (let y = 0; y < h; y++) for (let x = 0; x < w; x++) {
    const a = 4 * ((h - 1 - y) * w + x);
    if (own[a] !== 23 || own[a + 1] !== 24 || own[a + 2] !== 27) continue;
    for (let v = Math.max(0, y - outline); v <= Math.min(h - 1, y + outline); v++)
      near.fill(1, v * w + Math.max(0, x - outline), v * w + Math.min(w, x + outline + 1));
  }
  let sum = 0, n = 0;
  for (let y = 0; y < h; y++) for (let x = 0; x < w; x++) {
    const a = 4 * ((h - 1 - y) * w + x), b = 4 * (y * w + x);
    if (near[y * w + x]) continue;
    for (let k = 0; k < 3; k++) sum += (own[a + k] - theirs[b + k]) ** 2;
    n += 3;
  }
  return [sum, n];
}, "data:image/png;base64," + fs.readFileSync(picture).toString("base64"));
(async () => {
  const [width, height] = [640, 480];
  const { browser, tab } = await open(software, width + 304, height);

  // From keyframe 0's place: the same as `lumiscan render` shows there.
  await set(tab, "keyframe", "0");
  await set(tab, "blend", "0");
  const [w, h] = await keep(tab, "own");
  check(w === width && h === height, `the canvas is ${w}x${h}`);
  const [sum, n] = await against(tab, rendering);
  told.covered = n / 3 / (w * h);
  told.psnr_db = 10 * Math.log10(255 * 255 / (sum / n));
  check(told.covered > 0.1, `only ${told.covered} of the picture is drawn`);
  check(told.psnr_db >= 30, `${told.psnr_db} dB against lumiscan render`);

  // Every way to show it differs from the first.
  for (const mode of ["2", "3", "4", "5", "6"]) {
    await set(tab, "mode", mode);
    check(await changed(tab, "own") > 0.02, `mode ${mode} shows nothing else`);
  }

  // Relighting: the light turned, raised, and replaced by a panorama.
  await set(tab, "mode", "1");
  await keep(tab, "lit");
  await set(tab, "yaw", "150");
  check(await changed(tab, "lit") > 0.01, "turning the light changes nothing");
  await keep(tab, "turned");
  await set(tab, "tilt", "60");
  check(await changed(tab, "turned") > 0.01, "raising the light changes nothing");
  await set(tab, "tilt", "0");
  await tab.setInputFiles("#light", panorama);
  await tab.waitForTimeout(500);
  check(await changed(tab, "turned") > 0.01, "a panorama changes nothing");

  // A click tells of a segment; balls and objects are put on the surface.
  const picked = await tab.evaluate(() => window.lumiscan.click(0.5, 0.6));
  check(Number.isInteger(picked), "a click picks nothing");
  check(/Segment \d+/.test(await tab.textContent("#told")), "a click tells nothing");
  // Clicks from the keyframes that are told, one after the other, come back to the same pixel. Two keyframes may show a point equally well.
  const reference = async () => (await tab.textContent("#told")).match(/--reference keyframe:(\d+):(\d+),(\d+)=0\.9$/)?.slice(1).map(Number);
  const told_pixels = new Map();
  for (let step = 0, at = await reference(); step < 6; step++, at = await reference()) {
    check(at, "a click tells no reference");
    if (!at) break;
    const [k, x, y] = at, before = told_pixels.get(k);
    if (before) {
      check(Math.hypot(before[0] - x, before[1] - y) <= 1.5, `keyframe ${k}: a reference ${before} became ${x},${y}`);
      break;
    }
    told_pixels.set(k, [x, y]);
    await tab.evaluate(([k, x, y]) => {
      const { width, height } = JSON.parse(document.getElementById("facts").textContent).keyframes[k];
      window.lumiscan.view(k); window.lumiscan.click((x + 0.5) / width, (y + 0.5) / height);
    }, [k, x, y]);
  }
  check(told_pixels.size > 0, "no keyframe is told");
  await set(tab, "keyframe", "0");
  await keep(tab, "before");
  for (const kind of ["mirror", "grey"]) {
    await set(tab, "click", kind);
    await tab.evaluate(() => window.lumiscan.click(0.5, 0.6));
    check(await changed(tab, "before") > 0.002, `a ${kind} ball does not show`);
  }
  await tab.setInputFiles("#light", object);
  await tab.waitForTimeout(500);
  check(await tab.evaluate(() => document.getElementById("click").value) === "file", "a GLB is not taken: " + await tab.textContent("#told"));

  // Keys turn and zoom.
  await tab.focus("#view");
  await set(tab, "keyframe", "");
  for (const key of ["ArrowLeft", "ArrowUp", "+", "-", ">"]) {
    await keep(tab, "then");
    await tab.keyboard.press(key);
    check(await changed(tab, "then") > 0.001, `the key ${key} does nothing`);
  }
  const reachable = await tab.evaluate(() => [...document.querySelectorAll("canvas, select, input, summary")].every((e) => e.tabIndex >= 0));
  check(reachable, "something is not reachable by keys");

  // Frames a second while the light changes in every one.
  const timed = await tab.evaluate(() => {
    const yaw = document.getElementById("yaw"), start = performance.now();
    let frames = 0;
    while (performance.now() - start < 3000) { yaw.value = frames * 7 % 360 - 180; window.lumiscan.draw(); window.lumiscan.finish(); frames++; }
    return frames / ((performance.now() - start) / 1000);
  });
  told.frames_per_second = timed;
  await browser.close();

  // A lamp: twice as bright as `lumiscan render` shows it, switched off, moved, and off under a panorama.
  const lit = await open(software, width + 304, height, {}, lampPage);
  const lamp = (change) => lit.tab.evaluate((change) => { Object.assign(window.lumiscan.near.lamps[0], change); window.lumiscan.draw(); }, change);
  await set(lit.tab, "keyframe", "0");
  await set(lit.tab, "blend", "0");
  await set(lit.tab, "mode", "1");
  await lamp({ power: 2 });
  await keep(lit.tab, "own");
  const [lampSum, lampCount] = await against(lit.tab, lampRendering);
  told.lamp_psnr_db = 10 * Math.log10(255 * 255 / (lampSum / lampCount));
  check(told.lamp_psnr_db >= 25, `${told.lamp_psnr_db} dB against lumiscan render --lamp`);
  await lamp({ power: 0 });
  check(await changed(lit.tab, "own") > 0.05, "a lamp that is switched off changes nothing");
  await lamp({ power: 1 });
  await keep(lit.tab, "lamp");
  const slid = await lit.tab.evaluate(() => {
    const sliders = [...document.querySelectorAll("#lamps input")];
    sliders[1].value = sliders[1].max; sliders[1].dispatchEvent(new Event("input", { bubbles: true }));
    return [sliders.length, window.lumiscan.near.lamps[0].moved];
  });
  check(slid[0] === 4 && slid[1] === true, `sliders of the lamp: ${slid}`);
  check(await changed(lit.tab, "lamp") > 0.02, "a lamp that is moved changes nothing");
  await lit.tab.setInputFiles("#light", panorama);
  await lit.tab.waitForTimeout(500);
  check(await lit.tab.evaluate(() => window.lumiscan.near.lamps[0].power) === 0, "a panorama leaves the lamp on");
  await lit.browser.close();

  // A phone's width: nothing overflows.
  const phone = await open(software, 375, 700, { hasTouch: true, isMobile: true });
  const overflow = await phone.tab.evaluate(() => document.documentElement.scrollWidth - window.innerWidth);
  check(overflow <= 0, `${overflow} pixels too wide for 375`);
  await phone.browser.close();

  // Without WebGL: a message and a picture.
  const without = await open(["--disable-gpu", "--disable-3d-apis", "--no-sandbox"], 800, 600);
  check(await without.tab.isVisible("#without p"), "no message without WebGL");
  check(await without.tab.evaluate(() => { const i = document.querySelector("#without img"); return !!i && i.naturalWidth > 0; }), "no picture without WebGL");
  await without.browser.close();

  console.log(JSON.stringify(told));
  if (problems.length) { console.error(problems.join("\n")); process.exit(1); }
})().catch((e) => { console.error(e.stack); process.exit(1); });
