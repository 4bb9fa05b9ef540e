// Lamps: what each brings to every vertex stands in the page for its present place; one that is moved lights without
// shadows and bounces. Emitting surfaces and further lamps are one source that is dimmed as a whole.
const LAMP_VERTEX = `uniform vec4 lampPlace[4]; uniform vec3 lampPower[4], othersPower, othersScale; uniform vec4 lampScale;
  layout(location=10) in vec4 lampTransfer; layout(location=11) in vec4 others; layout(location=12) in vec4 emission;
  // A place's w is the squared radius of a lamp that was moved, 0 of one that was not.
  vec3 lampLight(vec3 p, vec3 n) {
    vec3 e = others.rgb * others.rgb * othersScale * othersPower;
    for (int i = 0; i < 4; i++) {
      vec3 d = lampPlace[i].xyz - p;
      float moved = lampPlace[i].w * max(dot(n, normalize(d)), 0.0) / max(dot(d, d), lampPlace[i].w + 1e-12);
      float there = lampTransfer[i] * lampTransfer[i] * lampScale[i];
      e += lampPower[i] * (lampPlace[i].w > 0.0 ? moved : there);
    }
    return e;
  }`;
// In the open, for things put on the surface: diffuse light, and what a mirror shows.
const LAMP_OBJECT = `uniform vec4 lampPlace[4]; uniform vec3 lampPower[4], glow; uniform float lampRadius[4];
  vec3 lampLight(vec3 p, vec3 n, vec3 mirrored, float mirror) {
    vec3 e = vec3(0.0);
    for (int i = 0; i < 4; i++) {
      vec3 d = lampPlace[i].xyz - p;
      float r2 = lampRadius[i] * lampRadius[i], far2 = max(dot(d, d), r2 + 1e-12);
      // A lamp smaller than the mesh of a ball shows as if it were 0.1 wide, as bright in all.
      float sine = sqrt(r2 / far2), shown = max(sine, 0.1);
      float inside = smoothstep(cos(shown * 1.3), cos(shown * 0.7), dot(normalize(d), mirrored));
      e += lampPower[i] * mix(r2 / far2 * max(dot(n, normalize(d)), 0.0), inside * sine * sine / (shown * shown), mirror);
    }
    return e;
  }`;

// Controls of the lamps. Every lamp holds `power` (a factor), its `place`, and whether it was `moved`.
const lampControls = (facts, changed) => {
  const lamps = facts.lamps.map((l, i) => ({ ...l, number: i, power: 1, place: l.center.slice(), moved: false }));
  const state = { lamps, others: 1 }, box = document.getElementById("lamps"), resets = [];
  const slider = (parent, name, low, high, step, value, act) => {
    const label = document.createElement("label"), input = document.createElement("input");
    Object.assign(input, { type: "range", min: low, max: high, step, value });
    input.addEventListener("input", () => { act(Number(input.value)); changed(); });
    label.append(name, input); parent.append(label);
    resets.push(() => { input.value = value; });
    return input;
  };
  // The left end is off, the middle as scanned, the right end four times that.
  const dimmed = (x) => x <= -4 ? 0 : Math.pow(2, x / 2);
  const powers = [];
  lamps.forEach((lamp) => {
    powers.push(slider(box, "Lamp " + lamp.number, -4, 4, 0.25, 0, (x) => { lamp.power = dimmed(x); }));
    const more = document.createElement("details"), head = document.createElement("summary");
    head.textContent = "Place (without shadows once moved)"; more.append(head);
    ["x", "y", "z"].forEach((name, k) => {
      const reach = Math.hypot(...facts.size), middle = facts.low[k] + facts.size[k] / 2;
      const span = Math.max(reach, 1.5 * Math.abs(lamp.center[k] - middle));
      slider(more, name, middle - span, middle + span, span / 200, lamp.center[k], (x) => { lamp.place[k] = x; lamp.moved = true; });
    });
    box.append(more);
  });
  if (facts.hasOthers) powers.push(slider(box, "Emitting surfaces", -4, 4, 0.25, 0, (x) => { state.others = dimmed(x); }));
  if (resets.length) {
    const button = document.createElement("button");
    button.type = "button"; button.textContent = "Lamps as scanned";
    button.addEventListener("click", () => {
      lamps.forEach((l) => Object.assign(l, { power: 1, place: l.center.slice(), moved: false }));
      state.others = 1; resets.forEach((r) => r()); changed();
    });
    box.append(button);
  }
  // Another light replaces the lamps.
  state.off = () => { lamps.forEach((l) => { l.power = 0; }); state.others = 0; powers.forEach((p) => { p.value = -4; }); };
  return state;
};

// Uniforms of the four lamps; places of lamps that did not move have w = 0.
const lampUniforms = (lamps) => {
  const place = new Float32Array(16), power = new Float32Array(12), radius = new Float32Array(4);
  lamps.forEach((l, i) => {
    place.set([...l.place, l.moved ? l.radius_m * l.radius_m : 0], 4 * i);
    power.set(l.radiance.map((x) => x * l.power), 3 * i);
    radius[i] = l.radius_m;
  });
  return { place, power, radius };
};
