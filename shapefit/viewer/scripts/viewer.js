"use strict";
/** The page at work: its state, what is drawn of it, and what keys, mouse and buttons do to it. */
(() => {
  const $ = (id) => document.getElementById(id);
  const data = scene.open(JSON.parse($("page").textContent));
  data.layers.forEach((layer, i) => {
    layer.colour = layer.role === "truth" ? "truth" : `layer-${i % 6}`;
  });
  const view = {
    frame: 0, yaw: 0, pitch: 0, zoom: 1, pan: [0, 0], planeZoom: 1, planePan: [0, 0],
    shown: new Set(data.layers.filter((layer, i) => i === 0 || !data.layers[0].faces)), mesh: true, names: false, upright: false, hidden: new Set(), pictures: new Map(),
    playing: null, drawn: 0, rank: 0, projected: {},
  };
  const renderer = drawing.renderer($("space"));
  let look = panels.style();
  let due = false;

  const sequence = () => data.sequences[data.sequenceOf(view.frame)];
  const clamp = (value, low, high) => Math.max(low, Math.min(high, value));

  /* Drawing: at most once a frame of the screen. */
  function redraw() {
    if (!due) requestAnimationFrame(draw);
    due = true;
  }

  function draw() {
    due = false;
    if (!data.count) return;
    panels.drawPlane($("plane"), data, view, look);
    panels.drawSpace($("space"), renderer, data, view, look);
    showSides();
    panels.nameMarks($("labels"), data, view, look);
    drawStrip();
    view.opened ??= performance.now();
    view.drawn++;
  }

  /** Mark the frame on the strip; the bars are drawn only when they change. */
  function drawStrip() {
    const { start, end } = sequence();
    $("marker").style.left = `${(100 * (view.frame - start + 0.5)) / (end - start)}%`;
    const key = [start, $("measure").value, $("strip").clientWidth, look.background, ...view.shown].map((part) => part.name ?? part).join();
    if (drawStrip.key === key) return;
    drawStrip.key = key;
    const [width, height, ratio] = panels.fitCanvas($("strip"));
    const context = $("strip").getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const rows = stripRows().map(({ layer, levels, limit }) => ({ levels, limit, tint: look.layer(layer.colour) }));
    strip.draw(context, width, height, rows, look);
  }

  /** Levels of the chosen measure over the current sequence, a row for each layer that has it. */
  function stripRows() {
    const name = $("measure").value;
    const { start, end } = sequence();
    const key = `${name}/${start}`;
    if (stripRows.key !== key) {
      stripRows.key = key;
      stripRows.rows = data.layers.flatMap((layer) => {
        const measure = layer.measures.find((m) => m.name === name);
        if (!measure) return [];
        const values = measure.values.subarray(start, end);
        return [{ layer, levels: strip.badness(values, measure), limit: strip.threshold(values, measure) }];
      });
    }
    return stripRows.rows.filter(({ layer }) => view.shown.has(layer));
  }

  /* Frames. */
  function go(frame) {
    const before = data.sequenceOf(view.frame);
    view.frame = clamp(Math.round(frame), 0, data.count - 1);
    if (data.sequenceOf(view.frame) !== before) enterSequence();
    loadPicture(view.frame);
    $("slider").value = view.frame - sequence().start;
    if (!view.playing) tellSoon();
    redraw();
  }

  function tellSoon() {
    clearTimeout(tellSoon.timer);
    tellSoon.timer = setTimeout(tell, 80);
  }

  function enterSequence() {
    const { name, start, end } = sequence();
    $("slider").max = Math.max(0, end - start - 1);
    $("slider").disabled = $("play").disabled = end - start < 2;
    view.rank = 0;
    fillIndividuals();
    Object.assign(view, framing.ofSequence(data, start, end, !name && !data.rateKnown));
    search();
  }

  function loadPicture(frame) {
    const picture = data.pictures[frame];
    if (!picture || view.pictures.has(frame)) return;
    const image = new Image();
    image.onload = redraw;
    image.src = picture.data;
    view.pictures.set(frame, image);
    if (view.pictures.size > 60) view.pictures.delete(view.pictures.keys().next().value);
  }

  /** Say in words what is shown, and mark it in the list. */
  function tell() {
    const { name, start, end } = sequence();
    const parts = [data.items[view.frame], `frame ${view.frame - start + 1} of ${end - start}${name ? ` in ${name}` : ""}`];
    for (const layer of data.layers) parts.push(describe(layer));
    $("state").textContent = parts.filter(Boolean).join(" · ");
    tellDoubts();
    listed.mark((row) => row.frame === view.frame);
  }

  /** The badge: whether the shapes that are shown are to be trusted, and why not. */
  function tellDoubts() {
    const judged = data.layers.filter((layer) => layer.doubt && view.shown.has(layer));
    const doubts = judged.filter((layer) => layer.doubt(view.frame));
    $("badge").hidden = !judged.length;
    $("badge").className = doubts.length ? "doubtful" : "";
    $("badge").textContent = doubts.length
      ? `not to be trusted: ${doubts.map((layer) => (judged.length > 1 ? `${layer.name}: ` : "") + layer.doubt(view.frame)).join("; ")}`
      : "trusted";
  }

  function short(value) {
    return Math.abs(value) < 1e-3 && value !== 0 ? value.toExponential(1) : String(Number(value.toPrecision(3)));
  }

  function describe(layer) {
    const known = layer.measures
      .filter((m) => m.scale !== "share")
      .map((m) => [m, m.values[view.frame]])
      .map(([m, value]) => (Number.isFinite(value) ? `${m.name} ${short(value)}${m.unit ? ` ${m.unit}` : ""}` : ""));
    const words = [layer.words(view.frame), ...known].filter(Boolean);
    return words.length ? `${layer.name}: ${words.join(", ")}` : "";
  }

  /* Playing. */
  function play(on = !view.playing) {
    if (!on || sequence().end - sequence().start < 2) {
      view.playing = null;
      tell();
    } else {
      view.playing = { since: performance.now(), from: view.frame };
      requestAnimationFrame(advance);
    }
    $("play").textContent = view.playing ? "Pause" : "Play";
    $("play").setAttribute("aria-pressed", Boolean(view.playing));
  }

  function advance(now) {
    if (!view.playing) return;
    const { start, end } = sequence();
    const passed = (Math.max(0, now - view.playing.since) / 1000) * data.frameRate * Number($("speed").value);
    const frame = start + ((view.playing.from - start + Math.floor(passed)) % (end - start));
    if (frame !== view.frame) go(frame);
    requestAnimationFrame(advance);
  }

  function restart() {
    if (view.playing) view.playing = { since: performance.now(), from: view.frame };
  }

  /** The user goes to a frame; playing goes on from there. */
  function jump(frame) {
    go(frame);
    restart();
  }

  function jumpSequence(step) {
    const next = data.sequences[clamp(data.sequenceOf(view.frame) + step, 0, data.sequences.length - 1)];
    jump(next.start);
  }

  function jumpWorst() {
    const rows = stripRows();
    if (!rows.length) return;
    const worst = rows[0].levels.map((_, i) => Math.max(...rows.map(({ levels }) => levels[i])));
    const order = strip.ranking(worst);
    const next = order[view.rank % order.length];
    jump(sequence().start + next);
    view.rank++;
  }

  function jumpDoubtful() {
    const { start, end } = sequence();
    const next = scene.nextDoubtful([...view.shown], view.frame, start, end);
    if (next >= 0) jump(next);
  }

  /* The camera. */
  function turn(yaw, pitch) {
    view.yaw += yaw;
    view.pitch = clamp(view.pitch + pitch, -90, 90);
    redraw();
  }

  function stand(yaw, pitch) {
    [view.yaw, view.pitch] = [yaw, pitch];
    redraw();
  }

  function reset() {
    Object.assign(view, { zoom: 1, pan: [0, 0], planeZoom: 1, planePan: [0, 0] });
    stand(0, 0);
  }

  function zoomSpace(factor) {
    view.zoom = clamp(view.zoom * factor, 0.05, 50);
    redraw();
  }

  function zoomPlane(factor) {
    view.planeZoom = clamp(view.planeZoom * factor, 0.05, 50);
    redraw();
  }

  const DEGREES_A_PIXEL = 0.5;

  pointer.listen($("space"), (dx, dy, moving) => {
    if (!moving) return turn(DEGREES_A_PIXEL * dx, DEGREES_A_PIXEL * dy);
    view.pan = [view.pan[0] + dx, view.pan[1] + dy];
    redraw();
  }, zoomSpace);
  pointer.listen($("plane"), (dx, dy) => {
    view.planePan = [view.planePan[0] + dx, view.planePan[1] + dy];
    redraw();
  }, zoomPlane);

  /* The first turn shows that the shape is one in space; it ends where it began, or at a touch. */
  const TURN = { seconds: 14, pause: 0.8, pitch: 12 };

  function firstTurn(now) {
    if (!view.turning) return;
    view.turning.since ??= now;
    const passed = (now - view.turning.since) / 1000 - TURN.pause;
    view.yaw = 360 * clamp(passed / TURN.seconds, 0, 1);
    if (passed >= TURN.seconds) stopTurning();
    else requestAnimationFrame(firstTurn);
    redraw();
  }

  /** Leave the shape as it stands, with a yaw that views and keys can go on from. */
  function stopTurning() {
    if (view.turning) view.yaw %= 360;
    view.turning = null;
  }

  for (const touch of ["pointerdown", "keydown", "wheel"]) document.addEventListener(touch, stopTurning, { capture: true, passive: true });

  /* Keys. */
  const KEYS = {
    " ": () => play(), w: jumpWorst, W: jumpWorst, d: jumpDoubtful, D: jumpDoubtful, 0: reset,
    1: () => stand(0, 0), 2: () => stand(-90, 0), 3: () => stand(0, 90),
    "+": () => zoomSpace(1.2), "=": () => zoomSpace(1.2), "-": () => zoomSpace(1 / 1.2),
    Home: () => jump(sequence().start), End: () => jump(sequence().end - 1),
    ArrowUp: () => jumpSequence(-1), ArrowDown: () => jumpSequence(1),
    "/": () => $("search").focus(),
  };

  function within(frame) {
    return clamp(frame, sequence().start, sequence().end - 1);
  }

  document.addEventListener("keydown", (event) => {
    const { target, key } = event;
    if (event.ctrlKey || event.metaKey || event.defaultPrevented) return;
    if (target.id === "search") {
      if (key === "Escape") target.blur();
      return;
    }
    if (target.tagName === "SELECT") return;
    if (key === " " && ["BUTTON", "INPUT", "SUMMARY"].includes(target.tagName) && target.type !== "range") return;
    const across = { ArrowLeft: -1, ArrowRight: 1 }[key];
    const along = { ArrowUp: -1, ArrowDown: 1 }[key];
    let action = KEYS[key];
    if (event.altKey && (across || along)) action = () => turn(5 * (across ?? 0), 5 * (along ?? 0));
    else if (across) action = () => jump(within(view.frame + across * (event.shiftKey ? 10 : 1)));
    if (!action) return;
    event.preventDefault();
    action();
  });

  /* Controls. */
  function choice(label, checked, changed) {
    const [box, row] = [document.createElement("input"), document.createElement("label")];
    Object.assign(box, { type: "checkbox", checked });
    box.addEventListener("change", () => changed(box.checked));
    row.append(box, ...label);
    return row;
  }

  function fillLayers() {
    for (const layer of data.layers) {
      const patch = document.createElement("i");
      const paint = () => (patch.style.background = `var(--${layer.colour})`);
      paint();
      const name = document.createElement("bdi");
      name.textContent = layer.name;
      $("layers").append(choice([patch, name], view.shown.has(layer), (on) => {
        if (on) view.shown.add(layer);
        else view.shown.delete(layer);
        tellDoubts();
        redraw();
      }));
    }
  }

  /** A tick for each individual of the scene, in its colour; the one whose frames are shown stays. */
  function fillIndividuals() {
    const group = data.group(data.sequenceOf(view.frame));
    const ticks = group.length < 2 || data.layers.filter(({ role }) => role !== "truth").length > 1 ? [] : group.map((index) => {
      const [patch, name] = [document.createElement("i"), document.createElement("bdi")];
      patch.style.background = `var(--${panels.colourOf(data, data.layers[0], data.sequences[index].start)})`;
      name.textContent = data.sequences[index].name.split("/").pop();
      return choice([patch, name], !view.hidden.has(index), (on) => {
        if (on) view.hidden.delete(index);
        else view.hidden.add(index);
        redraw();
      });
    });
    $("individuals").replaceChildren(...ticks);
  }

  /** Left and right have colours that the page explains where one layer is shown alone. */
  function showSides() {
    $("sides").hidden = !data.sides || !data.sidesNamed || view.shown.size !== 1 || panels.framesOf(data, view).length > 1;
    const [layer] = view.shown;
    if (layer) $("left-mark").style.background = `var(--${panels.colourOf(data, layer, view.frame)})`;
  }

  /** Explain the marks of the left panel that occur. */
  function fillKey() {
    const results = data.layers.some((layer) => layer.role === "result");
    const marks = [
      ["● observed", data.seen(0)], ["○ hidden, from the model", results && data.seen(0)],
      ["✕ outlier", data.hasOutliers], ["to its fitted position", results && data.seen(0), "residual-mark"],
      ["◍ one standard deviation", data.layers.some((layer) => layer.sd(0))],
    ];
    for (const [text, occurs, mark] of marks) {
      if (!occurs) continue;
      const entry = document.createElement("li");
      if (mark) entry.append(Object.assign(document.createElement("i"), { id: mark }));
      entry.append(text);
      $("marks").append(entry);
    }
  }

  function fillMeasures() {
    const names = new Set(data.layers.flatMap((layer) => layer.measures.map((m) => m.name)));
    for (const name of names) $("measure").append(new Option(name, name));
    const none = names.size === 0;
    for (const id of ["measure", "worst", "bars"]) $(id).hidden = none;
    document.querySelector("label[for=measure]").hidden = none;
    $("measure").value = [...names].find((name) => name === "error") ?? [...names][0] ?? "";
  }

  const listed = list.make(
    $("list"),
    (row) => (row.frame === undefined
      ? { kind: "sequence", text: `${data.sequences[row.sequence].name || "(no sequence)"} (${data.sequences[row.sequence].end - data.sequences[row.sequence].start})` }
      : { kind: "frame", text: data.items[row.frame] }),
    (row) => jump(row.frame ?? data.sequences[row.sequence].start),
  );

  function search() {
    const text = $("search").value;
    const rows = scene.find(data, text, data.sequenceOf(view.frame));
    const frames = rows.filter((row) => row.frame !== undefined).length;
    $("found").textContent = text.trim() ? `${frames} of ${data.count} found` : `${data.count} frames, ${data.sequences.length} ${data.sequences.length === 1 ? "sequence" : "sequences"}`;
    listed.show(rows);
    listed.mark((row) => row.frame === view.frame);
    view.found = rows;
  }

  $("search").addEventListener("input", search);
  $("search").addEventListener("keydown", (event) => {
    const first = view.found.find((row) => row.frame !== undefined) ?? view.found[0];
    if (event.key === "Enter" && first) jump(first.frame ?? data.sequences[first.sequence].start);
  });
  $("slider").addEventListener("input", () => jump(sequence().start + Number($("slider").value)));
  $("play").addEventListener("click", () => play());
  $("speed").addEventListener("change", restart);
  $("measure").addEventListener("change", () => { view.rank = 0; redraw(); });
  $("worst").addEventListener("click", jumpWorst);
  $("doubtful").addEventListener("click", jumpDoubtful);
  $("strip").addEventListener("click", (event) => {
    const { start, end } = sequence();
    const box = $("strip").getBoundingClientRect();
    jump(start + strip.frameAt(event.clientX - box.left, box.width, end - start));
  });
  for (const key of ["mesh", "names", "upright"]) {
    $(key).addEventListener("change", () => { view[key] = $(key).checked; redraw(); });
  }
  $("front").addEventListener("click", KEYS[1]);
  $("side").addEventListener("click", KEYS[2]);
  $("top").addEventListener("click", KEYS[3]);
  $("reset").addEventListener("click", reset);
  $("theme").addEventListener("click", () => {
    const root = document.documentElement;
    const dark = getComputedStyle(root).colorScheme.includes("dark");
    root.dataset.theme = dark ? "light" : "dark";
    restyle();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", restyle);
  window.addEventListener("resize", redraw);
  window.addEventListener("hashchange", followLink);

  function restyle() {
    look = panels.style();
    redraw();
  }

  /** Go to the item that the address names: page.html#item=NAME. */
  function followLink() {
    const item = new URLSearchParams(location.hash.slice(1)).get("item");
    const frame = item === null ? -1 : data.items.indexOf(item);
    if (frame >= 0) jump(frame);
    else if (item !== null) $("state").textContent = `This page has no item ${item}.`;
    return frame >= 0;
  }

  function begin() {
    fillLayers();
    fillMeasures();
    fillKey();
    $("mesh-choice").hidden = $("upright-choice").hidden = !data.layers.some((layer) => layer.faces);
    $("rate").textContent = data.count > 1 ? `${data.frameRate} frames/s${data.rateKnown ? "" : " (not stated in the files)"}` : "";
    $("doubtful").hidden = !data.layers.some((layer) => layer.doubt);
    $("flat").hidden = !data.flat;
    $("solid").hidden = $("layers").hidden = !data.layers.length;
    if (!renderer) {
      $("broken").hidden = false;
      $("broken").textContent = "This browser has no WebGL2, so the 3D panel stays empty; open the page in another one.";
    }
    enterSequence();
    if (!followLink()) go(0);
    if (renderer && data.layers.length && !matchMedia("(prefers-reduced-motion: reduce)").matches) {
      view.turning = {};
      view.pitch = TURN.pitch;
      requestAnimationFrame(firstTurn);
    }
  }

  /** What the page shows, for scripts and tests. */
  window.shapefit = {
    data,
    get frame() { return view.frame; },
    get item() { return data.items[view.frame]; },
    get camera() { return { yaw: view.yaw, pitch: view.pitch, zoom: view.zoom, pan: view.pan }; },
    get projected() { return view.projected; },
    get playing() { return Boolean(view.playing); },
    get turning() { return Boolean(view.turning); },
    get drawn() { return view.drawn; },
    get opened() { return view.opened; },
    get plane() { return view.plane; },
    get shown() { return [...view.shown].map((layer) => layer.name); },
    get landmarks() { return Array.from(data.seen(view.frame) ?? []); },
    onPlane: (x, y) => view.onPlane(x, y),
    layer: (name) => data.layers.find((layer) => layer.name === name),
    turn,
    go: jump,
  };

  if (data.count) begin();
})();
