// The live page: status by events, pictures and surface by asking for the next one when the last is drawn, so that a slow
// link or a slow phone skips pictures instead of falling behind.
import { $, bytes, element, pause, send, time } from "./common.js";
import { Light } from "./light.js";
import { Map2d } from "./map.js";
import { VirtualObject } from "./object.js";
import { Surface } from "./surface.js";

const surface = new Surface($("surface")), map = new Map2d($("map"));
const light = new Light(), object = new VirtualObject();
let status = null, keyframes = [], shownPose = null, wasLost = false, audio = null, kept = -1, scan = null;

const words = {
  waiting: "no sensor", ready: "ready", scanning: "scanning", finishing: "finishing", estimating: "estimating", done: "done",
};

function show() {
  const { live, state } = status, scanning = state === "scanning", lost = scanning && live.tracking === "lost";
  const paused = scanning && live.paused;
  $("state").className = `chip ${lost ? "lost" : paused ? "paused" : state}`;
  $("state").textContent = lost ? "lost" : paused ? "paused" : words[state] ?? state;
  $("start").hidden = scanning || state === "done";
  $("start").disabled = state !== "ready";
  for (const id of ["pause", "stop", "discard"]) $(id).hidden = !scanning;
  $("pause").textContent = paused ? "Resume" : "Pause";
  for (const id of ["naming", "name"]) $(id).hidden = !scanning;
  $("stage").classList.toggle("lost", lost);

  const share = scanning ? Math.round(100 * live.margin) : 0, meter = $("margin");
  meter.setAttribute("aria-valuenow", share);
  meter.className = share <= 1 ? "none" : share < 60 ? "low" : "";
  meter.firstElementChild.style.transform = `scaleX(${lost ? 1 : share / 100})`;
  const step = status.step && (state === "finishing" || state === "estimating")
    ? `Step: ${status.step.stage}${status.step.fraction == null ? "" : ` ${Math.round(100 * status.step.fraction)} %`}` : "";
  const advice = !scanning ? step : paused ? "Paused: nothing is added" : live.advice ?? "";
  if ($("advice").textContent !== advice) $("advice").textContent = advice;

  const message = {
    waiting: status.last_error ?? "Plug in the Kinect and its power supply",
    ready: `${status.sensor ?? "The sensor"} is ready.\n\nStart, then move slowly around the scene, 0.5 to 3 m away, until all of it is teal.`,
    finishing: "Making the mesh", estimating: "Finding light and materials", done: status.last_scan ? "The scan is finished" : "Discarded",
  }[state];
  $("message").hidden = scanning;
  $("message").textContent = message ?? "";
  $("result").hidden = scanning || !status.last_scan;
  if (status.last_scan) $("open").href = `/scans#${status.last_scan.split("/").pop()}`;

  way_back(lost ? live.way_back : null);
  if (lost && !wasLost) alarm();
  wasLost = lost;
  figures();
}

function figures() {
  const { live, scan: s, drops } = status, [used, total] = live.blocks;
  const rows = [
    ["time", s ? `${time(s.seconds)} / ${time(status.max_scan_s)}` : "–"],
    ["frames/s", s ? s.fps.toFixed(1) : "–"],
    ["surface", s ? `${s.coverage_m2.toFixed(2)} m²` : "–"],
    ["keyframes", s ? s.kept_frames : "–"],
    ["voxel", live.voxel_size_m ? `${(1000 * live.voxel_size_m).toFixed(1)} mm` : "–"],
    ["voxel pool", total ? `${Math.round(100 * used / total)} %` : "–"],
    ["memory", bytes(status.memory_bytes)],
    ["disk left", bytes(status.disk_free_bytes)],
    ["times lost", live.losses],
    ["pairs dropped", drops.dropped_pairs],
  ];
  $("figures").replaceChildren(...rows.flatMap(([k, v]) => [element("dt", { textContent: k }), element("dd", { textContent: v })]));
}

// The picture to go back to, over the live one.
function way_back(number) {
  const image = $("back");
  image.hidden = number == null;
  if (number == null || kept === number) return;
  image.onload = () => { document.documentElement.dataset.wayBack = number; };
  image.src = `/api/kept/${kept = number}.jpg`;
}

function alarm() {
  navigator.vibrate?.([200, 100, 200]);
  if (!audio) return;
  const tone = audio.createOscillator(), level = audio.createGain();
  tone.frequency.value = 440;
  level.gain.value = 0.2;
  tone.connect(level).connect(audio.destination);
  tone.start();
  tone.stop(audio.currentTime + 0.3);
}

