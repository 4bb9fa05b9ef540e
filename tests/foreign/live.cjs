// Drives a scan from the page in headless Chromium: node live.cjs URL FOLDER
// Pairs, starts, watches a loss and the way back, the light so far, pauses, stops, opens the result. On a phone in portrait, with
// a third of the processor. Prints what it measured as JSON; exit code 1 and the reasons if the page misbehaves. Needs
// playwright-core and, for the checks of accessibility, axe-core (NODE_PATH). Screenshots go to FOLDER.
const { chromium } = require("playwright-core");
const path = require("path");

const [url, folder] = process.argv.slice(2);
const problems = [], told = {};
// Answers that are not to be taken for faults: the console tells of them, too.
const expected = new Set(["403"]);
const check = (holds, what) => { if (!holds) problems.push(what); };
const software = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--no-sandbox"];
const PATIENCE = 300000;

let axe = null;
try { axe = require.resolve("axe-core/axe.min.js"); } catch { console.error("skipped: axe-core is not found, accessibility is not checked"); }
async function accessible(tab, name) {
  if (!axe) return;
  // The page's policy lets no foreign script in; the test's own goes in beside it.
  const session = await tab.context().newCDPSession(tab);
  await session.send("Runtime.evaluate", { expression: require("fs").readFileSync(axe, "utf8") });
  const { violations } = await tab.evaluate(() => window.axe.run());
  for (const v of violations) problems.push(`${name}: ${v.id}: ${v.help}: ${v.nodes.slice(0, 2).map((n) => n.html).join(" | ")}`);
  told[`axe_${name}`] = violations.length;
}

