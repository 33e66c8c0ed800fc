/** The page at work: its state, what is drawn of it, and what keys, mouse and buttons do to it. */
(() => {
  const $ = (id) => document.getElementById(id);
  const AS_AT_FIRST = { yaw: 0, pitch: 0, zoom: 1, pan: [0, 0], planeZoom: 1, planePan: [0, 0] };
  const DEGREES_A_PIXEL = 0.5;
  const DARK = matchMedia("(prefers-color-scheme: dark)");
  const data = scene.open(JSON.parse($("page").textContent));
  const view = {
    frame: 0, ...AS_AT_FIRST,
    shown: new Set(data.layers.filter((layer, i) => i === 0 || !data.layers[0].faces)), hidden: new Set(),
    mesh: true, names: false, upright: false, pictures: {}, playing: null, drawn: 0, rank: 0, projected: {},
  };
  let due = false;

  const recording = () => data.recordingOf(view.frame);
  const time = () => data.timeOf(view.frame);
  const clamp = (value, low, high) => Math.max(low, Math.min(high, value));
  const shown = () => data.layers.filter((layer) => view.shown.has(layer));
  const visible = (frame) => !view.hidden.has(data.sequenceOf(frame));

  /** Change the state and draw it: at most once a frame of the screen. */
  function change(state = {}) {
    Object.assign(view, state);
    if (!due) requestAnimationFrame(draw);
    due = true;
  }

  function draw() {
    due = false;
    if (!data.count) return;
    if (data.flat) plane.draw($("plane"), data, view);
    if (data.layers.length) view.projected = space.draw($("space"), data, view);
    drawStrip();
    view.drawn++;
  }

  /** Mark the frame on the strip; the bars are drawn only when they change. */
  function drawStrip() {
    const { length, tracks } = recording();
    $("marker").style.left = `calc(${strip.LEFT}px + (100% - ${strip.LEFT}px) * ${(time() + 0.5) / length})`;
    const key = [tracks[0].start, $("measure").value, $("strip").clientWidth, look.text("background"), ...view.hidden, ...shown().map(({ name }) => name)].join();
    if (drawStrip.key === key) return;
    drawStrip.key = key;
    const rows = stripRows();
    if (!rows.length) return;
    $("strip").style.height = `${clamp(26 * rows.length, 44, 120) + 16}px`;
    strip.draw(look.pen($("strip")), rows, { ...rows[0], rate: data.rate_known && data.frame_rate });
  }

  /** The chosen measure over the recording, a row for each shown layer that has it and individual. */
  function stripRows() {
    return shown().flatMap((layer) => {
      const measure = layer.measures.find((m) => m.name === $("measure").value);
      const tracks = measure ? recording().tracks : [];
      return tracks.flatMap(({ frames, sequence, label }, track) => (view.hidden.has(sequence) ? [] : [{
        name: tracks.length > 1 ? label : layer.name,
        tint: look.text(look.colourOf(data, layer, track)),
        bad: measure.bad,
        limit: measure.limit,
        bars: Array.from(frames, (frame) => (frame < 0 ? null : { value: measure.values[frame], state: stateOf(layer, frame) })),
      }]));
    });
  }

  function stateOf(layer, frame) {
    return !layer.has(frame) ? "none" : layer.doubt?.(frame) ? "doubtful" : "trusted";
  }

  /* Frames. */
  function go(frame) {
    const before = data.sequenceOf(view.frame);
    view.frame = clamp(Math.round(frame), 0, data.count - 1);
    if (data.sequenceOf(view.frame) !== before) enterSequence();
    const picture = data.pictures[view.frame];
    if (picture) view.pictures[view.frame] ??= Object.assign(new Image(), { onload: () => change(), src: picture.data });
    $("slider").value = time();
    clearTimeout(go.telling);
    if (!view.playing) go.telling = setTimeout(tell, 80);
    change();
  }

  /** The same individual at another time or, where it is not there, one that is; the times between have nobody. */
  function frameAt(wanted, step = 1) {
    const { tracks, length } = recording();
    const own = tracks.find(({ sequence }) => sequence === data.sequenceOf(view.frame));
    for (let at = clamp(wanted, 0, length - 1); at >= 0 && at < length; at += step) {
      const [found] = [own.frames[at], ...scene.framesAt(recording(), at)].filter((frame) => frame >= 0);
      if (found !== undefined) return found;
    }
    return view.frame;
  }

  function enterSequence() {
    const { length } = recording();
    $("slider").max = length - 1;
    $("slider").disabled = $("play").disabled = length < 2;
    view.rank = 0;
    fillLayers();
    search();
  }

  /** Say in words what is shown, whether it is to be trusted and why not, and mark it in the list. */
  function tell() {
    const { tracks, length } = recording();
    const layers = shown();
    const known = scene.framesAt(recording(), time()).filter((frame) => visible(frame) || frame === view.frame);
    const named = (layer, frame, text) => {
      const name = tracks.length > 1 ? tracks.find(({ sequence }) => sequence === data.sequenceOf(frame)).label : layers.length > 1 ? layer.name : "";
      return name && text ? `${name}: ${text}` : text;
    };
    const doubts = layers.flatMap((layer) => known.map((frame) => named(layer, frame, layer.doubt?.(frame)))).filter(Boolean);
    $("badge").hidden = !layers.some((layer) => layer.doubt);
    $("badge").className = doubts.length ? "doubtful" : "";
    $("badge").textContent = doubts.length ? `not to be trusted: ${doubts.join("; ")}` : "trusted";
    const own = layers.map((layer) => named(layer, view.frame, describe(layer, view.frame))).filter(Boolean);
    $("state").textContent = [data.items[view.frame], `frame ${time() + 1} of ${length}`, ...own].join(" · ");
    $("list").value = `frame ${view.frame}`;
  }

  function describe(layer, frame) {
    if (!layer.has(frame)) return layer.role === "result" ? "no shape" : "";
    const short = (value) => (Math.abs(value) < 1e-3 && value !== 0 ? value.toExponential(1) : String(Number(value.toPrecision(3))));
    const known = layer.measures
      .filter((m) => Number.isFinite(m.values[frame]))
      .map((m) => `${m.name} ${short(m.values[frame])} ${m.unit}`.trim());
    return [layer.word(frame), ...known].filter(Boolean).join(", ");
  }

  /* Playing. */
  function play(on = !view.playing) {
    view.playing = on && recording().length > 1 ? { since: performance.now(), from: time() } : null;
    if (view.playing) requestAnimationFrame(advance);
    else tell();
    $("play").textContent = view.playing ? "Pause" : "Play";
    $("play").setAttribute("aria-pressed", Boolean(view.playing));
  }

  function advance(now) {
    if (!view.playing) return;
    const passed = (Math.max(0, now - view.playing.since) / 1000) * data.frame_rate * Number($("speed").value);
    const frame = frameAt((view.playing.from + Math.floor(passed)) % recording().length);
    if (frame !== view.frame) go(frame);
    requestAnimationFrame(advance);
  }

  function restart() {
    if (view.playing) view.playing = { since: performance.now(), from: time() };
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
    const rows = stripRows();
    if (!rows.length) return;
    const order = strip.ranking(rows);
    jump(frameAt(order[view.rank % order.length]));
    view.rank++;
  }

  function jumpDoubtful() {
    const doubted = (frame) => visible(frame) && shown().some((layer) => layer.doubt?.(frame));
    jump(scene.nextDoubtful(data, view.frame, doubted) ?? view.frame);
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
  const step = (count) => jump(frameAt(time() + count, Math.sign(count)));
  const KEYS = {
    " ": () => play(), w: jumpWorst, d: jumpDoubtful, 0: () => change(AS_AT_FIRST),
    1: () => change({ yaw: 0, pitch: 0 }), 2: () => change({ yaw: -90, pitch: 0 }), 3: () => change({ yaw: 0, pitch: 90 }),
    "+": () => zoom(1.2), "=": () => zoom(1.2), "-": () => zoom(1 / 1.2),
    home: () => jump(frameAt(0)), end: () => jump(frameAt(recording().length - 1, -1)),
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
  /** A tick for a layer or an individual, which is taken out of a set or put into it. */
  function choice(colour, text, checked, changed) {
    const [row, box, patch, name] = ["label", "input", "i", "bdi"].map((tag) => document.createElement(tag));
    Object.assign(box, { type: "checkbox", checked });
    box.addEventListener("change", () => {
      changed(box.checked);
      tell();
      change();
    });
    patch.style.background = `var(--${colour})`;
    [name.textContent, row.title] = [scene.short([text])[0], text];
    row.append(box, patch, name);
    return row;
  }

  /** Ticks for several layers, and for several individuals; the one whose frames are shown stays. */
  function fillLayers() {
    const { tracks } = recording();
    const layers = data.layers.length < 2 ? [] : data.layers.map((layer) => (
      choice(look.colourOf(data, layer, 0), layer.name, view.shown.has(layer), (on) => view.shown[on ? "add" : "delete"](layer))));
    const individuals = tracks.length < 2 ? [] : tracks.map(({ label, sequence }, track) => (
      choice(look.colourOf(data, data.layers[0] ?? {}, track), label, !view.hidden.has(sequence), (on) => view.hidden[on ? "delete" : "add"](sequence))));
    $("layers").replaceChildren(...layers, ...individuals);
  }

  /** Hide what this page has no use for. */
  function hideTheRest() {
    const names = [...new Set(data.layers.flatMap((layer) => layer.measures.map((m) => m.name)))];
    const units = Object.fromEntries(data.layers.flatMap((layer) => layer.measures.map((m) => [m.name, m.unit])));
    $("measure").append(...names.map((name) => new Option(units[name] ? `${name} (${units[name]})` : name, name)));
    const results = data.layers.filter((layer) => layer.role === "result");
    const judged = results.some((layer) => layer.doubt);
    const has = {
      "time-strip": names.length, worst: names.length, "measure-label": names.length,
      doubtful: judged, states: judged && names.length,
      flat: data.flat, solid: data.layers.length, sides: data.sides,
      "mesh-choice": results.some((layer) => layer.faces), "upright-choice": results.some((layer) => layer.faces),
      "key-observed": data.seen(0), "key-hidden": results.length && data.seen(0), "key-residual": results.length && data.seen(0),
      "key-outlier": data.outliers(0).length, "key-bars": data.layers.some((layer) => layer.sd(0)),
    };
    for (const [id, there] of Object.entries(has)) $(id).hidden = !there;
    if (!data.sides_named) [$("left-name").textContent, $("right-name").textContent] = ["one side", "the other"];
    $("doubtful").disabled = !results.some((layer) => layer.doubts?.words.some(Boolean));
    $("rate").textContent = data.count > 1 ? `${Number(data.frame_rate.toPrecision(4))} frames/s${data.rate_known ? "" : " assumed"}` : "";
  }

  /** The list: frames of a sequence without its name, which stands above them. */
  function search() {
    const text = $("search").value;
    const rows = scene.find(data, text, data.sequenceOf(view.frame));
    const frames = rows.filter((row) => row.frame !== undefined);
    const counted = `${data.count} frames, ${data.sequences.length} ${data.sequences.length === 1 ? "sequence" : "sequences"}`;
    $("found").textContent = text.trim() ? `${frames.length} of ${data.count} found` : counted;
    const above = `${data.sequences[data.sequenceOf(view.frame)].name}/`;
    const own = frames.map(({ frame }) => data.items[frame]);
    const items = scene.short(own.map((item) => (!text.trim() && item.startsWith(above) ? item.slice(above.length) : item)));
    const names = scene.short(data.sequences.map(({ name }) => name));
    let next = 0;
    $("list").replaceChildren(...rows.map(({ sequence, frame }) => {
      if (frame !== undefined) return Object.assign(new Option(items[next++], `frame ${frame}`), { className: "frame", title: data.items[frame] });
      const { name, start, end } = data.sequences[sequence];
      return Object.assign(new Option(`${names[sequence] || "(no sequence)"} (${end - start})`, `sequence ${sequence}`), { className: "sequence", title: name });
    }));
    $("list").value = `frame ${view.frame}`;
    search.first = frames[0] ?? rows[0];
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
  on("slider", "input", () => jump(frameAt(Number($("slider").value))));
  on("speed", "change", restart);
  on("measure", "change", () => change({ rank: 0 }));
  on("strip", "click", (event) => {
    const box = $("strip").getBoundingClientRect();
    jump(frameAt(strip.timeAt(event.clientX - box.left, box.width, recording().length)));
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

  /** What the page shows, for scripts and tests. */
  window.shapefit = {
    data,
    view,
    get item() { return data.items[view.frame]; },
    layer: (name) => data.layers.find((layer) => layer.name === name),
    turn,
    go: jump,
  };

  restyle(DARK.matches);
  hideTheRest();
  enterSequence();
  if (!followLink()) go(0);
})();
