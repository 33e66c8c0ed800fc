/** The shapes in 3D on their ground, each moment around the middle of what it shows. */
const space = (() => {
    const FILL = 0.44;   // share of the panel from its middle to the farthest point,
                         // whichever way it turns
    const REACH = 1.6;   // of the grid, in radii of what stands on it
    const CAMERA = 0.3;  // length of the drawn camera, in radii of what it sees
    const NEAR =
        1.5;  // radii from the middle at which a camera is drawn that is farther away
    const LIGHT = [-0.31, 0.51, 0.81];  // from the viewer's upper left
    const SHADES = 32;

    /**
     * {upright, floor}: the rotation of space after which y is up, and the y of the
     * floor there, undefined if unknown.
     */
    function ground(data, view, bodies) {
        const pose =
            view.upright && bodies.length ? bodies[0].layer.pose(view.frame) : null;
        return pose && Number.isFinite(pose[0]) ?
            {upright: geometry.inverse(pose.slice(0, 9))} :
            data.groundOf(view.frame);
    }

    /**
     * Draw all bodies at the time of view.frame in 3D; returns the landmarks of that
     * frame in px, by the names of layers.
     */
    function draw(canvas, data, view) {
        const {context, width, height} = look.pen(canvas);
        const bodies =
            look.bodiesOf(data, view).map((body) => ({
                                              ...body,
                                              points: body.layer.points(body.frame),
                                              mesh: view.mesh ?
                                                  body.layer.mesh(body.frame) :
                                                  null,
                                          }));
        const {upright: base, floor} = ground(data, view, bodies);
        const solids =
            bodies.map(({points, mesh}) => geometry.turn(mesh ?? points, base));
        const every = solids.flatMap((solid) => Array.from(solid));
        const box = geometry.box(every, 3) ??
            {middle: [0, 0, 0], low: [0, -1, 0], extent: [1, 1]};
        const whole =
            view.upright ? [0, 0] : data.size(data.recordingOf(view.frame)).solid;
        const [across, tall] =
            box.extent.map((own, axis) => Math.max(own, whole[axis]));
        const radius = Math.hypot(across, tall) || 1;
        const [level, tilt] = [Math.cos, Math.sin].map(
            (of) => Math.abs(of((view.pitch * Math.PI) / 180)));
        const zoom = FILL * view.zoom *
            Math.min(
                width / (across || radius),
                height / (level * tall + tilt * across || radius));
        const turned = geometry.viewRotation(view.yaw, view.pitch);
        /** [x, y, depth from 0 to 1] in px of points in the upright frame. */
        const project = (points) => {
            const rotated = geometry.turn(points, turned, box.middle);
            return Array.from(
                {length: rotated.length / 3},
                (_, j) =>
                    [width / 2 + view.pan[0] + zoom * rotated[3 * j],
                     height / 2 + view.pan[1] - zoom * rotated[3 * j + 1],
                     Math.max(
                         0, Math.min(1, 0.5 - rotated[3 * j + 2] / (3.2 * radius))),
            ]);
        };
        const place = (points) => project(geometry.turn(points, base));
        const columns = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map(
            (axis) => geometry.turn(geometry.turn(axis, base), turned));
        const rows = [0, 1].map((row) => columns.map((column) => zoom * column[row]));
        if (view.pitch > -1) {
            const boxes = solids.map((solid) => geometry.box(solid, 3));
            if (floor !== undefined)
                drawGrid(
                    context, project, box.middle, floor, REACH * radius,
                    data.space_unit);
            else
                boxes.filter((_, i) => bodies[i].layer === bodies[0].layer)
                    .forEach(
                        ({middle, low, extent}) => (drawGrid(
                            context, project, middle, low[1], REACH * extent[0],
                            data.space_unit)));
            bodies.forEach(({mesh}, i) => {
                const height = floor ?? boxes[i].low[1];
                if (!mesh)
                    look.drawShadow(
                        context, data,
                        project(
                            solids[i].map(
                                (value, k) => (k % 3 === 1 ? height : value))));
            });
        }
        const nameCamera = drawCamera(
            context, data, bodies[0], {base, middle: box.middle, radius, project});
        const meshes = bodies.filter(({mesh}) => mesh);
        drawMeshes(
            context, meshes.map(({layer, mesh, colour}, i) => ({
                                    faces: layer.faces,
                                    places: place(mesh),
                                    colour: meshes.length === 1 ? 'mesh' : colour,
                                    alpha: i ? 0.45 : 1
                                })),
            3.2 * radius * zoom);
        const projected = {};
        for (const body of bodies) {
            const places = place(body.points);
            if (!body.mesh) look.drawBody(context, data, body, places, () => rows);
            if (body.frame === view.frame)
                projected[body.layer.name] ??= places.map(([x, y]) => [x, y]);
        }
        nameCamera?.();
        const [x, y] = Object.values(projected)[0]?.[view.joint] ?? [];
        if (Number.isFinite(x))
            look.write(context, data.landmarks[view.joint], x + 8, y - 9);
        look.drawScale(context, height, zoom, data.space_unit);
        return projected;
    }

    /**
     * Draw the ground around a place, with a grid: of metres where the unit is one,
     * else of round lengths.
     */
    function drawGrid(context, project, middle, height, reach, unit) {
        const tint = `rgb(${look.mixed('background', 'faint', 0.3)})`;
        const step = unit === 'm' && reach > 1 ?
            Math.max(1, look.niceStep(reach / 10)) :
            look.niceStep(reach / 4);
        const cells = Math.max(1, Math.floor(reach / step));
        const [x, z] = [middle[0], middle[2]].map((at) => step * Math.round(at / step));
        const half = step * cells;
        context.beginPath();
        for (const [right, down] of project([
                 [-1, -1], [1, -1], [1, 1], [-1, 1]
             ].flatMap(([u, v]) => [x + half * u, height, z + half * v])))
            context.lineTo(right, down);
        look.fill(context, look.text('ground'));
        for (let i = -cells; i <= cells; i++) {
            const at = step * i;
            for (const [x0, z0, x1, z1] of [
                     [at, -half, at, half], [-half, at, half, at]]) {
                const line = project([x + x0, height, z + z0, x + x1, height, z + z1]);
                look.stroke(
                    context, tint, 1,
                    () => line.forEach(([right, down]) => context.lineTo(right, down)));
            }
        }
    }

    /**
     * Draw the camera as a frustum, whose far side is the frame of its image; one that
     * is far away is drawn nearer. Returns the function that writes its name and its
     * distance, which are to lie over the bodies; null where no camera is drawn.
     */
    function drawCamera(context, data, body, {base, middle, radius, project}) {
        const camera = body?.layer.perspective && data.image ?
            body.layer.camera(body.frame) :
            null;
        if (!camera || !Number.isFinite(camera[0])) return null;
        const away = Math.hypot(...middle);
        const moved =
            middle.map((value) => value * Math.max(0, 1 - (NEAR * radius) / away));
        const deep = Math.sign(body.points.find(
                         (value, i) => i % 3 === 2 && Number.isFinite(value))) *
            CAMERA * radius;
        const [w, h] = data.image;
        const larger =
            Math.max(1, camera[0] / w);  // so that the frame of a long lens can be seen
        const corners = [[0, 0], [w, 0], [w, h], [0, h]].flatMap(
            ([u, v]) =>
                [(larger * Math.abs(deep) * (u - camera[2])) / camera[0],
                 (larger * Math.abs(deep) * (v - camera[3])) / camera[1],
                 deep,
        ]);
        const [eye, ...frame] = project(geometry.turn([0, 0, 0, ...corners], base)
                                            .map((value, i) => value + moved[i % 3]));
        look.stroke(
            context, look.text('accent'), 1.2, () => frame.forEach((corner, i) => {
                context.moveTo(eye[0], eye[1]);
                context.lineTo(corner[0], corner[1]);
                context.lineTo(frame[(i + 1) % 4][0], frame[(i + 1) % 4][1]);
            }));
        const far = away > NEAR * radius && data.space_unit === 'm' ?
            `, ${data.about}${away.toPrecision(2)} m away` :
            '';
        return () => writeBelow(context, `camera${far}`, frame);
    }

    /** Write a name below corners, whole wherever these are. */
    function writeBelow(context, name, frame) {
        const {clientWidth: width, clientHeight: height} = context.canvas;
        const right = Math.max(...frame.map(([x]) => x));
        const below = 14 + Math.max(...frame.map(([, y]) => y));
        const wide = context.measureText(name).width;
        look.write(
            context, name, Math.max(8 + wide, Math.min(width - 8, right)),
            Math.max(12, Math.min(height - 12, below)), look.text('faint'), 'right');
    }

    /**
     * Draw the triangles of all meshes that face the viewer, the far ones first, each
     * in one shade; `deep` px are depths from 0 to 1.
     */
    function drawMeshes(context, meshes, deep) {
        const triangles = [];
        for (const {faces, places, colour, alpha} of meshes) {
            const shades = Array.from(
                {length: SHADES + 1},
                (_, i) => (`rgba(${
                    look.mixed(colour, 'background', 0)
                        .map(
                            (value) => Math.min(
                                255,
                                Math.round((0.5 + (0.8 * i) / SHADES) * value)))}, ${
                    alpha})`));
            for (let f = 0; f < faces.length; f += 3) {
                const [a, b, c] =
                    [places[faces[f]], places[faces[f + 1]], places[faces[f + 2]]];
                const [ux, uy, uz] = [b[0] - a[0], a[1] - b[1], deep * (a[2] - b[2])];
                const [vx, vy, vz] = [c[0] - a[0], a[1] - c[1], deep * (a[2] - c[2])];
                const [x, y, z] =
                    [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
                if (z <= 0) continue;
                const facing = Math.max(0, LIGHT[0] * x + LIGHT[1] * y + LIGHT[2] * z) /
                    Math.sqrt(x * x + y * y + z * z);
                triangles.push({
                    a,
                    b,
                    c,
                    far: a[2] + b[2] + c[2],
                    tint: shades[Math.round(SHADES * Math.min(1, facing))],
                    alpha
                });
            }
        }
        context.lineWidth = 1.3;
        for (const {a, b, c, tint, alpha} of triangles.sort(
                 (one, other) => other.far - one.far)) {
            context.fillStyle = context.strokeStyle = tint;
            context.beginPath();
            context.moveTo(a[0], a[1]);
            context.lineTo(b[0], b[1]);
            context.lineTo(c[0], c[1]);
            context.fill();
            if (alpha === 1) context.stroke();  // no gaps between neighbours
        }
    }

    return {draw};
})();