(async () => {
  const browser = await chromium.launch({ executablePath: process.env.CHROMIUM || "/usr/bin/chromium", args: software });
  const context = await browser.newContext({ viewport: { width: 390, height: 844 }, hasTouch: true });
  const tab = await context.newPage();
  const watch = (page) => {
    page.on("console", (m) => { if (m.type() === "error" && ![...expected].some((status) => m.text().includes(status))) problems.push("console: " + m.text()); });
    page.on("pageerror", (e) => problems.push("error: " + e.message));
    page.on("request", (r) => { if (!r.url().startsWith(new URL(url).origin) && !/^(data|blob):/.test(r.url())) problems.push("the page asks for " + r.url()); });
  };
  watch(tab);
  // What a phone does at a loss.
  await tab.addInitScript(() => {
    const alarms = window.alarms = { vibrated: 0, tones: 0 }, tone = AudioContext.prototype.createOscillator;
    navigator.vibrate = () => { alarms.vibrated++; return true; };
    AudioContext.prototype.createOscillator = function () { alarms.tones++; return tone.call(this); };
  });
  await (await context.newCDPSession(tab)).send("Emulation.setCPUThrottlingRate", { rate: 3 });
  const shot = (name) => tab.screenshot({ path: path.join(folder, `${name}.png`) });
  const until = (what, test, argument) => tab.waitForFunction(test, argument, { timeout: PATIENCE, polling: 30 }).catch(() => problems.push("never: " + what));
  const state = (name) => until(`state ${name}`, (name) => document.getElementById("state").textContent === name, name);

  // A stranger sees the pairing page; a wrong code is told.
  const origin = new URL(url).origin, whole = (name) => tab.evaluate(() => document.documentElement.scrollWidth <= innerWidth)
    .then((fits) => check(fits, `${name}: wider than the phone`));
  await tab.goto(`${origin}/?code=abcdefghijkm`);
  check((await tab.textContent("[role=alert]")).includes("wrong"), "a wrong code is told");
  await accessible(tab, "pairing");
  await whole("pairing");
  expected.clear();
  await tab.goto(url);
  check(new URL(tab.url()).pathname === "/" && !tab.url().includes("code"), "the code stays in the address: " + tab.url());
  await state("ready");
  await accessible(tab, "ready");
  await whole("ready");
  check(await tab.evaluate(() => Number(document.documentElement.dataset.surfels ?? 0) === 0), "a surface before there is a scan");
  await tab.click("#alarm");
  await tab.click("#start");
  await state("scanning");
  await until("pictures move", () => Number(document.documentElement.dataset.picture) > 8);
  // From nothing: a slow browser may get all of it in its first answer, since the simulated Kinect does not wait.
  await until("the surface grows", () => Number(document.documentElement.dataset.surfels) > 500);
  await shot("scanning");
  // The loss may be over before a slow browser is asked.
  await until("a loss, with the picture to go back to", () => document.documentElement.dataset.wayBack !== undefined);
  check(await tab.evaluate(() => document.getElementById("state").textContent !== "lost" || !document.getElementById("back").hidden),
    "lost without the picture to go back to");
  check(await tab.evaluate(() => window.alarms.vibrated > 0 && window.alarms.tones > 0), "a loss is neither felt nor heard");
  await shot("lost");
  await state("scanning");
  await until("the light so far", () => !document.getElementById("light").hidden);
  told.light = await tab.evaluate(async () => { const { cpu_s, vertices, seconds } = await (await fetch("/api/light")).json(); return { cpu_s, vertices, seconds }; });
  const stage = await tab.locator("#surface").boundingBox();
  await tab.mouse.click(stage.x + 0.42 * stage.width, stage.y + 0.6 * stage.height);
  await until("the object stands", () => document.documentElement.dataset.object === "placed");
  await tab.waitForTimeout(700);
  await shot("light");
  await accessible(tab, "scanning");
  await tab.click("#pause");
  await state("paused");
  const still = await tab.evaluate(async () => (await (await fetch("/api/status")).json()).live.blocks[0]);
  await tab.waitForTimeout(500);
  check(still === await tab.evaluate(async () => (await (await fetch("/api/status")).json()).live.blocks[0]), "a paused scan grows");
  await tab.click("#pause");
  await state("scanning");
  await tab.click("#discard");
  await tab.click("#sure button[value=no]");
  await tab.fill("#name", "window sill");
  await tab.press("#name", "Enter");
  await until("the name", async () => (await (await fetch("/api/status")).json()).name === "window sill");
  const status = await tab.evaluate(async () => (await fetch("/api/status")).json());
  told.dropped = status.drops.dropped_pairs;
  told.fps = status.scan.fps;
  await tab.click("#stop");
  await until("the result", () => !document.getElementById("result").hidden);
  await state("ready");
  await tab.click("#open");
  await tab.waitForSelector(".card a.main");
  check((await tab.textContent(".card h2")) === "window sill", "the scan has its name");
  await tab.waitForTimeout(300);
  await accessible(tab, "scans");
  await shot("scans");
  // A question is asked first.
  await tab.click(".card .danger");
  await tab.click("#ask button[value=no]");
  await tab.click(".card button >> text=Rename");
  await tab.fill("#answer", "sill");
  await tab.click("#yes");
  await until("the new name", () => document.querySelector(".card h2")?.textContent === "sill");
  await tab.selectOption(".card select", "draft");
  await until("the scan estimated again", () => [...document.querySelectorAll(".card p")].some((p) => p.textContent === "Estimated again"));
  for (const id of ["box", "pair", "diagnosis", "log"]) await tab.click(`#${id} > summary`);
  await tab.click("#box details > summary");
  await until("the QR code", () => document.getElementById("qr").naturalWidth > 0);
  await until("settings that may change", () => document.querySelectorAll("#settings input").length > 5);
  await until("findings of the diagnosis", () => document.querySelectorAll("#findings tr").length > 5);
  await until("log lines", () => document.getElementById("lines").textContent.includes("SIMULATED"));
  await accessible(tab, "box");
  await whole("box");
  await tab.screenshot({ path: path.join(folder, "box.png"), fullPage: true });
  await tab.click(".card a.main");
  await tab.waitForSelector("#view", { timeout: PATIENCE });
  await tab.waitForTimeout(2000);
  check(await tab.evaluate(() => { const c = document.getElementById("view"); return c.width > 0 && !!c.getContext("webgl2"); }), "the viewer draws");
  await shot("viewer");
  await browser.close();
  console.log(JSON.stringify(told));
  if (problems.length) { console.error(problems.join("\n")); process.exit(1); }
})();