function follow() {
  const events = new EventSource("/api/events");
  events.addEventListener("status", (e) => {
    status = JSON.parse(e.data);
    surface.good = status.live.good_weight;
    if (status.scan && status.scan.name !== scan) begin(status.scan.name);
    light.follow(status.live.light).catch(() => { light.number = 0; });
    show();
  });
  events.onerror = () => {
    $("state").className = "chip gone";
    $("state").textContent = "no connection";
    if (events.readyState === EventSource.CLOSED) setTimeout(follow, 2000);
  };
}

function begin(name) {
  scan = name;
  map.clear();
  object.place = null;
  keyframes = [];
  $("name").value = status.name ?? "";
}

async function pictures() {
  const pen = $("picture").getContext("2d");
  for (let last = 0; ;) {
    try {
      const answer = await fetch(`/api/live.jpg?after=${last}`);
      if (answer.status !== 200) { await pause(answer.ok ? 0 : 300); continue; }
      const number = Number(answer.headers.get("X-Number")), pose = answer.headers.get("X-Pose");
      // Numbers start anew when the box does.
      last = number;
      const image = await createImageBitmap(await answer.blob());
      if (pen.canvas.width !== image.width || pen.canvas.height !== image.height) {
        Object.assign(pen.canvas, { width: image.width, height: image.height });
      }
      pen.drawImage(image, 0, 0);
      image.close();
      if (pose) {
        shownPose = pose.split(" ").map(Number);
        map.moved(shownPose);
      }
      draw();
      document.documentElement.dataset.picture = number;
    } catch {
      last = 0;
      await pause(1000);
    }
  }
}

function draw() {
  if (!status || !shownPose) return;
  // Where the camera is not known, neither is where anything stands in its picture.
  if (wasLost) {
    surface.blank();
    return;
  }
  surface.draw(status.live.camera, shownPose);
  object.draw(surface, light.light, status.live.camera, shownPose);
}

async function surfaces() {
  for (;;) {
    try {
      const answer = await fetch(`/api/surface?generation=${surface.generation}&since=${surface.change}`);
      const size = answer.ok ? surface.take(await answer.arrayBuffer()) : 0;
      document.documentElement.dataset.surfels = surface.surfels;
      // A long answer is followed by the rest.
      await pause(size > 2e5 ? 30 : 350);
    } catch {
      await pause(1000);
    }
  }
}

async function overview() {
  for (let turn = 0; ; turn++) {
    try {
      if (turn % 3 === 0 && status?.scan) keyframes = await (await fetch("/api/keyframes")).json();
    } catch { /* The next turn asks again. */ }
    light.draw(shownPose);
    if (status && surface.voxel) map.draw(surface, keyframes, shownPose, wasLost);
    await pause(500);
  }
}

async function order(name, body) {
  try {
    await send(`/api/scan/${name}`, body);
  } catch (e) {
    $("advice").textContent = e.message;
  }
}

$("start").onclick = () => order("start");
$("stop").onclick = () => order("stop");
$("pause").onclick = () => order(status?.live.paused ? "resume" : "pause");
$("discard").onclick = () => $("sure").showModal();
$("sure").onclose = () => { if ($("sure").returnValue === "yes") order("discard"); $("sure").returnValue = ""; };
$("name").onchange = () => { if ($("name").value.trim()) order("name", { name: $("name").value }); };
$("alarm").onclick = () => {
  audio = audio ? (audio.close(), null) : new AudioContext();
  $("alarm").setAttribute("aria-pressed", audio !== null);
};
for (const button of document.querySelectorAll("#show button")) {
  button.onclick = () => {
    for (const other of document.querySelectorAll("#show button")) other.setAttribute("aria-pressed", other === button);
    $("stage").classList.toggle("surface", button.dataset.show === "surface");
    surface.opacity = { both: 0.55, picture: 0, surface: 1 }[button.dataset.show];
    draw();
  };
}

// A tap places the object on the surface.
$("surface").onclick = (e) => {
  const camera = status?.live.camera, box = $("surface").getBoundingClientRect();
  if (!camera || !shownPose || wasLost) return;
  const { width, height } = camera.intrinsics, scale = Math.min(box.width / width, box.height / height);
  const u = (e.clientX - box.left - (box.width - scale * width) / 2) / scale - 0.5;
  const v = (e.clientY - box.top - (box.height - scale * height) / 2) / scale - 0.5;
  if (!light.light) $("advice").textContent = "The light is not known yet: scan on";
  else if (object.put(surface, camera, shownPose, u, v)) {
    document.documentElement.dataset.object = "placed";
    draw();
  }
};

follow();
pictures();
surfaces();
overview();
