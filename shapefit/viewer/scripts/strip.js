/** The strip under the slider: one bar per frame, high where the frame is worth a look. */
const strip = (() => {
  /**
   * How bad each value is, from 0 to 1, on the scale of these values; NaN is Infinity.
   *
   * `scale` is "linear", "log", or "share" for values that are from 0 to 1 already; `bad` is "high"
   * or "low". Values are measured beside `limit`, where there is one; equal values are as good.
   */
  function badness(values, { scale, bad, limit }, wanted = values) {
    const on = (value) => (scale === "log" ? Math.log10(Math.max(value, 1e-16)) : value);
    const known = [...values, limit ?? NaN].filter(Number.isFinite).map(on);
    let [low, high] = known.reduce(([l, h], v) => [Math.min(l, v), Math.max(h, v)], [Infinity, -Infinity]);
    if (scale === "linear" && bad === "high") low = Math.min(low, 0);
    if (scale === "share") [low, high] = [0, 1];
    return Array.from(wanted, (value) => {
      if (!Number.isFinite(value)) return Infinity;
      if (high <= low) return 0;
      const share = (on(value) - low) / (high - low);
      return bad === "low" ? 1 - share : share;
    });
  }

  /** The worst of the frames that share each of `columns` columns. */
  function columnsOf(levels, columns) {
    const worst = new Array(columns).fill(-1);
    levels.forEach((level, i) => {
      const first = Math.floor((i * columns) / levels.length);
      const last = Math.max(first + 1, Math.floor(((i + 1) * columns) / levels.length));
      for (let c = first; c < last; c++) worst[c] = Math.max(worst[c], level);
    });
    return worst;
  }

  /** Frames by their levels, the worst first, ties in order. */
  function ranking(levels) {
    return levels.map((_, i) => i).sort((a, b) => (levels[a] === levels[b] ? a - b : levels[b] - levels[a]));
  }

  /** Draw rows [{levels, tint, limit}], one above the other, with a line where the limit is. */
  function draw(context, width, height, rows, outlier) {
    context.clearRect(0, 0, width, height);
    const tall = height / rows.length;
    rows.forEach(({ levels, tint, limit }, r) => {
      const base = (r + 1) * tall - 1;
      columnsOf(levels, Math.max(1, Math.floor(width))).forEach((level, x) => {
        if (level < 0) return;
        const bar = 2 + (tall - 4) * Math.min(1, level);
        context.fillStyle = level === Infinity ? outlier : tint;
        context.fillRect(x, base - bar, 1, bar);
      });
      context.fillStyle = outlier;
      if (Number.isFinite(limit)) context.fillRect(0, base - 2 - (tall - 4) * limit, width, 1);
    });
  }

  /** The frame of `count` that stands at `x` of `width`. */
  function frameAt(x, width, count) {
    return Math.max(0, Math.min(count - 1, Math.floor((x / width) * count)));
  }

  return { badness, columnsOf, ranking, draw, frameAt };
})();
