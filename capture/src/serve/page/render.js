// A picture of a finished scan at full quality: the viewer in a frame says what it shows, the box renders it.
import { $, bytes, pause, send } from "./common.js";
import { ball } from "./ball.js";

const id = new URLSearchParams(location.search).get("scan") ?? "";
// Bytes of a piece of a file: a request's body holds 64 KiB.
const PIECE = 60000;

$("viewer").src = `/scans/${encodeURIComponent(id)}/viewer.html`;
fetch("/api/scans").then((answer) => answer.json()).then(({ scans }) => { $("name").textContent = scans.find((s) => s.id === id)?.name ?? id; });

// What the viewer shows. It is a document of its own without rights: what it says is taken as figures only.
function shown() {
  return new Promise((done, failed) => {
    const answered = (e) => {
      if (e.source !== $("viewer").contentWindow || e.data?.lumiscan !== "shown") return;
      window.removeEventListener("message", answered);
      done(e.data);
    };
    window.addEventListener("message", answered);
    setTimeout(() => { window.removeEventListener("message", answered); failed(new Error("the viewer does not answer; wait until it has opened")); }, 5000);
    $("viewer").contentWindow.postMessage({ lumiscan: "shown?" }, "*");
  });
}

async function upload(file, name) {
  for (let at = 0; at < file.size || at === 0; at += PIECE) {
    $("told").textContent = `Sending ${name}: ${bytes(at)} of ${bytes(file.size)}`;
    const answer = await fetch(`/api/render/files/${name}?offset=${at}`, { method: "POST", body: file.slice(at, at + PIECE) });
    if (!answer.ok) throw new Error((await answer.json()).error);
  }
  return name;
}

// The name under which the box takes a file: its kind matters, not what it was called.
const named = (what, file) => `${what}.${file.name.split(".").pop().toLowerCase().replace(/[^a-z0-9]/g, "")}`;

// The viewer's view as a camera of the NeRF convention (right, up, back), at this width.
function camera(view, width) {
  const height = Math.round(width / view.aspect / 2) * 2, { right, down, forward, eye } = view;
  const rows = [0, 1, 2].map((i) => [right[i], -down[i], -forward[i], eye[i]]);
  return {
    view: { transform_matrix: [...rows, [0, 0, 0, 1]], fl_x: view.fx * width, fl_y: view.fy * height, cx: view.cx * width, cy: view.cy * height },
    size: [width, height],
  };
}

async function wish() {
  const view = await shown(), width = Number($("width").value);
  const atKeyframe = view.keyframe !== null;
  const picture = atKeyframe ? { view: `keyframe:${view.keyframe}` } : camera(view, width);
  if (atKeyframe && $("over").checked) picture.over = "photo";
  else if (atKeyframe) picture.size = [width, Math.round(width / view.keyframeAspect / 2) * 2];
  if ($("insert").checked && view.thing) {
    const { kind, at, scale, file } = view.thing;
    const name = kind === "file" ? await upload(file, named("object", file))
      : await upload(kind === "grey" ? ball([0.5, 0.5, 0.5], 0) : ball([0.95, 0.95, 0.95], 1), `${kind}.glb`);
    picture.insert = [{ object: name, at, scale }];
  }
  if ($("remove").checked) {
    if (!view.picked) throw new Error("click the object first: in the viewer, let a click tell of a segment");
    const [w, h] = picture.size ?? view.keyframeSize;
    picture.remove = [`point:${view.picked[0] * w},${view.picked[1] * h}`];
  }
  if ($("relight").checked) {
    picture.light = view.panorama ? await upload(view.panorama, named("light", view.panorama)) : `scan:${id}`;
    picture.light_yaw = view.yaw;
  }
  if (view.lamps.length) picture.lamp = view.lamps;
  return picture;
}

async function follow() {
  for (;;) {
    const { job } = await (await fetch("/api/scans")).json();
    if (!job || job.work !== "render") return;
    const share = job.step?.fraction;
    $("share").hidden = job.done;
    if (share != null) $("share").value = share;
    if (job.done) {
      if (job.problem) throw new Error(job.problem);
      const png = await (await fetch("/api/render.png")).blob();
      $("picture").src = $("save").href = URL.createObjectURL(png);
      $("shown").hidden = false;
      $("told").textContent = "";
      document.documentElement.dataset.rendered = (Number(document.documentElement.dataset.rendered) || 0) + 1;
      return;
    }
    $("told").textContent = `Rendering: ${job.step?.stage ?? "starting"}${share == null ? "" : ` ${Math.round(100 * share)} %`}`;
    await pause(500);
  }
}

$("go").onclick = async () => {
  $("go").disabled = true;
  try {
    $("told").textContent = "";
    await send(`/api/scans/${id}/render`, await wish());
    await follow();
  } catch (e) {
    $("told").textContent = e.message;
    $("share").hidden = true;
  }
  $("go").disabled = false;
};
