// The device page: the scans of the box, and the box itself.
import { $, bytes, element, pause, send, time } from "./common.js";

let drawn = "";

const when = (utc) => (/^\d{8}T\d{6}Z$/.test(utc ?? "")
  ? new Date(utc.replace(/(....)(..)(..)T(..)(..)(..)Z/, "$1-$2-$3T$4:$5:$6Z")).toLocaleString() : "");

// Asks the user; resolves to the text (or true where none is asked for), or null.
function ask(question, yes, text) {
  $("question").textContent = question;
  $("yes").textContent = yes;
  $("yes").className = text === undefined ? "danger" : "main";
  $("answer").hidden = text === undefined;
  $("answer").value = text ?? "";
  $("ask").returnValue = "";
  $("ask").showModal();
  return new Promise((done) => {
    $("ask").onclose = () => done($("ask").returnValue !== "yes" ? null : text === undefined ? true : $("answer").value);
  });
}

async function act(work) {
  try {
    $("told").textContent = "";
    await work();
    await refresh();
  } catch (e) {
    $("told").textContent = e.message;
  }
}

function card(s, job) {
  const link = (name) => `/scans/${s.id}/${name}`, has = (name) => s.files.some(([n]) => n === name);
  const api = `/api/scans/${s.id}`, running = job && !job.done;
  const e = element("article", { className: "card", id: s.id });
  e.append(has("preview.png")
    ? element("img", { src: link("preview.png"), alt: `Preview of ${s.name}`, loading: "lazy" }) : element("div"));
  const facts = [when(s.published), s.seconds == null ? "" : s.seconds < 60 ? `${Math.round(s.seconds)} s` : `${time(s.seconds)} min`, bytes(s.bytes),
    s.vertices == null ? "" : `${s.vertices} vertices, ${s.keyframes} keyframes`].filter(Boolean).join(" · ");
  const told = element("div", {}, element("h2", { textContent: s.name }), element("p", { textContent: facts }));
  const outcome = { failed: `No result: ${s.problem ?? "the estimator failed"}`, partial: `Partial result: ${s.problem ?? ""}`, skipped: "Not estimated" }[s.outcome];
  for (const text of [outcome, ...(s.warnings ?? []), ...(s.cuts ?? [])].filter(Boolean)) {
    told.append(element("p", { className: "warning", textContent: text }));
  }
  if (job?.scan === s.id) {
    const share = job.step?.fraction == null ? "" : ` ${Math.round(100 * job.step.fraction)} %`;
    const doing = job.work === "render" ? "Rendering a picture" : `Estimating again (${job.quality})`;
    const over = job.problem ?? (job.work === "render" ? "The picture is ready" : "Estimated again");
    told.append(element("p", { textContent: job.done ? over : `${doing}: ${job.step?.stage ?? "starting"}${share}` }));
  }
  e.append(told);
  const actions = element("div", { className: "actions" });
  if (has("viewer.html")) actions.append(element("a", { href: link("viewer.html"), className: "main", textContent: "Open" }));
  if (has("viewer.html") && has("result.lres")) actions.append(element("a", { href: `/render?scan=${encodeURIComponent(s.id)}`, textContent: "Picture…" }));
  actions.append(element("a", { href: `/scans/${s.id}.tar`, textContent: "Download all" }));
  const quality = element("select", { disabled: running });
  quality.setAttribute("aria-label", `Estimate ${s.name} again`);
  for (const [value, text] of [["", "Estimate again…"], ["draft", "draft"], ["standard", "standard"], ["best", "best"]]) {
    quality.append(element("option", { value, textContent: text }));
  }
  quality.onchange = () => quality.value && act(() => send(`${api}/estimate`, { quality: quality.value }));
  const rename = element("button", { type: "button", textContent: "Rename", onclick: async () => {
    const name = await ask("New name", "Rename", s.name);
    if (name) act(() => send(`${api}/name`, { name }));
  } });
  const remove = element("button", { type: "button", className: "danger", textContent: "Delete", onclick: async () => {
    if (await ask(`Delete “${s.name}” and all its files?`, "Delete")) act(() => send(api, undefined, "DELETE"));
  } });
  actions.append(quality, rename, remove);
  const files = element("ul", { className: "files" });
  for (const [name, size] of s.files) {
    files.append(element("li", {}, element("a", { href: `${link(name)}?download`, textContent: name }), element("span", { textContent: bytes(size) })));
  }
  e.append(actions, element("details", {}, element("summary", { textContent: "Files" }), files));
  return e;
}

async function refresh() {
  const { scans, job } = await (await fetch("/api/scans")).json();
  const text = JSON.stringify([scans, job]);
  if (text === drawn) return;
  drawn = text;
  const open = new Set([...document.querySelectorAll(".card details[open]")].map((d) => d.closest(".card").id));
  $("list").replaceChildren(...(scans.length ? scans.map((s) => card(s, job)) : [element("p", { textContent: "There are no scans yet." })]));
  for (const id of open) document.getElementById(id)?.querySelector("details").setAttribute("open", "");
  if (location.hash) document.getElementById(decodeURIComponent(location.hash.slice(1)))?.scrollIntoView();
}

const opened = (id, work) => $(id).addEventListener("toggle", (e) => { if (e.target === $(id) && $(id).open) act(work); });
const rows = (id, list) => $(id).replaceChildren(...list.map((cells) => element("tr", {}, ...cells.map((c) => element("td", {}, c)))));

// A setting that may change; it holds from the next scan on.
function field(s) {
  const input = element("input", { value: String(s.value).replace(/^"|"$/g, ""), title: [s.unit, s.range].filter(Boolean).join(", ") });
  input.setAttribute("aria-label", `${s.key} ${s.unit}`);
  input.onchange = () => act(() => send("/api/settings", { settings: { [s.key]: input.value } }));
  return input;
}

opened("box", async () => {
  const [status, told] = await Promise.all(["/api/status", "/api/settings"].map(async (u) => (await fetch(u)).json()));
  $("version").textContent = `Lumiscan ${status.lumiscan} · ${status.sensor ?? "no sensor"} · memory ${bytes(status.memory_bytes)} · disk left ${bytes(status.disk_free_bytes)}`;
  $("auto").checked = told.auto;
  rows("settings", told.settings.map((s) => [s.key, s.changes ? field(s) : `${s.value} ${s.unit}`, s.doc]));
});
$("auto").onchange = () => act(() => send("/api/settings", { auto: $("auto").checked }));
opened("pair", async () => {
  const { url, qr } = await send("/api/pair");
  $("address").textContent = url;
  $("qr").src = URL.createObjectURL(new Blob([qr], { type: "image/svg+xml" }));
  $("qr").hidden = false;
});
opened("diagnosis", async () => {
  rows("findings", [["Checking: this takes some seconds"]]);
  const answer = await fetch("/api/check"), told = await answer.json();
  if (!answer.ok) throw new Error(told.error);
  rows("findings", told.map((f) => [f.verdict, f.what, [f.detail, f.remedy].filter(Boolean).join(": ")]));
});
opened("log", async () => {
  $("lines").textContent = (await (await fetch("/api/log")).json()).join("\n");
});

(async () => {
  for (;;) {
    try {
      const status = await (await fetch("/api/status")).json();
      $("state").textContent = status.state;
      await refresh();
    } catch {
      $("state").textContent = "no connection";
    }
    await pause(2000);
  }
})();
