"use strict";
/**
 * The left panel: landmarks as seen, over the image where there is one, and what was fitted.
 *
 * A plane is {zoom (px a unit), middle (the point in the middle of the panel), yDown}.
 */
const imagePlane = (() => {
  const FONT = "12px system-ui, sans-serif";

  /** From the plane to the panel, in CSS pixels. */
  function place(plane, width, height, x, y) {
    const up = plane.yDown ? 1 : -1;
    return [
      width / 2 + plane.zoom * (x - plane.middle[0]),
      height / 2 + up * plane.zoom * (y - plane.middle[1]),
    ];
  }

  function disc(context, [x, y], radius) {
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
  }

  function drawRuler(context, plane, width, height, unit, ink) {
    const step = niceStep(90 / plane.zoom);
    context.fillStyle = context.strokeStyle = ink;
    context.lineWidth = 1;
    context.font = FONT;
    context.textAlign = "center";
    context.textBaseline = "bottom";
    for (const tick of ticks(plane.middle[0], width / 2 / plane.zoom, step)) {
      const [x] = place(plane, width, height, tick, 0);
      if (x < 24 || x > width - 24) continue;
      context.fillRect(x, height - 5, 1, 5);
      context.fillText(number(tick, step), x, height - 6);
    }
    context.textAlign = "left";
    context.textBaseline = "middle";
    for (const tick of ticks(plane.middle[1], height / 2 / plane.zoom, step)) {
      const y = place(plane, width, height, 0, tick)[1];
      if (y < 30 || y > height - 30) continue;
      context.fillRect(0, y, 5, 1);
      context.fillText(number(tick, step), 8, y);
    }
    context.textBaseline = "top";
    context.fillText(unit, 8, 8);
  }

  /** The multiples of a step within `reach` of the middle. */
  function ticks(middle, reach, step) {
    const count = Math.floor((2 * reach) / step) + 1;
    const first = Math.ceil((middle - reach) / step);
    return Number.isFinite(count + first) ? Array.from({ length: count }, (_, i) => (first + i) * step) : [];
  }

  /** 1, 2 or 5 times a power of ten, at least `least`. */
  function niceStep(least) {
    const power = 10 ** Math.floor(Math.log10(least));
    return power * ([1, 2, 5].find((factor) => factor * power >= least) ?? 10);
  }

  function number(value, step) {
    return value.toFixed(Math.max(0, -Math.floor(Math.log10(step))));
  }

  /**
   * Draw a frame: {picture, pictureSize, seen (2p), outliers (p), layers: [{fitted (2p), sd, tint,
   * mesh, faces}], edges, names}.
   */
  function draw(context, width, height, plane, frame, style) {
    context.clearRect(0, 0, width, height);
    const at = (points, j) => place(plane, width, height, points[2 * j], points[2 * j + 1]);
    if (frame.picture) drawPicture(context, width, height, plane, frame);
    drawRuler(context, plane, width, height, frame.unit, style.faint);
    for (const other of frame.others) {
      other.tints.forEach((tint, side) => drawEdges(context, other.fitted, frame.edges.filter(([a, b]) => frame.side(a, b) === side), at, tint));
    }
    for (const layer of frame.layers) {
      if (layer.mesh) fillMesh(context, layer, (j) => at(layer.mesh, j));
      layer.tints.forEach((tint, side) => {
        drawEdges(context, layer.fitted, frame.edges.filter(([a, b]) => frame.side(a, b) === side), at, tint);
      });
      drawMarks(context, frame, layer, plane, at, style);
    }
    if (!frame.seen) return;
    if (!frame.layers.length) drawEdges(context, frame.seen, frame.edges, at, style.faint);
    for (let j = 0; j < frame.seen.length / 2; j++) {
      if (!Number.isFinite(frame.seen[2 * j])) continue;
      const [x, y] = at(frame.seen, j);
      if (frame.outliers[j]) {
        drawCross(context, x, y, style.outlier);
      } else {
        disc(context, [x, y], style.mark);
        context.fillStyle = style.ink;
        context.fill();
        context.strokeStyle = style.background;
        context.lineWidth = 1;
        context.stroke();
      }
    }
    if (frame.names) drawNames(context, frame, at, style);
  }

  function drawNames(context, frame, at, style) {
    context.font = FONT;
    context.textAlign = "left";
    context.textBaseline = "middle";
    context.fillStyle = style.ink;
    const places = frame.names.map((_, j) => at(frame.seen, j));
    for (const j of apart(places, frame.names)) context.fillText(frame.names[j], places[j][0] + 6, places[j][1] - 9);
  }

  /** The names that fit beside their points without covering each other: indices, first come first. */
  function apart(places, names) {
    const kept = [];
    names.forEach((name, j) => {
      const [x, y] = places[j];
      const free = (k) => Math.abs(places[k][1] - y) > 14 ||
        x > places[k][0] + 8 * names[k].length || places[k][0] > x + 8 * name.length;
      if (Number.isFinite(x) && kept.every(free)) kept.push(j);
    });
    return kept;
  }

  function drawEdges(context, points, edges, at, tint) {
    context.strokeStyle = tint;
    context.globalAlpha = 0.75;
    context.lineWidth = 2;
    context.beginPath();
    for (const [a, b] of edges) {
      if (!Number.isFinite(points[2 * a] + points[2 * b])) continue;
      context.moveTo(...at(points, a));
      context.lineTo(...at(points, b));
    }
    context.stroke();
    context.globalAlpha = 1;
  }

  /** Rings where landmarks are hidden, lines from the others to where the model has them. */
  function drawMarks(context, frame, layer, plane, at, style) {
    for (let j = 0; j < layer.fitted.length / 2; j++) {
      if (!Number.isFinite(layer.fitted[2 * j])) continue;
      const [x, y] = at(layer.fitted, j);
      context.strokeStyle = layer.tint;
      context.lineWidth = 1.5;
      if (layer.sd && Number.isFinite(layer.sd[3 * j])) {
        context.beginPath();
        context.ellipse(x, y, plane.zoom * layer.sd[3 * j], plane.zoom * layer.sd[3 * j + 1], 0, 0, 2 * Math.PI);
        context.globalAlpha = 0.2;
        context.fillStyle = layer.tint;
        context.fill();
        context.globalAlpha = 1;
      }
      if (!frame.seen) continue;
      if (Number.isFinite(frame.seen[2 * j])) {
        context.beginPath();
        context.moveTo(...at(frame.seen, j));
        context.lineTo(x, y);
        context.strokeStyle = style.residual;
        context.stroke();
      } else {
        disc(context, [x, y], style.mark + 0.5);
        context.fillStyle = style.background;
        context.fill();
        context.stroke();
      }
    }
  }

  /** Fill the triangles that face the viewer, as one shape. */
  function fillMesh(context, layer, at) {
    context.beginPath();
    for (let f = 0; f < layer.faces.length; f += 3) {
      const [a, b, c] = [at(layer.faces[f]), at(layer.faces[f + 1]), at(layer.faces[f + 2])];
      if ((b[0] - a[0]) * (c[1] - a[1]) >= (b[1] - a[1]) * (c[0] - a[0])) continue;
      context.moveTo(...a);
      context.lineTo(...b);
      context.lineTo(...c);
    }
    context.globalAlpha = 0.3;
    context.fillStyle = layer.tint;
    context.fill();
    context.globalAlpha = 1;
  }

  function drawPicture(context, width, height, plane, frame) {
    const [w, h] = frame.pictureSize;
    const [left, first] = place(plane, width, height, 0, plane.yDown ? 0 : h);
    context.drawImage(frame.picture, left, first, w * plane.zoom, h * plane.zoom);
  }

  function drawCross(context, x, y, tint) {
    context.strokeStyle = tint;
    context.lineWidth = 3;
    context.beginPath();
    context.moveTo(x - 5, y - 5);
    context.lineTo(x + 5, y + 5);
    context.moveTo(x - 5, y + 5);
    context.lineTo(x + 5, y - 5);
    context.stroke();
  }

  return { draw, place, apart, ticks, niceStep };
})();
if (typeof module !== "undefined") module.exports = imagePlane;
