/**
 * The panel of the image: landmarks as seen, over the image where there is one, and
 * what was fitted.
 */
const plane = (() => {
    // Shares of the panel from its middle to the farthest landmark, and to the end of
    // the image.
    const FILL = 0.37;
    const FILL_OF_IMAGE = 0.46;
    const STAYS = 1.6;  // sizes of the landmarks within which they stay in one place
    const SAME_SIZE = 0.1;  // by which a film may differ from the image: a camera's
                            // principal point is not quite in the middle

    /** Draw the landmarks at the time of view.frame, and what was fitted to them. */
    function draw(canvas, data, view) {
        const {context, width, height} = look.pen(canvas);
        const bodies = look.bodiesOf(data, view)
                           .filter(({layer}) => layer.role === 'result')
                           .map((body) => {
                               const mesh =
                                   view.mesh ? body.layer.mesh(body.frame) : null;
                               return {
                                   ...body,
                                   fitted: body.layer.fitted(body.frame),
                                   mesh: mesh && body.layer.inImage(body.frame, mesh)
                               };
                           });
        const frames = [...new Set([view.frame, ...bodies.map(({frame}) => frame)])];
        const points = [
            ...frames.map(data.observed),
            ...bodies.flatMap(({fitted, mesh}) => [fitted, mesh])
        ].filter(Boolean);
        const {zoom, middle} = fit(data, view, points, width, height);
        const up = data.y_down ? 1 : -1;
        const at = (values, j) =>
            [width / 2 + zoom * (values[2 * j] - middle[0]),
             height / 2 + up * zoom * (values[2 * j + 1] - middle[1])];
        drawImage(context, data, view, at, zoom);
        for (const {layer, mesh, colour} of bodies)
            if (mesh) fillMesh(context, layer.faces, mesh, at, look.text(colour));
        for (const body of bodies) {
            const solid = body.layer.points(body.frame);
            const rowsAt = (j) => {
                const [x, y] = body.layer.magnification(body.frame, solid[3 * j + 2]);
                return [[zoom * x, 0, 0], [0, up * zoom * y, 0]];
            };
            look.drawBody(
                context, data, body,
                data.landmarks.map((_, j) => [...at(body.fitted, j), 0]), rowsAt);
        }
        for (const frame of frames)
            drawObserved(
                context, data, frame, bodies.find((body) => body.frame === frame), at);
        look.drawScale(context, height, zoom, data.unit);
    }

    /**
     * {zoom (px a unit), middle (the point in the middle of the panel)}: a recording
     * in one scale.
     *
     * Of a recording whose landmarks stay in one place the panel stands still, else it
     * follows them; or it shows the whole image.
     */
    function fit(data, view, points, width, height) {
        const {middle, extent, fill} = boxOf(data, view, points);
        const [wide, tall] = extent;
        const zoom = fill * view.planeZoom *
            Math.min(width / (wide || tall || 1), height / (tall || wide || 1));
        const [right, down] = view.planePan;
        const up = data.y_down ? 1 : -1;
        return {
            zoom,
            middle: [middle[0] - right / zoom, middle[1] - (up * down) / zoom]
        };
    }

    /** {middle, extent, fill}: what the panel shows, and how far it fills it. */
    function boxOf(data, view, points) {
        const image = imageOf(data, view);
        if (view.whole && image) {
            const half = image.map((side) => side / 2);
            return {middle: half, extent: half, fill: FILL_OF_IMAGE};
        }
        const {flat, path} = data.size(data.recordingOf(view.frame));
        if (path?.extent.every((extent, axis) => extent <= STAYS * flat[axis]))
            return {...path, fill: FILL};
        const own = geometry.box(points.flatMap((each) => Array.from(each)), 2) ??
            {middle: [0, 0], extent: [1, 1]};
        const extent = own.extent.map((side, axis) => Math.max(side, flat[axis]));
        return {middle: own.middle, extent, fill: FILL};
    }

    /** Width and height of the picture, film or image of the frame, null if unknown. */
    function imageOf(data, view) {
        const picture = data.pictures[view.frame];
        if (picture) return picture.size;
        if (view.film?.ready) return sizeOf(view.film.still, data.image);
        return data.image ?? null;
    }

    /**
     * The size of a film in the unit of the landmarks: it may be a smaller copy of the
     * image.
     */
    function sizeOf({width, height}, image) {
        const factor = (image?.[0] ?? width) / width;
        const isCopy = Math.abs(factor - 1) > SAME_SIZE;
        return [width, height].map((side) => (isCopy ? factor * side : side));
    }

    /** Draw the picture of the frame, if there is one, and the border of the image. */
    function drawImage(context, data, view, at, zoom) {
        const size = imageOf(data, view);
        if (!size) return;
        const picture = view.film?.ready ? view.film.still : view.pictures[view.frame];
        const [w, h] = size;
        const [left, top] = at([0, data.y_down ? 0 : h], 0);
        if (picture && picture.complete !== false)
            context.drawImage(picture, left, top, w * zoom, h * zoom);
        [context.strokeStyle, context.lineWidth] = [look.text('line'), 1.5];
        context.strokeRect(left, top, w * zoom, h * zoom);
    }

    /**
     * Draw observed landmarks: discs, crosses where they were judged to be wrong, lines
     * to where the model has them.
     */
    function drawObserved(context, data, frame, body, at) {
        const [observed, outliers] = [data.observed(frame), data.outliers(frame)];
        if (!observed) return;
        const [ink, faint, background, residual] =
            ['ink', 'faint', 'background', 'residual'].map(look.text);
        for (const [a, b] of body ? [] : data.edges) {
            if (Number.isFinite(observed[2 * a] + observed[2 * b]))
                look.stroke(
                    context, faint, 2,
                    () => [a, b].forEach((j) => context.lineTo(...at(observed, j))));
        }
        data.landmarks.forEach((_, j) => {
            if (!Number.isFinite(observed[2 * j])) return;
            const [x, y] = at(observed, j);
            if (body && Number.isFinite(body.fitted[2 * j]))
                look.stroke(
                    context, residual, 1.5,
                    () => [observed, body.fitted].forEach(
                        (p) => context.lineTo(...at(p, j))));
            if (outliers[j]) return look.cross(context, x, y);
            context.beginPath();
            context.arc(x, y, look.markOf(data), 0, 2 * Math.PI);
            look.fill(context, ink);
            look.stroke(context, background, 1);
        });
    }

    /** Fill the triangles that face the viewer, as one shape. */
    function fillMesh(context, faces, points, at, tint) {
        context.beginPath();
        for (let f = 0; f < faces.length; f += 3) {
            const [a, b, c] = [
                at(points, faces[f]), at(points, faces[f + 1]), at(points, faces[f + 2])
            ];
            if ((b[0] - a[0]) * (c[1] - a[1]) >= (b[1] - a[1]) * (c[0] - a[0]))
                continue;
            context.moveTo(...a);
            context.lineTo(...b);
            context.lineTo(...c);
        }
        look.fill(context, tint, 0.3);
    }

    return {draw};
})();
