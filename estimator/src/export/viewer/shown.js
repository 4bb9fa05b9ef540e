// What the page shows, for whoever renders it at full quality: the camera, what stands there, the light.

// Where a point is in the view, as shares of its size; null behind the camera.
const inView = (c, point) => {
  const d = sub(point, c.eye), z = dot(d, c.forward);
  return z > 0 ? [c.cx + c.fx * dot(d, c.right) / z, c.cy + c.fy * dot(d, c.down) / z] : null;
};

// A changed lamp as an argument of `lumiscan render --lamp`.
const lampChange = (l) => `${l.number}=` + (l.power <= 0 ? "off" : `*${l.power}` + (l.moved ? `,@${l.place.join(",")}` : ""));

const whatIsShown = () => {
  const c = camera(), k = keyframe && pixelOf(keyframe, picked ?? [NaN, NaN, NaN]);
  return {
    ...c, aspect: canvas.width / canvas.height,
    keyframe: keyframe && facts.keyframes.indexOf(keyframe), keyframeAspect: keyframe?.aspect, keyframeSize: keyframe && [keyframe.width, keyframe.height],
    thing: thingShown && { kind: thingShown.kind, at: thingShown.foot, scale: thingShown.size, file: thingShown.kind === "file" ? ownFile : null },
    picked: !picked ? null : keyframe ? k && [(k.column + 0.5) / keyframe.width, (k.row + 0.5) / keyframe.height] : inView(c, picked),
    panorama, yaw: Number($("yaw").value),
    lamps: near.lamps.filter((l) => l.power !== 1 || l.moved).map(lampChange),
  };
};
