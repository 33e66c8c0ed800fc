/**
 * The chart below the panels: one quantity over time, a line and its band for each
 * body. It is the slider, too.
 */
const chart = (() => {
    const LEFT = 56, RIGHT = 8, TOP = 6, BELOW = 18;  // px around the lines
    const MARK = 4;                                   // px of a row of doubtful frames

    /**
     * [lowest, highest] of 98% of the known values of rows, bands included; [0, 1]
     * where nothing is known.
     */
    function rangeOf(rows) {
        const ends = [-1, 1].map(
            (side) => rows.flatMap(
                              ({values, sd}) => Array.from(
                                  values, (value, i) => value + side * (sd?.[i] || 0)))
                          .filter(Number.isFinite)
                          .sort((a, b) => a - b));
        const low = ends[0][Math.floor(0.01 * ends[0].length)] ?? 0;
        const high = ends[1][Math.ceil(0.99 * ends[1].length) - 1] ?? 1;
        return high > low ? [low, high] : [low - 0.5, low + 0.5];
    }

    /** Call run(first, end) for each stretch of known numbers. */
    function stretches(values, run) {
        for (let i = 0; i < values.length; i++) {
            if (!Number.isFinite(values[i])) continue;
            const first = i;
            while (i < values.length && Number.isFinite(values[i])) i++;
            run(first, i);
        }
    }

    /**
     * Draw rows [{tint, values, sd or null, states}] over the places in time; states
     * are "trusted", "doubtful", "none", or "" where nobody is. Below stand seconds
     * where `rate` is known, else frames; images that are no video are dots.
     */
    function draw({context, width, height}, rows, {unit, rate, dots}) {
        const length = rows[0].values.length;
        const base = height - BELOW - MARK * rows.length;
        const [low, high] = rangeOf(rows);
        const [faint, line, untrusted] = ['faint', 'line', 'untrusted'].map(look.text);
        const x = (i) => LEFT + ((width - LEFT - RIGHT) * (i + 0.5)) / length;
        const y = (value) => base -
            ((base - TOP) * (Math.max(low, Math.min(high, value)) - low)) /
                (high - low);
        const write = (words, at, down, align) => {
            [context.textAlign, context.textBaseline, context.fillStyle] =
                [align, 'middle', faint];
            context.fillText(words, at, down);
        };
        const step = look.niceStep((high - low) / 3);
        for (let value = Math.ceil(low / step) * step; value <= high; value += step) {
            context.fillStyle = line;
            context.fillRect(LEFT, Math.round(y(value)), width - LEFT - RIGHT, 1);
            write(
                `${Number(value.toPrecision(3))}${unit === '°' ? '°' : ''}`, LEFT - 6,
                y(value), 'right');
        }
        if (unit && unit !== '°') write(unit, LEFT - 6, base + 8, 'right');
        rows.forEach(({tint, values, sd, states}, row) => {
            stretches(values, (first, end) => {
                const each = Array.from({length: end - first}, (_, i) => first + i);
                if (sd) {
                    context.beginPath();
                    each.forEach(
                        (i) => context.lineTo(x(i), y(values[i] + (sd[i] || 0))));
                    each.reverse().forEach(
                        (i) => context.lineTo(x(i), y(values[i] - (sd[i] || 0))));
                    look.fill(context, tint, 0.18);
                    each.reverse();
                }
                if (dots || end - first === 1) {
                    context.fillStyle = tint;
                    return each.forEach(
                        (i) => context.fillRect(x(i) - 1, y(values[i]) - 1, 3, 3));
                }
                look.stroke(
                    context, tint, 1.8,
                    () => each.forEach((i) => context.lineTo(x(i), y(values[i]))));
            });
            const wide = Math.max(1, (width - LEFT - RIGHT) / length);
            states.forEach((state, i) => {
                if (state !== 'doubtful' && state !== 'none') return;
                context.fillStyle = state === 'doubtful' ? untrusted : line;
                context.fillRect(
                    x(i) - wide / 2, base + 2 + MARK * row, wide, MARK - 1);
            });
        });
        const every = Math.max(
            look.niceStep(((80 / (width - LEFT)) * length) / (rate || 1)),
            rate ? 0 : 1);
        for (let at = 0; at <= length / (rate || 1);
             at += every) {  // seconds from 0, or frames from 1
            const place = x(Math.max(0, rate ? at * rate : at - 1));
            if (place < width - 20)
                write(
                    rate ? `${Number(at.toPrecision(6))} s` : String(at || 1), place,
                    height - 8, 'center');
        }
    }

    /** The time, from 0 to length - 1, at x px of a chart that is `width` px wide. */
    function timeAt(x, width, length) {
        return Math.max(
            0,
            Math.min(
                length - 1,
                Math.floor(((x - LEFT) / (width - LEFT - RIGHT)) * length)));
    }

    return {rangeOf, draw, timeAt, LEFT, RIGHT};
})();
