"use strict";
/** One frame in both panels: what each layer shows, where the camera stands, in which colours. */
const panels = (() => {
  const FILL = 0.42; // share of a panel from its middle to the farthest point
  const MARK = { many: 2.5, few: 3.5, crowd: 40 };

  function rgba(colour, alpha = 1) {
    const hex = colour.trim().slice(1);
    return [0, 2, 4].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255).concat(alpha);
  }

  function style() {
    const values = getComputedStyle(document.documentElement);
    const read = (name) => values.getPropertyValue(`--${name}`).trim();
    return { ink: read("ink"), faint: read("faint"), background: read("background"), outlier: read("outlier"), layer: (name) => read(name) };
  }

  /** Give a canvas the pixels that it covers; returns [width, height] in CSS pixels. */
  function fitCanvas(canvas) {
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    return [width, height, ratio];
  }

  /** The rotation from a layer's frame to the viewer's, before the camera turns. */
  function stand(data, layer, frame, upright) {
    const pose = upright ? layer.pose(frame) : null;
    if (pose && Number.isFinite(pose[0])) return geometry.inverse(Array.from(pose.slice(0, 9)));
    return geometry.uprightRotation(data.yDown);
  }

  /** The points of all layers that are shown, and the frame that they stand in. */
  function gather(data, view) {
    const { frame } = view;
    const shown = data.layers.filter((layer) => view.shown.has(layer));
    const layers = shown.map((layer) => ({ layer, points: layer.points(frame), mesh: view.mesh ? layer.mesh(frame) : null }));
    const leader = layers.find(({ points }) => points.some(Number.isFinite));
    const framed = leader ?? data.layers.map((layer) => ({ layer, points: layer.points(frame) })).find(({ points }) => points.some(Number.isFinite));
    const size = framed ? geometry.extent(framed.points, 3) : { middle: [0, 0, 0], radius: 1 };
    const base = framed ? stand(data, framed.layer, frame, view.upright) : geometry.IDENTITY;
    return { layers, centre: size.middle, radius: size.radius || 1, base };
  }

  function drawSpace(canvas, renderer, data, view, look) {
    const [width, height] = fitCanvas(canvas);
    const gathered = gather(data, view);
    const radius = view.radius ?? gathered.radius;
    const camera = {
      rotation: geometry.compose(geometry.viewRotation(view.yaw, view.pitch), gathered.base),
      zoom: (view.zoom * FILL * Math.min(width, height)) / radius,
      pan: view.pan,
      reach: 1.6 * radius,
      background: rgba(look.background),
    };
    view.projected = {};
    if (renderer) renderer.clear(camera.background);
    const [seen, outliers] = [data.seen(view.frame), data.outliers(view.frame)];
    const diameter = 2 * (data.landmarks.length > MARK.crowd ? MARK.many : MARK.few);
    let solid = true;
    for (const { layer, points, mesh } of gathered.layers) {
      const colour = look.layer(layer.colour);
      const around = Array.from(geometry.turn(points, geometry.IDENTITY, gathered.centre));
      view.projected[layer.name] = geometry.project(geometry.turn(points, camera.rotation, gathered.centre), camera, width, height);
      if (!renderer) continue;
      if (mesh) {
        renderer.mesh(camera, geometry.turn(mesh, geometry.IDENTITY, gathered.centre), layer.faces, rgba(colour, solid ? 1 : 0.45));
        solid = false;
      }
      if (mesh && !view.names) continue;
      renderer.lines(camera, [...edgeLines(data.edges, around, rgba(colour)), ...errorBars(layer.sd(view.frame), around, rgba(colour, 0.8))]);
      renderer.marks(camera, marksOf(layer, around, seen, outliers, { colour, look, diameter }));
    }
    return camera;
  }

  function edgeLines(edges, around, tint) {
    const at = (j) => around.slice(3 * j, 3 * j + 3);
    return edges
      .filter(([a, b]) => Number.isFinite(around[3 * a] + around[3 * b]))
      .map(([a, b]) => ({ start: at(a), end: at(b), tint, width: 4 }));
  }

  /** One standard deviation to both sides of each landmark, along the axes of the camera. */
  function errorBars(sd, around, tint) {
    if (!sd) return [];
    const bars = [];
    sd.forEach((deviation, i) => {
      const point = around.slice(i - (i % 3), i - (i % 3) + 3);
      if (!Number.isFinite(deviation + point[0])) return;
      const [start, end] = [[...point], [...point]];
      start[i % 3] -= deviation;
      end[i % 3] += deviation;
      bars.push({ start, end, tint, width: 1.5 });
    });
    return bars;
  }

  function marksOf(layer, around, seen, outliers, { colour, look, diameter }) {
    const marks = [];
    for (let j = 0; j < around.length / 3; j++) {
      if (!Number.isFinite(around[3 * j])) continue;
      const hidden = layer.role === "result" && seen && !Number.isFinite(seen[2 * j]);
      const outlier = layer.role === "result" && outliers[j];
      marks.push({
        point: around.slice(3 * j, 3 * j + 3),
        tint: rgba(outlier ? look.outlier : colour),
        diameter: outlier || hidden ? diameter + 4 : diameter,
        kind: outlier ? drawing.CROSS : hidden ? drawing.RING : drawing.DISC,
      });
    }
    return marks;
  }

  /** Names of the landmarks beside those of the first layer, over the 3D panel. */
  function nameMarks(labels, data, view) {
    labels.replaceChildren();
    const points = Object.values(view.projected)[0];
    if (!view.names || !points) return;
    for (const j of imagePlane.apart(points, data.landmarks)) {
      const label = document.createElement("span");
      label.textContent = data.landmarks[j];
      label.style.transform = `translate(${points[j][0] + 6}px, ${points[j][1] - 18}px)`;
      labels.append(label);
    }
  }

  function drawPlane(canvas, data, view, look) {
    if (!data.flat) return;
    const [width, height, ratio] = fitCanvas(canvas);
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const { frame } = view;
    const layers = data.layers
      .filter((layer) => view.shown.has(layer) && layer.role === "result")
      .map((layer) => {
        const mesh = view.mesh ? layer.mesh(frame) : null;
        return { fitted: layer.fitted(frame), sd: layer.sd(frame), tint: look.layer(layer.colour), mesh: mesh && layer.inImage(frame, mesh), faces: layer.faces };
      });
    const seen = data.seen(frame);
    const plane = planeOf(data, view, layers, seen, width, height);
    const picture = view.pictures.get(frame);
    const drawn = {
      layers, seen, outliers: data.outliers(frame), edges: data.edges, unit: data.unit,
      names: view.names ? data.landmarks : null,
      picture: picture?.complete ? picture : null, pictureSize: data.pictures[frame]?.size,
    };
    const mark = data.landmarks.length > MARK.crowd ? MARK.many : MARK.few;
    imagePlane.draw(context, width, height, plane, drawn, { ...look, mark });
    view.plane = plane;
    view.onPlane = (x, y) => imagePlane.place(plane, width, height, x, y);
  }

  /** What the left panel shows: the landmarks of the frame or, where it moves little, the sequence. */
  function planeOf(data, view, layers, seen, width, height) {
    const points = [seen, ...layers.map((layer) => layer.fitted)].find((p) => p?.some(Number.isFinite));
    const own = (points && geometry.extent(points, 2)) || { middle: [0, 0], radius: 1 };
    const common = view.window ?? own;
    const zoom = (view.planeZoom * FILL * Math.min(width, height)) / (common.radius || 1);
    const middle = common.middle.map((value, axis) => {
      const towards = axis === 1 && !data.yDown ? 1 : -1;
      return value + (towards * view.planePan[axis]) / zoom;
    });
    return { zoom, middle, yDown: data.yDown };
  }

  return { style, fitCanvas, drawSpace, drawPlane, nameMarks };
})();
