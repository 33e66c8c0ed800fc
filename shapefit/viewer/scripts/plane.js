/**
 * The left panel: landmarks as seen, over the image where there is one, and what was fitted.
 *
 * A plane is {zoom (px a unit), middle (the point in the middle of the panel), yDown}.
 */
const plane = (() => {
  const FILL = 0.42; // share of the panel from its middle to the farthest point
  const FONT = "12px system-ui, sans-serif";

  /** From the plane to the panel, in CSS pixels. */
  function place({ zoom, middle, yDown }, width, height, x, y) {
    const up = yDown ? 1 : -1;
    return [width / 2 + zoom * (x - middle[0]), height / 2 + up * zoom * (y - middle[1])];
  }

  /** Draw the frame of the view; returns the plane. */
  function draw(canvas, data, view) {
    const [width, height, ratio] = look.fitCanvas(canvas);
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const { frame } = view;
    const frames = look.framesOf(data, view);
    const results = data.layers.filter((layer) => view.shown.has(layer) && layer.role === "result");
    const bodies = results.flatMap((layer) => frames.map((each) => {
      const colour = look.colourOf(data, layer, each);
      const alone = view.shown.size === 1 && frames.length === 1;
      return { layer, frame: each, fitted: layer.fitted(each), tint: look.text(colour), tints: look.sideTints(data, colour, alone).map(look.css) };
    }));
    const seen = data.seen(frame);
    const own = planeOf(data, view, frames, bodies, width, height);
    const at = (points, j) => place(own, width, height, points[2 * j], points[2 * j + 1]);
    drawPicture(context, data, view, (x, y) => place(own, width, height, x, y), own.zoom);
    drawScale(context, height, own.zoom, data.unit);
    for (const body of bodies) {
      const { layer, fitted, tint, tints } = body;
      const mesh = view.mesh && body.frame === frame ? layer.mesh(frame) : null;
      if (mesh) fillMesh(context, layer, layer.inImage(frame, mesh), at, tint);
      tints.forEach((colour, side) => drawEdges(context, fitted, data.edges.filter(([a, b]) => look.sideOf(data, a, b) === side), at, colour));
      if (body.frame === frame) drawMarks(context, body, seen, own.zoom, at, look.markOf(data));
    }
    if (seen) drawSeen(context, data, view, seen, bodies.length > 0, at);
    return { ...own, width, height };
  }

  /** What the panel shows: the bodies of the frame, a sequence in one scale. */
  function planeOf(data, view, frames, bodies, width, height) {
    const points = [data.seen(view.frame), ...bodies.map(({ fitted }) => fitted)].filter(Boolean);
    const alone = frames.length === 1;
    const box = geometry.box(points.flatMap((each) => Array.from(each)), 2) ?? { middle: [0, 0], extent: [1, 1] };
    const whole = alone ? data.size(data.sequenceOf(view.frame)).flat : [0, 0];
    const [wide, tall] = box.extent.map((own, axis) => Math.max(own, whole[axis]));
    const zoom = FILL * view.planeZoom * Math.min(width / (wide || tall || 1), height / (tall || wide || 1));
    const middle = box.middle.map((value, axis) => {
      const towards = axis === 1 && !data.y_down ? 1 : -1;
      return value + (towards * view.planePan[axis]) / zoom;
    });
    return { zoom, middle, yDown: data.y_down };
  }

  function drawPicture(context, data, view, at, zoom) {
    const picture = view.pictures[view.frame];
    if (!picture?.complete) return;
    const [w, h] = data.pictures[view.frame].size;
    context.drawImage(picture, ...at(0, data.y_down ? 0 : h), w * zoom, h * zoom);
  }

  /** 1, 2 or 5 times a power of ten, at least `least`. */
  function niceStep(least) {
    const power = 10 ** Math.floor(Math.log10(least));
    return power * ([1, 2, 5].find((factor) => factor * power >= least) ?? 10);
  }

  /** A bar in the corner that is so long in the unit of the landmarks. */
  function drawScale(context, height, zoom, unit) {
    const step = niceStep(70 / zoom);
    context.fillStyle = look.text("faint");
    context.font = FONT;
    context.textBaseline = "bottom";
    context.fillRect(12, height - 12, zoom * step, 2);
    context.fillText(`${Number(step.toPrecision(1))} ${unit}`, 12, height - 14);
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

  /** Error bars, rings where landmarks are hidden, lines from the others to where the model has them. */
  function drawMarks(context, { layer, frame, fitted, tint }, seen, zoom, at, mark) {
    const sd = layer.sd(frame);
    for (let j = 0; j < fitted.length / 2; j++) {
      if (!Number.isFinite(fitted[2 * j])) continue;
      const [x, y] = at(fitted, j);
      if (Number.isFinite(sd?.[3 * j])) {
        context.beginPath();
        context.ellipse(x, y, zoom * sd[3 * j], zoom * sd[3 * j + 1], 0, 0, 2 * Math.PI);
        fill(context, tint, 0.2);
      }
      if (!seen) continue;
      context.beginPath();
      context.lineWidth = 1.5;
      if (Number.isFinite(seen[2 * j])) {
        context.strokeStyle = look.text("residual");
        context.moveTo(...at(seen, j));
        context.lineTo(x, y);
      } else {
        context.strokeStyle = tint;
        context.arc(x, y, mark + 0.5, 0, 2 * Math.PI);
        fill(context, look.text("background"));
      }
      context.stroke();
    }
  }

  /** Observed landmarks: discs, and crosses where they were judged to be wrong; their names. */
  function drawSeen(context, data, view, seen, fitted, at) {
    const outliers = data.outliers(view.frame);
    const [ink, faint, background, outlier] = ["ink", "faint", "background", "outlier"].map(look.text);
    if (!fitted) drawEdges(context, seen, data.edges, at, faint);
    const places = data.landmarks.map((_, j) => at(seen, j));
    places.forEach(([x, y], j) => {
      if (!Number.isFinite(x)) return;
      context.beginPath();
      if (outliers[j]) {
        for (const side of [-5, 5]) {
          context.moveTo(x - 5, y - side);
          context.lineTo(x + 5, y + side);
        }
      } else {
        context.arc(x, y, look.markOf(data), 0, 2 * Math.PI);
        fill(context, ink);
      }
      context.strokeStyle = outliers[j] ? outlier : background;
      context.lineWidth = outliers[j] ? 3 : 1;
      context.stroke();
    });
    context.font = FONT;
    context.textBaseline = "middle";
    context.fillStyle = ink;
    for (const j of view.names ? look.apart(places, data.landmarks) : []) {
      context.fillText(data.landmarks[j], places[j][0] + 6, places[j][1] - 9);
    }
  }

  /** Fill the triangles that face the viewer, as one shape. */
  function fillMesh(context, { faces }, points, at, tint) {
    context.beginPath();
    for (let f = 0; f < faces.length; f += 3) {
      const [a, b, c] = [at(points, faces[f]), at(points, faces[f + 1]), at(points, faces[f + 2])];
      if ((b[0] - a[0]) * (c[1] - a[1]) >= (b[1] - a[1]) * (c[0] - a[0])) continue;
      context.moveTo(...a);
      context.lineTo(...b);
      context.lineTo(...c);
    }
    fill(context, tint, 0.3);
  }

  function fill(context, tint, alpha = 1) {
    context.globalAlpha = alpha;
    context.fillStyle = tint;
    context.fill();
    context.globalAlpha = 1;
  }

  return { draw, place, niceStep };
})();
