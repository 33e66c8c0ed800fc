/** The strip under the slider: a row for each individual, with a bar for each frame, and axes. */
const strip = (() => {
  const LEFT = 92, BELOW = 16; // px of the names and values, and of the times
  const STATES = { trusted: 0, doubtful: 1, none: 2 };

  /** The bars that share each of `columns` columns as one: the worst state, and the worst value. */
  function columnsOf(bars, columns, bad) {
    const worst = new Array(columns).fill(null);
    bars.forEach((bar, i) => {
      const first = Math.floor((i * columns) / bars.length);
      const last = Math.max(first + 1, Math.floor(((i + 1) * columns) / bars.length));
      for (let c = first; bar && c < last; c++) {
        const before = worst[c] ?? bar;
        const values = [before.value, bar.value].filter(Number.isFinite);
        const state = STATES[bar.state] > STATES[before.state] ? bar.state : before.state;
        worst[c] = { value: values.length ? (bad === "low" ? Math.min : Math.max)(...values) : NaN, state };
      }
    });
    return worst;
  }

  /** Places in time by their worst row, the worst first, ties in order; those without a value before all. */
  function ranking(rows) {
    const level = (bar, bad) => (!bar ? -Infinity : !Number.isFinite(bar.value) ? Infinity : bad === "low" ? -bar.value : bar.value);
    const levels = rows[0].bars.map((_, time) => rows.reduce((most, { bars, bad }) => Math.max(most, level(bars[time], bad)), -Infinity));
    return levels.map((_, i) => i).sort((a, b) => (levels[a] === levels[b] ? a - b : levels[b] - levels[a]));
  }

  /** The value at the top of all rows: the largest that is trusted, where some are, and not below the limit. */
  function topOf(rows, limit) {
    const known = rows.flatMap(({ bars }) => bars).filter((bar) => Number.isFinite(bar?.value));
    const trusted = known.filter(({ state }) => state === "trusted");
    return (trusted.length ? trusted : known).reduce((top, { value }) => Math.max(top, value), limit ?? 0) || 1;
  }

  /**
   * Draw rows [{name, tint, bars: [{value, state}, or null where nobody is]}] one above the other.
   *
   * A bar that is not trusted has the colour of doubt, one without a shape is a pale full bar; a
   * line marks the limit. Below stand frames or, where `rate` is known, seconds.
   */
  function draw({ context, width, height }, rows, { limit, bad, rate }) {
    const [wide, tall, top] = [width - LEFT, (height - BELOW) / rows.length, topOf(rows, limit)];
    const [doubt, faint, line] = ["doubt", "faint", "line"].map(look.text);
    const write = (words, x, y, align, tint = faint) => {
      [context.textAlign, context.textBaseline, context.fillStyle] = [align, "middle", tint];
      context.fillText(words, x, y, LEFT - 30);
    };
    rows.forEach(({ name, tint, bars }, r) => {
      const base = (r + 1) * tall;
      const high = (value) => (tall - 4) * Math.min(1, value / top);
      columnsOf(bars, Math.max(1, Math.floor(wide)), bad).forEach((bar, x) => {
        if (!bar) return;
        const lost = bar.state === "none";
        context.globalAlpha = lost ? 0.25 : 1;
        context.fillStyle = bar.state === "trusted" ? tint : doubt;
        const long = lost ? tall - 4 : Math.max(2, high(bar.value) || 0);
        context.fillRect(LEFT + x, base - long, 1, long);
      });
      context.globalAlpha = 1;
      context.fillStyle = line;
      context.fillRect(LEFT, base, wide, 1);
      context.fillStyle = doubt;
      if (Number.isFinite(limit)) context.fillRect(LEFT, base - high(limit), wide, 1);
      if (rows.length > 1) write(name, 4, base - tall / 2, "left", tint);
      write(String(Number(top.toPrecision(2))), LEFT - 6, base - tall + 9, "right");
      if (tall > 27) write("0", LEFT - 6, base - 5, "right");
    });
    const length = rows[0].bars.length;
    const step = Math.max(look.niceStep((80 / wide) * length / (rate || 1)), rate ? 0 : 1);
    for (let at = 0; at <= length / (rate || 1); at += step) { // seconds from 0, or frames from 1
      const x = LEFT + (wide * (Math.max(0, rate ? at * rate : at - 1) + 0.5)) / length;
      if (x < width - 20) write(rate ? `${Number(at.toPrecision(6))} s` : String(at || 1), x, height - 7, "center");
    }
  }

  /** The place in time, of `length`, that stands at `x` of `width`. */
  function timeAt(x, width, length) {
    return Math.max(0, Math.min(length - 1, Math.floor(((x - LEFT) / (width - LEFT)) * length)));
  }

  return { columnsOf, ranking, topOf, draw, timeAt, LEFT };
})();
