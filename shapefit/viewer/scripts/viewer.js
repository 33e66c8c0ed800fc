/** The page at work: its state, what is drawn of it, and what keys, mouse and buttons do to it. */
(() => {
  const $ = (id) => document.getElementById(id);
  const AS_AT_FIRST = { yaw: 0, pitch: 0, zoom: 1, pan: [0, 0], planeZoom: 1, planePan: [0, 0] };
  const DEGREES_A_PIXEL = 0.5;
  const DARK = matchMedia("(prefers-color-scheme: dark)");
  const data = scene.open(JSON.parse($("page").textContent));
  data.layers.forEach((layer, i) => {
    layer.colour = layer.role === "truth" ? "truth" : `layer-${i % 6}`;
  });
  const view = {
    frame: 0, ...AS_AT_FIRST,
    shown: new Set(data.layers.filter((layer, i) => i === 0 || !data.layers[0].faces)), hidden: new Set(),
    mesh: true, names: false, upright: false, pictures: {}, playing: null, drawn: 0, rank: 0, projected: {}, axes: [],
  };
  const renderer = drawing.renderer($("space"));
  let due = false;

  const sequence = () => data.sequences[data.sequenceOf(view.frame)];
  const clamp = (value, low, high) => Math.max(low, Math.min(high, value));

  /** Change the state and draw it: at most once a frame of the screen. */
  function change(state = {}) {
    Object.assign(view, state);
    if (!due) requestAnimationFrame(draw);
    due = true;
  }

  function draw() {
    due = false;
    if (!data.count) return;
    if (data.flat) view.plane = plane.draw($("plane"), data, view);
    Object.assign(view, space.draw($("space"), renderer, data, view));
    space.nameMarks($("labels"), data, view);
    showSides();
    drawStrip();
    view.opened ??= performance.now();
    view.drawn++;
  }

  /** Mark the frame on the strip; the bars are drawn only when they change. */
  function drawStrip() {
    const { start, end } = sequence();
    $("marker").style.left = `${(100 * (view.frame - start + 0.5)) / (end - start)}%`;
    const key = [start, $("measure").value, $("strip").clientWidth, look.text("background"), ...view.shown].map((part) => part.name ?? part).join();
    if (drawStrip.key === key) return;
    drawStrip.key = key;
    const [width, height, ratio] = look.fitCanvas($("strip"));
    const context = $("strip").getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const rows = stripRows().map((row) => ({ ...row, tint: look.text(row.layer.colour) }));
    strip.draw(context, width, height, rows, look.text("outlier"));
  }

  /** Levels of the chosen measure over the current sequence, a row for each shown layer that has it. */
  function stripRows() {
    const { start, end } = sequence();
    return [...view.shown].flatMap((layer) => {
      const measure = layer.measures.find((m) => m.name === $("measure").value);
      if (!measure) return [];
      const values = measure.values.subarray(start, end);
      const [limit] = strip.badness(values, measure, [measure.limit]);
      return [{ layer, levels: strip.badness(values, measure), limit }];
    });
  }

  /* Frames. */
  function go(frame) {
    const before = data.sequenceOf(view.frame);
    view.frame = clamp(Math.round(frame), 0, data.count - 1);
    if (data.sequenceOf(view.frame) !== before) enterSequence();
    loadPicture(view.frame);
    $("slider").value = view.frame - sequence().start;
    clearTimeout(go.telling);
    if (!view.playing) go.telling = setTimeout(tell, 80);
    change();
  }

  function enterSequence() {
    const { start, end } = sequence();
    $("slider").max = Math.max(0, end - start - 1);
    $("slider").disabled = $("play").disabled = end - start < 2;
    view.rank = 0;
    fillIndividuals();
    search();
  }

  function loadPicture(frame) {
    const picture = data.pictures[frame];
    if (picture) view.pictures[frame] ??= Object.assign(new Image(), { onload: () => change(), src: picture.data });
  }

  /** Say in words what is shown, whether it is to be trusted and why not, and mark it in the list. */
  function tell() {
    const { name, start, end } = sequence();
    const parts = [data.items[view.frame], `frame ${view.frame - start + 1} of ${end - start}${name ? ` in ${name}` : ""}`, ...data.layers.map(describe)];
    $("state").textContent = parts.filter(Boolean).join(" · ");
    const judged = data.layers.filter((layer) => layer.doubt && view.shown.has(layer));
    const doubts = judged.filter((layer) => layer.doubt(view.frame)).map((layer) => (judged.length > 1 ? `${layer.name}: ` : "") + layer.doubt(view.frame));
    $("badge").hidden = !judged.length;
    $("badge").className = doubts.length ? "doubtful" : "";
    $("badge").textContent = doubts.length ? `not to be trusted: ${doubts.join("; ")}` : "trusted";
    $("list").value = `frame ${view.frame}`;
  }

  function describe(layer) {
    const short = (value) => (Math.abs(value) < 1e-3 && value !== 0 ? value.toExponential(1) : String(Number(value.toPrecision(3))));
    const known = layer.measures
      .filter((m) => m.scale !== "share" && Number.isFinite(m.values[view.frame]))
      .map((m) => `${m.name} ${short(m.values[view.frame])} ${m.unit}`.trim());
    const words = [layer.status(view.frame), ...known].filter(Boolean);
    return words.length ? `${layer.name}: ${words.join(", ")}` : "";
  }

  /* Playing. */
  function play(on = !view.playing) {
    view.playing = on && sequence().end - sequence().start > 1 ? { since: performance.now(), from: view.frame } : null;
    if (view.playing) requestAnimationFrame(advance);
    else tell();
    $("play").textContent = view.playing ? "Pause" : "Play";
    $("play").setAttribute("aria-pressed", Boolean(view.playing));
  }

  function advance(now) {
    if (!view.playing) return;
    const { start, end } = sequence();
    const passed = (Math.max(0, now - view.playing.since) / 1000) * data.frame_rate * Number($("speed").value);
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
    jump(data.sequences[clamp(data.sequenceOf(view.frame) + step, 0, data.sequences.length - 1)].start);
  }

  function jumpWorst() {
    const [first, ...others] = stripRows().map(({ levels }) => levels);
    if (!first) return;
    const order = strip.ranking(first.map((level, i) => Math.max(level, ...others.map((levels) => levels[i]))));
    jump(sequence().start + order[view.rank % order.length]);
    view.rank++;
  }

  function jumpDoubtful() {
    const { start, end } = sequence();
    jump(scene.nextDoubtful([...view.shown], view.frame, start, end));
  }

  /* The camera. */
  function turn(yaw, pitch) {
    change({ yaw: view.yaw + yaw, pitch: clamp(view.pitch + pitch, -90, 90) });
  }

  function zoom(factor, name = "zoom") {
    change({ [name]: clamp(view[name] * factor, 0.05, 50) });
  }

  /** Call dragged(dx, dy, moving) for each step of a drag in px, and zoomed(factor) for the wheel. */
  function listen(canvas, dragged, zoomed) {
    let last = null;
    canvas.addEventListener("pointerdown", (event) => {
      last = [event.clientX, event.clientY];
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!last) return;
      dragged(event.clientX - last[0], event.clientY - last[1], event.shiftKey || event.buttons === 2);
      last = [event.clientX, event.clientY];
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => (last = null));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      zoomed(Math.exp(-0.0015 * event.deltaY));
    }, { passive: false });
  }

  const moved = (pan, dx, dy) => [pan[0] + dx, pan[1] + dy];
  listen($("space"), (dx, dy, moving) => {
    if (moving) change({ pan: moved(view.pan, dx, dy) });
    else turn(DEGREES_A_PIXEL * dx, DEGREES_A_PIXEL * dy);
  }, zoom);
  listen($("plane"), (dx, dy) => change({ planePan: moved(view.planePan, dx, dy) }), (factor) => zoom(factor, "planeZoom"));

  /* Keys. */
  const step = (count) => jump(clamp(view.frame + count, sequence().start, sequence().end - 1));
  const KEYS = {
    " ": () => play(), w: jumpWorst, d: jumpDoubtful, 0: () => change(AS_AT_FIRST),
    1: () => change({ yaw: 0, pitch: 0 }), 2: () => change({ yaw: -90, pitch: 0 }), 3: () => change({ yaw: 0, pitch: 90 }),
    "+": () => zoom(1.2), "=": () => zoom(1.2), "-": () => zoom(1 / 1.2),
    home: () => jump(sequence().start), end: () => jump(sequence().end - 1),
    arrowleft: (shift) => step(shift ? -10 : -1), arrowright: (shift) => step(shift ? 10 : 1),
    arrowup: () => jumpSequence(-1), arrowdown: () => jumpSequence(1),
    "/": () => $("search").focus(),
  };
  const TURNS = { arrowleft: [-5, 0], arrowright: [5, 0], arrowup: [0, -5], arrowdown: [0, 5] };

  document.addEventListener("keydown", (event) => {
    const { target } = event;
    const key = event.key.toLowerCase();
    if (event.ctrlKey || event.metaKey || target.tagName === "SELECT") return;
    if (target.id === "search") {
      if (key === "escape") target.blur();
      return;
    }
    if (key === " " && ["BUTTON", "INPUT", "SUMMARY"].includes(target.tagName) && target.type !== "range") return;
    const action = event.altKey && TURNS[key] ? () => turn(...TURNS[key]) : KEYS[key];
    if (!action) return;
    event.preventDefault();
    action(event.shiftKey);
  });

  /* Controls. */
  function choice(colour, text, checked, changed) {
    const [row, box, patch, name] = ["label", "input", "i", "bdi"].map((tag) => document.createElement(tag));
    Object.assign(box, { type: "checkbox", checked });
    box.addEventListener("change", () => {
      changed(box.checked);
      tell();
      change();
    });
    patch.style.background = `var(--${colour})`;
    name.textContent = text;
    row.append(box, patch, name);
    return row;
  }

  /** A tick for each layer; `put` in or out of a set what is switched on or off. */
  function fillLayers() {
    $("layers").append(...data.layers.map((layer) => choice(layer.colour, layer.name, view.shown.has(layer), (on) => {
      view.shown[on ? "add" : "delete"](layer);
    })));
  }

  /** A tick for each individual of the scene, in its colour; the one whose frames are shown stays. */
  function fillIndividuals() {
    const group = data.group(data.sequenceOf(view.frame));
    const one = data.layers.filter(({ role }) => role !== "truth").length === 1;
    $("individuals").replaceChildren(...(group.length > 1 && one ? group : []).map((index) => {
      const { name, start } = data.sequences[index];
      return choice(look.colourOf(data, data.layers[0], start), name.split("/").pop(), !view.hidden.has(index), (on) => {
        view.hidden[on ? "delete" : "add"](index);
      });
    }));
  }

  /** Left and right have colours that the page explains where one layer is shown alone. */
  function showSides() {
    $("sides").hidden = !data.sides || !data.sides_named || view.shown.size !== 1 || look.framesOf(data, view).length > 1;
    const [layer] = view.shown;
    if (layer) $("left-mark").style.background = `var(--${look.colourOf(data, layer, view.frame)})`;
  }

  /** Explain the marks of the left panel that occur. */
  function showKey() {
    const fitted = data.layers.some((layer) => layer.role === "result");
    $("key-observed").hidden = !data.seen(0);
    $("key-hidden").hidden = $("key-residual").hidden = !(fitted && data.seen(0));
    $("key-outlier").hidden = !data.hasOutliers;
    $("key-bars").hidden = !data.layers.some((layer) => layer.sd(0));
  }

  function fillMeasures() {
    const names = [...new Set(data.layers.flatMap((layer) => layer.measures.map((m) => m.name)))];
    $("measure").append(...names.map((name) => new Option(name, name)));
    for (const id of ["measure", "worst", "bars", "measure-label"]) $(id).hidden = !names.length;
  }

  /** The list: frames of a sequence without its name, which stands above them. */
  function search() {
    const text = $("search").value;
    const rows = scene.find(data, text, data.sequenceOf(view.frame));
    const frames = rows.filter((row) => row.frame !== undefined).length;
    const counted = `${data.count} frames, ${data.sequences.length} ${data.sequences.length === 1 ? "sequence" : "sequences"}`;
    $("found").textContent = text.trim() ? `${frames} of ${data.count} found` : counted;
    $("list").replaceChildren(...rows.map(({ sequence: index, frame }) => {
      if (frame === undefined) {
        const { name, start, end } = data.sequences[index];
        return Object.assign(new Option(`${name || "(no sequence)"} (${end - start})`, `sequence ${index}`), { className: "sequence" });
      }
      const [item, above] = [data.items[frame], `${data.sequences[data.sequenceOf(frame)].name}/`];
      const shown = !text.trim() && item.startsWith(above) ? item.slice(above.length) : item;
      return Object.assign(new Option(shown, `frame ${frame}`), { className: "frame", title: item });
    }));
    $("list").value = `frame ${view.frame}`;
    search.first = rows.find((row) => row.frame !== undefined) ?? rows[0];
  }

  function follow(row) {
    jump(row.frame ?? data.sequences[row.sequence].start);
  }

  const on = (id, event, act) => $(id).addEventListener(event, act);
  on("search", "input", search);
  on("search", "keydown", (event) => event.key === "Enter" && search.first && follow(search.first));
  on("list", "change", () => {
    const [kind, index] = $("list").value.split(" ");
    follow({ [kind]: Number(index) });
  });
  on("list", "click", () => $("list").blur()); // the keys are the page's again
  on("slider", "input", () => jump(sequence().start + Number($("slider").value)));
  on("speed", "change", restart);
  on("measure", "change", () => change({ rank: 0 }));
  on("strip", "click", (event) => {
    const { start, end } = sequence();
    const box = $("strip").getBoundingClientRect();
    jump(start + strip.frameAt(event.clientX - box.left, box.width, end - start));
  });
  for (const key of ["mesh", "names", "upright"]) on(key, "change", () => change({ [key]: $(key).checked }));
  for (const button of document.querySelectorAll("[data-key]")) button.addEventListener("click", () => KEYS[button.dataset.key]());
  on("theme", "click", () => restyle(document.documentElement.dataset.theme === "light"));
  DARK.addEventListener("change", () => restyle(DARK.matches));
  window.addEventListener("resize", () => change());
  window.addEventListener("hashchange", followLink);

  function restyle(dark) {
    document.documentElement.dataset.theme = dark ? "dark" : "light";
    change();
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
    restyle(DARK.matches);
    fillLayers();
    fillMeasures();
    showKey();
    $("mesh-choice").hidden = $("upright-choice").hidden = !data.layers.some((layer) => layer.faces);
    $("rate").textContent = data.count > 1 ? `${data.frame_rate} frames/s${data.rate_known ? "" : " (not stated in the files)"}` : "";
    $("doubtful").hidden = !data.layers.some((layer) => layer.doubt);
    $("flat").hidden = !data.flat;
    $("solid").hidden = $("layers").hidden = !data.layers.length;
    $("broken").hidden = Boolean(renderer);
    enterSequence();
    if (!followLink()) go(0);
  }

  /** What the page shows, for scripts and tests. */
  window.shapefit = {
    data,
    view,
    get item() { return data.items[view.frame]; },
    layer: (name) => data.layers.find((layer) => layer.name === name),
    turn,
    go: jump,
  };

  begin();
})();
