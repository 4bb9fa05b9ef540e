// Has a view of the viewer rendered by the box, in headless Chromium: node render_page.cjs URL SCAN FOLDER
// Puts a mirror ball on the scan from a turned view; the box's picture has to show it where the viewer does. Prints what it measured as
// JSON; exit code 1 and the reasons if the page misbehaves. Needs playwright-core and, for the checks of accessibility, axe-core
// (NODE_PATH). Screenshots go to FOLDER.
const { chromium } = require("playwright-core");
const fs = require("fs");
const path = require("path");

const [url, scan, folder] = process.argv.slice(2);
const problems = [], told = {};
const check = (holds, what) => { if (!holds) problems.push(what); };
const software = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--no-sandbox"];
const PATIENCE = 240000;

let axe = null;
try { axe = fs.readFileSync(require.resolve("axe-core/axe.min.js"), "utf8"); } catch { console.error("skipped: axe-core is not found, accessibility is not checked"); }
async function accessible(frame, name) {
  if (!axe) return;
  // Evaluated beside the pages, whose policy lets no foreign script in.
  await frame.evaluate(axe);
  const { violations } = await frame.evaluate(() => window.axe.run());
  for (const v of violations) problems.push(`${name}: ${v.id}: ${v.help}: ${v.nodes.slice(0, 2).map((n) => n.html).join(" | ")}`);
  told[`axe_${name}`] = violations.length;
}

(async () => {
  const browser = await chromium.launch({ executablePath: process.env.CHROMIUM || "/usr/bin/chromium", args: software });
  const context = await browser.newContext({ viewport: { width: 390, height: 844 }, hasTouch: true });
  const tab = await context.newPage();
  tab.on("console", (m) => { if (m.type() === "error") problems.push("console: " + m.text()); });
  tab.on("pageerror", (e) => problems.push("error: " + e.message));
  await tab.goto(url);
  await tab.goto(new URL("/scans", url).href);
  await tab.click(".card >> text=Picture…");
  await tab.waitForURL(/\/render\?scan=/);
  const viewer = tab.frames().find((f) => f.url().includes("viewer.html")) ?? await tab.waitForEvent("frameattached");
  await viewer.waitForSelector("#view");
  await viewer.waitForFunction(() => window.lumiscan !== undefined, null, { timeout: PATIENCE });
  await accessible(tab.mainFrame(), "picture");
  await accessible(viewer, "viewer");
  await viewer.selectOption("#click", "mirror");
  await viewer.evaluate(() => { for (const key of [...Array(16).fill("ArrowRight"), "ArrowUp", "+", "+"]) document.getElementById("view").dispatchEvent(new KeyboardEvent("keydown", { key })); });
  const canvas = async () => (await viewer.evaluate(() => { window.lumiscan.draw(); return document.getElementById("view").toDataURL(); })).split(",")[1];
  const without = await canvas();
  await viewer.evaluate(() => window.lumiscan.click(0.62, 0.66));
  await viewer.evaluate(() => window.scrollTo(0, 0));
  await tab.selectOption("#width", "640");
  const rendered = async (n) => {
    await tab.click("#go");
    await tab.waitForFunction((n) => Number(document.documentElement.dataset.rendered) >= n || (!document.getElementById("go").disabled && document.getElementById("told").textContent), n, { timeout: PATIENCE });
    const said = await tab.textContent("#told");
    check(said === "", "the page says: " + said);
    return (await (await context.request.get(new URL("/api/render.png", url).href)).body());
  };
  const first = await rendered(1);
  fs.writeFileSync(path.join(folder, "rendered.png"), first);
  await (await viewer.$("#view")).screenshot({ path: path.join(folder, "viewed.png") });

  const withBall = await canvas();

  // Without the ball, the picture is another just where the viewer shows it.
  await tab.uncheck("#insert");
  const second = await rendered(2);
  const place = (pictures) => tab.evaluate(async (pictures) => {
    const N = 128;
    const pixels = async (base64) => {
      const image = await createImageBitmap(new Blob([Uint8Array.from(atob(base64), (c) => c.charCodeAt(0))]));
      const pen = new OffscreenCanvas(N, N).getContext("2d");
      pen.drawImage(image, 0, 0, N, N);
      return pen.getImageData(0, 0, N, N).data;
    };
    const [p, q] = await Promise.all(pictures.map(pixels)), x = [], y = [];
    for (let i = 0; i < N * N; i++) {
      if ([0, 1, 2].every((c) => Math.abs(p[4 * i + c] - q[4 * i + c]) < 40)) continue;
      x.push(i % N / N);
      y.push(Math.floor(i / N) / N);
    }
    const middle = (v) => v.sort((a, b) => a - b)[v.length >> 1];
    return [middle(x), middle(y), Math.sqrt(x.length) / N];
  }, pictures);
  const [inViewer, inPicture] = [await place([without, withBall]), await place([second, first].map((b) => b.toString("base64")))];
  told.ball = { inViewer, inPicture };
  check(inViewer.every((v, k) => Math.abs(v - inPicture[k]) < 0.04), "the box shows the ball elsewhere, or of another size: " + JSON.stringify(told.ball));
  await tab.screenshot({ path: path.join(folder, "render_page.png"), fullPage: true });
  await browser.close();
  console.log(JSON.stringify(told));
  if (problems.length) { console.error(problems.join("\n")); process.exit(1); }
})();
