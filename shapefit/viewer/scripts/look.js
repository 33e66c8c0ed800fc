/** What both panels share: colours, canvases, and how one body is drawn on them. */
const look = (() => {
    const COLOURS = 6;  // of bodies
    const CROWD = 40;   // more landmarks than these have smaller marks
    const PLAIN = 40;   // px of an ellipse from which on it is fainter
    const FONT = '12px system-ui, sans-serif';
    const colours = new Map();

    /** The text of a colour of the style, by its name; the style is light or dark. */
    function text(name) {
        if (!colours.has(name))
            colours.set(
                name,
                getComputedStyle(document.documentElement)
                    .getPropertyValue(`--${name}`)
                    .trim());
        return colours.get(name);
    }

    const restyle = () => colours.clear();  // light or dark: the colours are read anew

    /** A colour of the style as [red, green, blue], with a share of another. */
    function mixed(name, other, share) {
        const [own, added] = [text(name), text(other)].map(
            (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16)));
        return own.map((value, i) => Math.round(value + share * (added[i] - value)));
    }

    /**
     * Empty a canvas and give it the pixels that it covers; returns {context, width,
     * height} in CSS pixels.
     */
    function pen(canvas) {
        const [width, height, ratio] = [
            canvas.clientWidth, canvas.clientHeight,
            Math.min(2, window.devicePixelRatio || 1)
        ];
        [canvas.width, canvas.height] =
            [Math.round(width * ratio), Math.round(height * ratio)];
        const context = canvas.getContext('2d');
        context.scale(ratio, ratio);
        context.font = FONT;
        return {context, width, height};
    }

    /**
     * The name of a body's colour: of its individual where there is one result, else
     * of its layer.
     */
    function colourOf(data, layer, track) {
        if (layer.role === 'truth') return 'truth';
        const one = data.layers.filter(({role}) => role !== 'truth').length === 1;
        return `body-${(one ? track : data.layers.indexOf(layer)) % COLOURS}`;
    }

    /**
     * The bodies of the moment that are switched on: {layer, frame, colour, tints,
     * label}.
     *
     * tints are the colours in the middle, on the left and on the right: of all
     * individuals alike, in the first layer that is shown.
     */
    function bodiesOf(data, view) {
        const {tracks} = data.recordingOf(view.frame);
        const time = data.timeOf(view.frame);
        const layers = data.layers.filter((layer) => view.shown.has(layer));
        return layers.flatMap(
            (layer, i) => tracks.flatMap(({frames, sequence, label}, track) => {
                const frame = frames[time];
                if (frame < 0 || (view.hidden.has(sequence) && frame !== view.frame) ||
                    !layer.has(frame))
                    return [];
                const colour = colourOf(data, layer, track);
                const tints = data.sides && i === 0 ? [colour, 'left', 'right'] :
                                                      [colour, colour, colour];
                return [{
                    layer,
                    frame,
                    colour,
                    tints,
                    label: tracks.length > 1 && i === 0 ? label : ''
                }];
            }));
    }

    /**
     * The side of a line between two landmarks, 1 left and 2 right: theirs, but 0
     * where they have different ones.
     */
    function sideOf(data, a, b = a) {
        const [first, second] = [data.sides?.[a] ?? 0, data.sides?.[b] ?? 0];
        return first && second && first !== second ? 0 : first || second;
    }

    /**
     * Draw a body: error bars, then bones as tubes and landmarks as spheres, the far
     * ones first and paler.
     *
     * places are [x, y, depth from 0 (near) to 1 (far)] in px; rowsAt(j) the projection
     * at landmark j.
     */
    function drawBody(
        context, data, {layer, frame, tints, colour, label}, places, rowsAt) {
        const [sd, observed, outliers] =
            [layer.sd(frame), data.observed(frame), data.outliers(frame)];
        const [known, radius] = [places.map(([x]) => Number.isFinite(x)), markOf(data)];
        places.forEach(([x, y], j) => {
            if (!known[j] || !Number.isFinite(sd?.[3 * j])) return;
            const {long, short, angle} =
                geometry.ellipse(rowsAt(j), sd.subarray(3 * j, 3 * j + 3));
            context.beginPath();
            context.ellipse(x, y, long, short, angle, 0, 2 * Math.PI);
            fill(
                context, text(colour),
                0.15 * Math.min(1, PLAIN / long));  // wide bars hide nothing
        });
        const parts =
            data.edges.filter(([a, b]) => known[a] && known[b])
                .map(([a, b]) => ({a, b, far: (places[a][2] + places[b][2]) / 2}));
        places.forEach(
            (place, j) => known[j] && parts.push({a: j, far: place[2] - 0.01}));
        const shades = [0, 1, 2].map((side) => [0, 1, 2, 3].map((pale) => {
            const tint = mixed(tints[side], 'background', 0.16 * pale);
            return [tint, tint.map((value) => Math.min(255, value + 70))].map(
                (each) => `rgb(${each})`);
        }));
        for (const {a, b, far} of parts.sort((one, other) => other.far - one.far)) {
            const [tint, light] =
                shades[sideOf(data, a, b)][Math.min(3, Math.floor(4 * far * far))];
            const [x, y] = places[a];
            context.beginPath();
            if (b !== undefined) {
                const lift = radius / 3;
                stroke(
                    context, tint, 2 * radius - 1,
                    () => [places[a], places[b]].forEach(
                        (end) => context.lineTo(end[0], end[1])));
                stroke(
                    context, light, radius / 2,
                    () => [places[a], places[b]].forEach(
                        (end) => context.lineTo(end[0] - lift, end[1] - lift)));
            } else if (layer.role === 'result' && outliers[a]) cross(context, x, y);
            else {
                const hidden = layer.role === 'result' && observed &&
                    !Number.isFinite(observed[2 * a]);
                context.arc(x, y, radius + 1, 0, 2 * Math.PI);
                fill(context, hidden ? text('background') : tint);
                if (hidden) stroke(context, tint, 1.5);
                else {
                    context.beginPath();
                    context.arc(
                        x - radius / 3, y - radius / 3, radius / 2.5, 0, 2 * Math.PI);
                    fill(context, light);
                }
            }
        }
        const top = places.reduce(
            (best, place, j) => (known[j] && !(best?.[1] <= place[1]) ? place : best),
            null);
        if (label && top)
            write(context, label, top[0], top[1] - 14, text(colour), 'center');
    }

    /**
     * Draw a soft shadow of the bones, or of the landmarks where there are none, at
     * places [x, y] on the ground.
     */
    function drawShadow(context, data, places) {
        const pairs =
            data.edges.length ? data.edges : data.landmarks.map((_, j) => [j, j]);
        const lines = pairs.map(([a, b]) => [places[a], places[b]])
                          .filter(([a, b]) => Number.isFinite(a[0] + b[0]));
        for (const width of [14, 9, 5]) {
            stroke(context, text('shadow'), width, () => lines.forEach(([a, b]) => {
                context.moveTo(a[0], a[1]);
                context.lineTo(b[0], b[1]);
            }));
        }
    }

    const markOf = (data) =>
        (data.landmarks.length > CROWD ? 2 : 3.5);  // radius of a landmark, px

    /** Fill the path of a context with a colour. */
    function fill(context, tint, alpha = 1) {
        context.globalAlpha = alpha;
        context.fillStyle = tint;
        context.fill();
        context.globalAlpha = 1;
    }

    /** Stroke a new path, or without one the path that is there. */
    function stroke(context, tint, width, path = null) {
        if (path) context.beginPath();
        path?.();
        [context.strokeStyle, context.lineWidth, context.lineCap] =
            [tint, width, 'round'];
        context.stroke();
    }

    /** Draw the cross of a landmark that was judged to be wrong. */
    function cross(context, x, y) {
        stroke(context, text('untrusted'), 3, () => [-5, 5].forEach((side) => {
            context.moveTo(x - 5, y - side);
            context.lineTo(x + 5, y + side);
        }));
    }

    /** Write a text that stands out from what is below it. */
    function write(context, words, x, y, tint = text('ink'), align = 'left') {
        [context.textAlign, context.textBaseline, context.lineJoin] =
            [align, 'middle', 'round'];
        context.strokeStyle = text('background');
        context.lineWidth = 3;
        context.strokeText(words, x, y);
        context.fillStyle = tint;
        context.fillText(words, x, y);
    }

    /** The smallest of 1, 2 and 5 times powers of ten that is at least `least`. */
    function niceStep(least) {
        const power = 10 ** Math.floor(Math.log10(least));
        return power * ([1, 2, 5].find((factor) => factor * power >= least) ?? 10);
    }

    /**
     * Draw a bar in the corner, and how long it is in a unit: zoom px are one. Metres
     * below one are centimetres.
     */
    function drawScale(context, height, zoom, unit) {
        const step = niceStep(70 / zoom);
        const small = unit === 'm' && step < 1;
        context.fillStyle = text('faint');
        context.fillRect(12, height - 12, zoom * step, 2);
        write(
            context,
            `${Number((small ? 100 * step : step).toPrecision(1))} ${
                small ? 'cm' : unit}`,
            12, height - 22, text('faint'));
    }

    return {
        text,
        restyle,
        mixed,
        pen,
        colourOf,
        bodiesOf,
        drawBody,
        drawShadow,
        markOf,
        fill,
        stroke,
        cross,
        write,
        niceStep,
        drawScale
    };
})();
