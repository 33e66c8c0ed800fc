/** The right panel: shapes in 3D on a floor, each frame around the middle of what it shows. */
const space = (() => {
  const FILL = 0.44; // share of the panel from its middle to the farthest point, whichever way it turns
  const FLOOR = { cells: 6, reach: 0.8 }; // in radii of what stands on it
  const AXIS = 26; // px
  const BALL = geometry.ball();

  /** The shapes to draw; where several individuals are seen at once, in the space of the camera. */
  function bodiesOf(data, view) {
    const frames = look.framesOf(data, view);
    const guide = data.layers.find((layer) => layer.hasCamera); // others were laid onto its shapes
    const many = frames.length > 1;
    return data.layers.filter((layer) => view.shown.has(layer)).flatMap((layer) => frames.map((frame) => ({
      layer,
      frame,
      points: many ? (layer.hasCamera ? layer : guide ?? layer).inSpace(frame, layer.points(frame)) : layer.points(frame),
      size: many ? layer.unit(frame) : 1,
      mesh: view.mesh && !many ? layer.mesh(frame) : null,
      colour: look.colourOf(data, layer, frame),
    })));
  }

  /** The rotation from the frame of the shapes to the viewer's, before the camera turns. */
  function stand(data, view, bodies) {
    const pose = view.upright && bodies.length ? bodies[0].layer.pose(view.frame) : null;
    if (pose && Number.isFinite(pose[0])) return geometry.inverse(Array.from(pose.slice(0, 9)));
    return geometry.uprightRotation(data.y_down);
  }

  /** Draw the frame of the view; returns {projected: points by layer in px, axes: their ends in px}. */
  function draw(canvas, renderer, data, view) {
    const [width, height] = look.fitCanvas(canvas);
    const bodies = bodiesOf(data, view);
    const alone = bodies.every(({ frame }) => frame === view.frame);
    const base = stand(data, view, bodies);
    const every = geometry.turn(bodies.flatMap(({ points, mesh }) => Array.from(mesh ?? points)), base);
    const box = geometry.box(every, 3) ?? { middle: [0, 0, 0], low: [0, -1, 0], extent: [1, 1] };
    const whole = alone && !view.upright ? data.size(data.sequenceOf(view.frame)).solid : [0, 0];
    const [across, tall] = box.extent.map((own, axis) => Math.max(own, whole[axis]));
    const radius = Math.hypot(across, tall) || 1;
    const [level, tilt] = [Math.cos, Math.sin].map((of) => Math.abs(of((view.pitch * Math.PI) / 180)));
    const centre = geometry.turn(box.middle, geometry.inverse(base));
    const camera = {
      rotation: geometry.viewRotation(view.yaw, view.pitch),
      zoom: FILL * view.zoom * Math.min(width / (across || radius), height / (level * tall + tilt * across || radius)),
      pan: view.pan,
      reach: 1.6 * radius,
      background: look.rgba("background"),
    };
    const place = (points) => geometry.turn(points, base, centre);
    const projected = {};
    for (const body of bodies) {
      body.around = Array.from(place(body.points));
      if (body.frame !== view.frame) continue;
      projected[body.layer.name] = geometry.project(geometry.turn(body.around, camera.rotation), camera, width, height);
    }
    const corner = { ...camera, zoom: AXIS, pan: [AXIS + 14 - width / 2, height / 2 - AXIS - 14], reach: 1e3 };
    if (renderer) {
      renderer.clear(camera.background);
      renderer.lines(camera, floorLines(box.low[1] - box.middle[1], FLOOR.reach * radius));
      bodies.forEach((body, i) => drawBody(renderer, camera, data, view, body, place, { alone: bodies.length === 1, first: i === 0 }));
      renderer.lines(corner, "xyz".split("").map((axis, i) => ({ start: [0, 0, 0], end: unit(i), tint: look.rgba(axis), width: 2 })));
    }
    const axes = geometry.project(geometry.turn([0, 1, 2].flatMap(unit), camera.rotation), corner, width, height);
    return { projected, axes };
  }

  function unit(axis) {
    return [0, 1, 2].map((i) => (i === axis ? 1 : 0));
  }

  function drawBody(renderer, camera, data, view, body, place, { alone, first }) {
    const { layer, frame, points, size, mesh, colour, around } = body;
    if (mesh) {
      const corners = place(mesh);
      const triangles = Array.from(layer.faces).flatMap((corner) => Array.from(corners.subarray(3 * corner, 3 * corner + 3)));
      renderer.mesh(camera, triangles, look.rgba(colour, first ? 1 : 0.45));
      if (!view.names) return;
    }
    const tints = look.sideTints(data, colour, alone);
    renderer.lines(camera, edgeLines(data, around, tints));
    renderer.marks(camera, marksOf(data, layer, frame, around, tints));
    const balls = errorBalls(points, layer.sd(frame), size);
    if (balls.length) renderer.mesh(camera, place(balls), look.rgba(colour, 0.2));
  }

  function edgeLines(data, around, tints) {
    const at = (j) => around.slice(3 * j, 3 * j + 3);
    return data.edges
      .filter(([a, b]) => Number.isFinite(around[3 * a] + around[3 * b]))
      .map(([a, b]) => ({ start: at(a), end: at(b), tint: tints[look.sideOf(data, a, b)], width: 4 }));
  }

  /** Landmarks: discs, rings where the image hides them, crosses where they were judged to be wrong. */
  function marksOf(data, layer, frame, around, tints) {
    const [seen, outliers] = [data.seen(frame), data.outliers(frame)];
    const marks = [];
    for (let j = 0; j < around.length / 3; j++) {
      if (!Number.isFinite(around[3 * j])) continue;
      const hidden = layer.role === "result" && seen && !Number.isFinite(seen[2 * j]);
      const outlier = layer.role === "result" && outliers[j];
      marks.push({
        point: around.slice(3 * j, 3 * j + 3),
        tint: outlier ? look.rgba("outlier") : tints[look.sideOf(data, j)],
        diameter: 2 * look.markOf(data) + (outlier || hidden ? 4 : 0),
        kind: outlier ? drawing.CROSS : hidden ? drawing.RING : drawing.DISC,
      });
    }
    return marks;
  }

  /** Triangles of an ellipsoid of one standard deviation around each landmark, along the axes of the camera. */
  function errorBalls(points, sd, size) {
    const triangles = [];
    for (let j = 0; j < (sd?.length ?? 0); j += 3) {
      if (!Number.isFinite(sd[j] + sd[j + 1] + sd[j + 2] + points[j])) continue;
      for (const corner of BALL) corner.forEach((value, i) => triangles.push(points[j + i] + (value * sd[j + i]) / size));
    }
    return triangles;
  }

  /** A grid at the height of the lowest point. */
  function floorLines(low, half) {
    const tint = look.mixed(look.rgba("background"), look.rgba("faint"), 0.35);
    return Array.from({ length: FLOOR.cells + 1 }, (_, i) => half * ((2 * i) / FLOOR.cells - 1)).flatMap((at) => [
      { start: [at, low, -half], end: [at, low, half], tint, width: 1 },
      { start: [-half, low, at], end: [half, low, at], tint, width: 1 },
    ]);
  }

  /** Names of the axes, and of the landmarks beside those of the first layer, over the panel. */
  function nameMarks(labels, data, view) {
    labels.replaceChildren();
    const write = (text, [x, y], colour = "") => {
      const label = document.createElement("span");
      label.textContent = text;
      label.style.transform = `translate(${x}px, ${y}px)`;
      label.style.color = colour;
      labels.append(label);
    };
    const [points] = Object.values(view.projected);
    for (const j of view.names && points ? look.apart(points, data.landmarks) : []) {
      write(data.landmarks[j], [points[j][0] + 6, points[j][1] - 18]);
    }
    view.axes.forEach(([x, y], i) => write("xyz"[i], [x + 3, y - 9], look.text("xyz"[i])));
  }

  return { draw, nameMarks };
})();
