/**
 * The mathematics of the page: rotations, cameras, blended meshes, boxes, ellipses.
 *
 * Points are flat arrays x0 y0 z0 x1 ...; rotations are 9 numbers, row by row. The
 * frame of the viewer is x right, y up, z towards the viewer. Angles are in degrees.
 */
const geometry = (() => {
    const DEGREE = Math.PI / 180;

    /**
     * The rotation Rx(pitch) Ry(yaw): walk around the object by yaw, then rise above it
     * by pitch.
     */
    function viewRotation(yaw, pitch) {
        const [c, s] = [Math.cos(yaw * DEGREE), Math.sin(yaw * DEGREE)];
        const [d, t] = [Math.cos(pitch * DEGREE), Math.sin(pitch * DEGREE)];
        return [c, 0, s, t * s, d, -t * c, -d * s, t, d * c];
    }

    /** The transpose, which is the inverse, of a rotation. */
    function inverse(R) {
        return [R[0], R[3], R[6], R[1], R[4], R[7], R[2], R[5], R[8]];
    }

    /** R (x - centre) for every point. */
    function turn(points, R, centre = [0, 0, 0]) {
        const turned = new Float64Array(points.length);
        for (let i = 0; i < points.length; i += 3) {
            const [x, y, z] = [
                points[i] - centre[0], points[i + 1] - centre[1],
                points[i + 2] - centre[2]
            ];
            for (let row = 0; row < 3; row++)
                turned[i + row] =
                    R[3 * row] * x + R[3 * row + 1] * y + R[3 * row + 2] * z;
        }
        return turned;
    }

    /**
     * s R sum_i w_i V_i + t: a mesh mixed of the vertices V_i of atoms, then placed by
     * a pose.
     */
    function blend(vertices, weights, pose) {
        const [R, scale, t] = [pose.slice(0, 9), pose[9], pose.slice(10, 13)];
        const mixed = new Float64Array(vertices[weights[0][0]].length);
        for (const [atom, weight] of weights) {
            const own = vertices[atom];
            for (let i = 0; i < mixed.length; i++) mixed[i] += weight * own[i];
        }
        return turn(mixed, R).map((value, i) => scale * value + t[i % 3]);
    }

    /**
     * Pixels of the image a unit of x and of y, at a depth: f / |Z|, or f where
     * nothing is smaller far away.
     */
    function magnification([fx, fy], perspective, depth) {
        const share = perspective ? 1 / Math.abs(depth) : 1;
        return [share * fx, share * fy];
    }

    /**
     * Where a camera [focal lengths x, y, principal point x, y] sees points: x0 y0 x1
     * ...
     */
    function project(points, camera, perspective) {
        const places = new Float64Array((points.length / 3) * 2);
        for (let i = 0, j = 0; i < points.length; i += 3, j += 2) {
            const [mx, my] = magnification(camera, perspective, points[i + 2]);
            places[j] = mx * points[i] + camera[2];
            places[j + 1] = my * points[i + 1] + camera[3];
        }
        return places;
    }

    /**
     * The ellipse {long, short, angle} of deviations sd (3) seen by the rows a and b
     * of a projection.
     */
    function ellipse([a, b], sd) {
        const sum = (u, v) =>
            u.reduce((total, value, i) => total + value * v[i] * sd[i] ** 2, 0);
        const [xx, yy, xy] = [sum(a, a), sum(b, b), sum(a, b)];
        const [middle, away] = [(xx + yy) / 2, Math.hypot((xx - yy) / 2, xy)];
        return {
            long: Math.sqrt(middle + away),
            short: Math.sqrt(Math.max(0, middle - away)),
            angle: Math.atan2(2 * xy, xx - yy) / 2
        };
    }

    /**
     * The upright box around points with `axes` coordinates each, those that are not
     * NaN: {low, middle, extent}; null around none. extent is half of its width and
     * height or, in space, how far points are from the vertical axis through the
     * middle, and half of the height.
     */
    function box(points, axes) {
        const [low, high] =
            [new Array(axes).fill(Infinity), new Array(axes).fill(-Infinity)];
        points.forEach((value, i) => {
            if (value < low[i % axes]) low[i % axes] = value;
            if (value > high[i % axes]) high[i % axes] = value;
        });
        if (low[0] > high[0]) return null;
        const middle = low.map((value, axis) => (value + high[axis]) / 2);
        const extent = low.slice(0, 2).map((value, axis) => middle[axis] - value);
        for (let i = 0; axes === 3 && i < points.length; i += 3) {
            const across = Math.hypot(points[i] - middle[0], points[i + 2] - middle[2]);
            if (across > extent[0]) extent[0] = across;
        }
        return {low, middle, extent};
    }

    return {viewRotation, inverse, turn, blend, magnification, project, ellipse, box};
})();
