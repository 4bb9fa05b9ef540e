// What the pages share: requests to the box, and figures as text.

export const $ = (id) => document.getElementById(id);

// Sends an order; returns its answer, or throws what the box says.
export async function send(path, body, method = "POST") {
  const answer = await fetch(path, { method, body: body === undefined ? undefined : JSON.stringify(body) });
  const told = await answer.json().catch(() => ({}));
  if (answer.status === 401) location.reload();
  if (!answer.ok) throw new Error(told.error || `the box answers ${answer.status}`);
  return told;
}

export function element(tag, properties = {}, ...children) {
  const e = Object.assign(document.createElement(tag), properties);
  e.append(...children);
  return e;
}

export function bytes(n) {
  if (n === null || n === undefined) return "–";
  return n >= 1e9 ? `${(n / 1e9).toFixed(1)} GB` : n >= 1e6 ? `${(n / 1e6).toFixed(0)} MB` : `${Math.ceil(n / 1e3)} kB`;
}

export function time(seconds) {
  const s = Math.max(0, Math.floor(seconds || 0));
  return `${Math.floor(s / 60)}:${String(s % 60).padStart(2, "0")}`;
}

export const pause = (ms) => new Promise((done) => setTimeout(done, ms));
