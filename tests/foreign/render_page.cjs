// Has a view of the viewer rendered by the box, in headless Chromium: node render_page.cjs URL SCAN FOLDER
// Puts a mirror ball on the scan from a turned view and compares the box's picture with what the viewer shows. Prints what it measured as
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
  await viewer.evaluate(() => { for (const key of ["ArrowLeft", "ArrowDown"]) document.getElementById("view").dispatchEvent(new KeyboardEvent("keydown", { key })); });
  await viewer.evaluate(() => window.lumiscan.click(0.5, 0.5));
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

  // The same silhouette of the scan, from the same place: the viewer's canvas against the box's picture.
  const shown = (await viewer.evaluate(() => document.getElementById("view").toDataURL())).split(",")[1];
  const likeness = await tab.evaluate(async ([a, b]) => {
    const pixels = async (base64) => {
      const image = await createImageBitmap(new Blob([Uint8Array.from(atob(base64), (c) => c.charCodeAt(0))]));
      const canvas = new OffscreenCanvas(64, 64), pen = canvas.getContext("2d");
      pen.drawImage(image, 0, 0, 64, 64);
      return pen.getImageData(0, 0, 64, 64).data;
    };
    // Correlation of the logarithms of brightness, where the viewer shows the scan.
    const [p, q] = [await pixels(a), await pixels(b)], x = [], y = [];
    for (let i = 0; i < p.length; i += 4) {
      if (Math.abs(p[i] - 23) + Math.abs(p[i + 1] - 24) + Math.abs(p[i + 2] - 27) < 9) continue;
      x.push(Math.log(8 + p[i] + p[i + 1] + p[i + 2]));
      y.push(Math.log(8 + q[i] + q[i + 1] + q[i + 2]));
    }
    const mean = (v) => v.reduce((s, e) => s + e, 0) / v.length, mx = mean(x), my = mean(y);
    const dot = (u, v, mu, mv) => u.reduce((s, e, i) => s + (e - mu) * (v[i] - mv), 0);
    return dot(x, y, mx, my) / Math.sqrt(dot(x, x, mx, mx) * dot(y, y, my, my));
  }, [shown, first.toString("base64")]);
  told.likeness = likeness;
  check(likeness > 0.7, `the picture is not what the viewer shows: correlation ${likeness}`);

  // Without the ball, the picture is another.
  await tab.uncheck("#insert");
  const second = await rendered(2);
  check(!first.equals(second), "the ball is in the picture");
  await tab.screenshot({ path: path.join(folder, "render_page.png"), fullPage: true });
  await browser.close();
  console.log(JSON.stringify(told));
  if (problems.length) { console.error(problems.join("\n")); process.exit(1); }
})();
