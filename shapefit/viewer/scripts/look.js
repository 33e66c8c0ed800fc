/** What both panels share: colours, sizes of canvases, and which frames are drawn together. */
const look = (() => {
  const INDIVIDUALS = [0, 2, 3, 4, 5, 1]; // colours of those who are seen at once
  const CROWD = 40; // more landmarks than these have smaller marks

  /** A colour of the style, by name, as [red, green, blue, alpha]. */
  function rgba(name, alpha = 1) {
    const hex = text(name).slice(1);
    return [0, 2, 4].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255).concat(alpha);
  }

  /** A colour of the style, by name, as it stands there; the style is light or dark. */
  function text(name) {
    return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  }

  function css(colour) {
    return `rgb(${colour.slice(0, 3).map((value) => Math.round(255 * value)).join(" ")})`;
  }

  function mixed(one, other, share) {
    return one.map((value, i) => value + share * (other[i] - value));
  }

  /** Give a canvas the pixels that it covers; returns [width, height] in CSS pixels, and the ratio. */
  function fitCanvas(canvas) {
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    return [width, height, ratio];
  }

  /** The frames to draw at once: that of the view, and those of its moment that are not switched off. */
  function framesOf(data, view) {
    const others = data.together(view.frame).filter((frame) => frame !== view.frame && !view.hidden.has(data.sequenceOf(frame)));
    return [view.frame, ...others].sort((a, b) => a - b);
  }

  /** The name of the colour of a layer or, where there is one, of the individual of a frame. */
  function colourOf(data, layer, frame) {
    const group = data.group(data.sequenceOf(frame));
    const one = data.layers.filter(({ role }) => role !== "truth").length === 1;
    if (group.length < 2 || !one || layer.role === "truth") return layer.colour;
    return `layer-${INDIVIDUALS[group.indexOf(data.sequenceOf(frame)) % INDIVIDUALS.length]}`;
  }

  /** Colours of what is in the middle, on the left and on the right; those of one body alone differ most. */
  function sideTints(data, name, alone) {
    const own = rgba(name);
    if (!data.sides) return [own, own, own];
    if (alone) return [rgba("faint"), own, rgba("right")];
    return [mixed(own, rgba("ink"), 0.3), own, mixed(own, rgba("ink"), 0.6)];
  }

  /** The side of a line between two landmarks: theirs, unless they have different ones. */
  function sideOf(data, a, b = a) {
    const [first, second] = [data.sides?.[a] ?? 0, data.sides?.[b] ?? 0];
    return first && second && first !== second ? 0 : first || second;
  }

  /** Radius of the mark of a landmark, px. */
  function markOf(data) {
    return data.landmarks.length > CROWD ? 2.5 : 3.5;
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

  return { rgba, text, css, mixed, fitCanvas, framesOf, colourOf, sideTints, sideOf, markOf, apart };
})();
