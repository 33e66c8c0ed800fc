"use strict";
/** One frame in both panels: what each layer shows, where the camera stands, in which colours. */
const panels = (() => {
  const FILL = 0.42; // share of a panel from its middle to the farthest point
  const GROUND = { cells: 6, reach: 1.1 }; // of the floor, in reaches of the body
  const AXIS = 26; // px
  const INDIVIDUALS = [0, 2, 3, 4, 5, 1]; // colours of those who are seen at once
  const BALL = geometry.ball();
  const MARK = { many: 2.5, few: 3.5, crowd: 40 };

  function rgba(colour, alpha = 1) {
    const hex = colour.trim().slice(1);
    return [0, 2, 4].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255).concat(alpha);
  }

  function css(colour) {
    return `rgb(${colour.slice(0, 3).map((value) => Math.round(255 * value)).join(" ")})`;
  }

  function style() {
    const values = getComputedStyle(document.documentElement);
    const read = (name) => values.getPropertyValue(`--${name}`).trim();
    return { residual: read("residual"), right: read("right"), axes: ["x", "y", "z"].map(read), ink: read("ink"), faint: read("faint"), background: read("background"), outlier: read("outlier"), layer: (name) => read(name) };
  }

  /** Give a canvas the pixels that it covers; returns [width, height] in CSS pixels. */
  function fitCanvas(canvas) {
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    return [width, height, ratio];
  }

  function mixed(one, other, share) {
    return one.map((value, i) => value + share * (other[i] - value));
  }

  /** Colours of what is in the middle, on the left and on the right; those of one layer alone differ most. */
  function sideTints(data, look, colour, alone) {
    const own = rgba(colour);
    if (!data.sides) return [own, own, own];
    if (alone) return [rgba(look.faint), own, rgba(look.right)];
    return [mixed(own, rgba(look.ink), 0.3), own, mixed(own, rgba(look.ink), 0.6)];
  }

  /** The side of a line between two landmarks: theirs, unless they have different ones. */
  function sideOf(data, a, b = a) {
    const [first, second] = [data.sides?.[a] ?? 0, data.sides?.[b] ?? 0];
    return first && second && first !== second ? 0 : first || second;
  }

  /** The rotation from a layer's frame to the viewer's, before the camera turns. */
  function stand(data, layer, frame, upright) {
    const pose = upright ? layer.pose(frame) : null;
    if (pose && Number.isFinite(pose[0])) return geometry.inverse(Array.from(pose.slice(0, 9)));
    return geometry.uprightRotation(data.yDown);
  }

  /** The frames to draw at once: that of the view, and those of its moment that are not switched off. */
  function framesOf(data, view) {
    const all = data.together(view.frame).filter((frame) => frame === view.frame || !view.hidden.has(data.sequenceOf(frame)));
    return all.length ? all : [view.frame];
  }

  /** The name of the colour of a layer or, where there is one, of the individual of a frame. */
  function colourOf(data, layer, frame) {
    const group = data.group(data.sequenceOf(frame));
    const one = data.layers.filter(({ role }) => role !== "truth").length === 1;
    if (group.length < 2 || !one || layer.role === "truth") return layer.colour;
    return `layer-${INDIVIDUALS[group.indexOf(data.sequenceOf(frame)) % INDIVIDUALS.length]}`;
  }

  /** The bodies of all layers that are shown, the frame that they stand in, and how far they reach. */
  function gather(data, view, look) {
    const frames = framesOf(data, view);
    const many = frames.length > 1;
    const shown = data.layers.filter((layer) => view.shown.has(layer));
    const guide = data.layers.find((layer) => layer.hasCamera); // others were laid onto its shapes
    const inSpace = (layer, frame) => (layer.hasCamera ? layer : guide ?? layer).inSpace(frame, layer.points(frame));
    const bodies = shown.flatMap((layer) => frames.map((frame) => ({
      layer, frame, points: many ? inSpace(layer, frame) : layer.points(frame), mesh: view.mesh && !many ? layer.mesh(frame) : null,
      colour: look.layer(colourOf(data, layer, frame)),
    })));
    const known = ({ points }) => points.some(Number.isFinite);
    const leader = bodies.find((body) => body.frame === view.frame && known(body)) ?? bodies.find(known);
    const framed = leader ?? data.layers.map((layer) => ({ layer, points: layer.points(view.frame) })).find(known);
    if (!framed) return { bodies, centre: [0, 0, 0], base: geometry.IDENTITY, radius: 1, reach: null };
    const every = many ? bodies.filter(known).flatMap(({ points }) => Array.from(points)) : framed.points;
    const { middle, radius } = geometry.extent(every, 3);
    const base = many ? geometry.uprightRotation(data.yDown) : stand(data, framed.layer, view.frame, view.upright);
    const reach = geometry.reach(geometry.turn(many ? every : leader?.mesh ?? framed.points, base, middle));
    return { bodies, centre: middle, base, radius: radius || 1, reach, filled: many ? every : leader?.mesh ?? framed.points };
  }

  /** {zoom, up}: so that the bodies fill the panel, as they stand, or whichever way they turn. */
  function fit(gathered, view, rotation, width, height) {
    const { reach, bodies } = gathered;
    if (!reach) return { zoom: 1, up: 0 };
    const alone = new Set(bodies.map((body) => body.frame)).size === 1;
    const room = alone && !view.upright ? view.room : null;
    let [across, tall, up] = [0, 0, 0];
    if (room) {
      [across, tall] = geometry.halves(room, view.pitch);
      up = ((room.low + room.high) / 2) * Math.cos((view.pitch * Math.PI) / 180);
    } else {
      const seen = geometry.turn(gathered.filled, rotation, gathered.centre).filter((_, i) => i % 3 < 2);
      const box = geometry.box(seen);
      across = Math.abs(box.middle[0]) + box.halves[0];
      [tall, up] = [box.halves[1], box.middle[1]];
    }
    const least = 1e-9 * gathered.radius;
    return { zoom: 2 * FILL * Math.min(width / 2 / Math.max(across, least), height / 2 / Math.max(tall, least)), up };
  }

  function drawSpace(canvas, renderer, data, view, look) {
    const [width, height] = fitCanvas(canvas);
    const gathered = gather(data, view, look);
    const rotation = geometry.compose(geometry.viewRotation(view.yaw, view.pitch), gathered.base);
    const { zoom, up } = fit(gathered, view, rotation, width, height);
    const camera = {
      rotation,
      zoom: view.zoom * zoom,
      pan: [view.pan[0], view.pan[1] + view.zoom * zoom * up],
      reach: 1.6 * gathered.radius,
      background: rgba(look.background),
    };
    view.projected = {};
    if (renderer) renderer.clear(camera.background);
    const diameter = 2 * (data.landmarks.length > MARK.crowd ? MARK.many : MARK.few);
    let solid = true;
    const ground = gathered.reach && { ...gathered, half: GROUND.reach * gathered.reach.wide || gathered.radius };
    if (renderer && ground) renderer.lines(camera, floorLines(ground, look));
    const axes = cornerAxes(gathered, camera, width, height);
    view.axes = geometry.project(geometry.turn(axes.ends.flat(), rotation, [0, 0, 0]), axes.corner, width, height);
    for (const { layer, frame, points, mesh, colour } of gathered.bodies) {
      const tints = sideTints(data, look, colour, gathered.bodies.length === 1);
      const [seen, outliers] = [data.seen(frame), data.outliers(frame)];
      const around = Array.from(geometry.turn(points, geometry.IDENTITY, gathered.centre));
      const projected = geometry.project(geometry.turn(points, camera.rotation, gathered.centre), camera, width, height);
      if (frame === view.frame) view.projected[layer.name] = projected;
      if (!renderer) continue;
      if (mesh) {
        renderer.mesh(camera, geometry.turn(mesh, geometry.IDENTITY, gathered.centre), layer.faces, rgba(colour, solid ? 1 : 0.45));
        solid = false;
      }
      if (mesh && !view.names) continue;
      renderer.lines(camera, edgeLines(data, around, tints));
      renderer.marks(camera, marksOf(data, layer, around, seen, outliers, { tints, look, diameter }));
      for (const { vertices, faces } of errorBalls(layer, frame, around, gathered.bodies)) {
        renderer.mesh(camera, vertices, faces, rgba(colour, 0.2));
      }
    }
    if (renderer) renderer.lines(axes.corner, axes.ends.map((end, i) => ({ start: [0, 0, 0], end, tint: rgba(look.axes[i]), width: 2 })));
    return camera;
  }

  function edgeLines(data, around, tints) {
    const at = (j) => around.slice(3 * j, 3 * j + 3);
    return data.edges
      .filter(([a, b]) => Number.isFinite(around[3 * a] + around[3 * b]))
      .map(([a, b]) => ({ start: at(a), end: at(b), tint: tints[sideOf(data, a, b)], width: 4 }));
  }

  /** A point of the floor's frame, where y is up and 0 the middle, in that of what is drawn. */
  function grounded({ base }, point) {
    return Array.from(geometry.turn(point, geometry.inverse(base), [0, 0, 0]));
  }

  /** A grid under the lowest point of the frame. */
  function floorLines(ground, look) {
    const { half, reach } = ground;
    const lines = [];
    const line = (a, b, tint, width) => lines.push({ start: grounded(ground, a), end: grounded(ground, b), tint, width });
    const tint = mixed(rgba(look.background), rgba(look.faint), 0.35);
    for (let i = 0; i <= GROUND.cells; i++) {
      const at = half * ((2 * i) / GROUND.cells - 1);
      line([at, reach.low, -half], [at, reach.low, half], tint, 1);
      line([-half, reach.low, at], [half, reach.low, at], tint, 1);
    }
    return lines;
  }

  /** The axes in the corner of the panel: a camera that shows them, and their ends. */
  function cornerAxes({ base }, camera, width, height) {
    const corner = { ...camera, zoom: AXIS, pan: [AXIS + 14 - width / 2, height / 2 - AXIS - 14], reach: 1e3 };
    return { corner, ends: [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((end) => grounded({ base }, end)) };
  }

  /** An ellipsoid of one standard deviation around each landmark, along the axes of the camera. */
  function errorBalls(layer, frame, around, bodies) {
    const many = bodies.some((body) => body.frame !== frame);
    const sd = layer.sd(frame)?.map((value) => (many ? value / layer.unit(frame) : value));
    if (!sd) return [];
    const [vertices, faces] = [[], []];
    for (let j = 0; j < sd.length; j += 3) {
      if (!Number.isFinite(sd[j] + sd[j + 1] + sd[j + 2] + around[j])) continue;
      const first = vertices.length / 3;
      for (const corner of BALL.faces) faces.push(first + corner);
      BALL.vertices.forEach((value, i) => vertices.push(around[j + (i % 3)] + value * sd[j + (i % 3)]));
    }
    return faces.length ? [{ vertices, faces: Uint32Array.from(faces) }] : [];
  }

  function marksOf(data, layer, around, seen, outliers, { tints, look, diameter }) {
    const marks = [];
    for (let j = 0; j < around.length / 3; j++) {
      if (!Number.isFinite(around[3 * j])) continue;
      const hidden = layer.role === "result" && seen && !Number.isFinite(seen[2 * j]);
      const outlier = layer.role === "result" && outliers[j];
      marks.push({
        point: around.slice(3 * j, 3 * j + 3),
        tint: outlier ? rgba(look.outlier) : tints[sideOf(data, j)],
        diameter: outlier || hidden ? diameter + 4 : diameter,
        kind: outlier ? drawing.CROSS : hidden ? drawing.RING : drawing.DISC,
      });
    }
    return marks;
  }

  function write(labels, text, [x, y], colour = "") {
    const label = document.createElement("span");
    label.textContent = text;
    label.style.transform = `translate(${x}px, ${y}px)`;
    label.style.color = colour;
    labels.append(label);
  }

  /** Names of the axes, and of the landmarks beside those of the first layer, over the 3D panel. */
  function nameMarks(labels, data, view, look) {
    labels.replaceChildren();
    const points = Object.values(view.projected)[0];
    for (const j of view.names && points ? imagePlane.apart(points, data.landmarks) : []) {
      write(labels, data.landmarks[j], [points[j][0] + 6, points[j][1] - 18]);
    }
    (view.axes ?? []).forEach(([x, y], i) => write(labels, "xyz"[i], [x + 3, y - 9], look.axes[i]));
  }

  function drawPlane(canvas, data, view, look) {
    if (!data.flat) return;
    const [width, height, ratio] = fitCanvas(canvas);
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const { frame } = view;
    const frames = framesOf(data, view);
    const results = data.layers.filter((layer) => view.shown.has(layer) && layer.role === "result");
    const others = frames.flatMap((each) => (each === frame ? [] : results.map((layer) => ({
      fitted: layer.fitted(each),
      tints: sideTints(data, look, look.layer(colourOf(data, layer, each)), false).map(css),
    }))));
    const layers = results.map((layer) => {
        const mesh = view.mesh ? layer.mesh(frame) : null;
        const tint = look.layer(colourOf(data, layer, frame));
        return { fitted: layer.fitted(frame), sd: layer.sd(frame), tint, tints: sideTints(data, look, tint, view.shown.size === 1 && frames.length === 1).map(css), mesh: mesh && layer.inImage(frame, mesh), faces: layer.faces };
      });
    const seen = data.seen(frame);
    const plane = planeOf(data, view, layers, seen, others, width, height);
    const picture = view.pictures.get(frame);
    const drawn = {
      layers, others, seen, outliers: data.outliers(frame), edges: data.edges, side: (a, b) => sideOf(data, a, b), unit: data.unit,
      names: view.names ? data.landmarks : null,
      picture: picture?.complete ? picture : null, pictureSize: data.pictures[frame]?.size,
    };
    const mark = data.landmarks.length > MARK.crowd ? MARK.many : MARK.few;
    imagePlane.draw(context, width, height, plane, drawn, { ...look, mark });
    view.plane = plane;
    view.onPlane = (x, y) => imagePlane.place(plane, width, height, x, y);
  }

  /** What the left panel shows: the landmarks of the frame or, where it moves little, the sequence. */
  function planeOf(data, view, layers, seen, others, width, height) {
    const points = [seen, ...layers.map((layer) => layer.fitted)].find((p) => p?.some(Number.isFinite));
    const every = others.length ? [...(points ?? []), ...others.flatMap(({ fitted }) => Array.from(fitted))] : points;
    const window_ = others.length ? null : view.window;
    const own = window_ ? { middle: window_.middle, halves: [window_.radius, window_.radius] } : geometry.box(every ?? []);
    const zoom = 2 * FILL * view.planeZoom * Math.min(width / 2 / (own.halves[0] || 1), height / 2 / (own.halves[1] || 1));
    const middle = own.middle.map((value, axis) => {
      const towards = axis === 1 && !data.yDown ? 1 : -1;
      return value + (towards * view.planePan[axis]) / zoom;
    });
    return { zoom, middle, yDown: data.yDown };
  }

  return { style, fitCanvas, framesOf, colourOf, drawSpace, drawPlane, nameMarks };
})();
