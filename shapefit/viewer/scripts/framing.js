"use strict";
/** How large the panels show a sequence: in one scale, where its frames are alike. */
const framing = (() => {
  const LOOKED_AT = 200; // frames of a sequence, evenly spread

  /**
   * {room, window} of the frames from start to end: how far the shapes reach, and the part of the
   * image that the landmarks wander through; null where each frame has to be framed alone, as
   * shapes of images that are `apart`.
   */
  function ofSequence(data, start, end, apart = false) {
    const step = Math.max(1, Math.floor((end - start) / LOOKED_AT));
    const [solid, flat] = [[], []];
    for (let frame = start; frame < end; frame += step) {
      const points = data.layers.map((layer) => layer.points(frame)).find((p) => p.some(Number.isFinite));
      const seen = data.seen(frame) ?? data.layers.find((layer) => layer.role === "result")?.fitted(frame);
      const [inSpace, inPlane] = [points && geometry.extent(points, 3), seen && geometry.extent(seen, 2)];
      if (inSpace) solid.push({ radius: inSpace.radius, ...geometry.reach(geometry.turn(points, geometry.uprightRotation(data.yDown), inSpace.middle)) });
      if (inPlane) flat.push(inPlane);
    }
    return { room: apart ? null : roomFor(solid), window: apart ? null : windowOf(flat) };
  }

  /** The 95th percentile of sizes, null where they differ by a factor of two and more. */
  function typical(sizes) {
    const sorted = [...sizes].sort((a, b) => a - b);
    const [small, large] = [0.05, 0.95].map((share) => sorted[Math.floor(share * sorted.length)]);
    return sorted.length && large < 2 * small ? large : null;
  }

  /** The reach of a typical large frame, null where frames differ too much. */
  function roomFor(bodies) {
    const radius = typical(bodies.map((body) => body.radius));
    if (radius === null) return null;
    const large = (name, sign) => sign * [...bodies.map((body) => sign * body[name])].sort((a, b) => a - b)[Math.floor(0.95 * bodies.length)];
    return { radius, low: large("low", -1), high: large("high", 1), wide: large("wide", 1) };
  }

  function windowOf(extents) {
    const radius = typical(extents.map((extent) => extent.radius));
    if (radius === null) return null;
    const [low, high] = [Math.min, Math.max].map((pick) =>
      [0, 1].map((axis) => pick(...extents.map((extent) => extent.middle[axis]))));
    const wander = Math.hypot(high[0] - low[0], high[1] - low[1]) / 2;
    if (wander > radius) return null;
    return { middle: [0, 1].map((axis) => (low[axis] + high[axis]) / 2), radius: radius + wander };
  }

  return { ofSequence, typical };
})();
if (typeof module !== "undefined") module.exports = framing;
