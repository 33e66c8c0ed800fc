/**
 * The mathematics of the page: rotations, the orthographic camera of the 3D panel, blended meshes.
 *
 * Points are flat arrays x0 y0 z0 x1 ...; rotations are 9 numbers, row by row. The frame of the
 * viewer is x right, y up, z towards the viewer. Angles are in degrees.
 */
const geometry = (() => {
  const DEGREE = Math.PI / 180;
  const IDENTITY = [1, 0, 0, 0, 1, 0, 0, 0, 1];
  const ORIGIN = [0, 0, 0];

  /** Rx(pitch) Ry(yaw): walk around the object by yaw, then rise above it by pitch. */
  function viewRotation(yaw, pitch) {
    const [c, s] = [Math.cos(yaw * DEGREE), Math.sin(yaw * DEGREE)];
    const [d, t] = [Math.cos(pitch * DEGREE), Math.sin(pitch * DEGREE)];
    return [c, 0, s, t * s, d, -t * c, -d * s, t, d * c];
  }

  /** The transpose, which is the inverse, of a rotation. */
  function inverse(R) {
    return [R[0], R[3], R[6], R[1], R[4], R[7], R[2], R[5], R[8]];
  }

  /**
   * From the camera frame to the viewer's: half a turn about x where y points down.
   *
   * The camera frame is landmark x, landmark y and their cross product.
   */
  function uprightRotation(yDown) {
    return yDown ? [1, 0, 0, 0, -1, 0, 0, 0, -1] : IDENTITY;
  }

  /** R (x - centre) for every point. */
  function turn(points, R, centre = ORIGIN) {
    const turned = new Float64Array(points.length);
    for (let i = 0; i < points.length; i += 3) {
      const [x, y, z] = [points[i] - centre[0], points[i + 1] - centre[1], points[i + 2] - centre[2]];
      for (let row = 0; row < 3; row++) turned[i + row] = R[3 * row] * x + R[3 * row + 1] * y + R[3 * row + 2] * z;
    }
    return turned;
  }

  /** Pixels [u, v] (v down) of points that were turned: zoom px a unit, pan in px from the middle. */
  function project(turned, { zoom, pan }, width, height) {
    const pixels = [];
    for (let i = 0; i < turned.length; i += 3) {
      pixels.push([width / 2 + pan[0] + zoom * turned[i], height / 2 + pan[1] - zoom * turned[i + 1]]);
    }
    return pixels;
  }

  /** s R sum_i w_i V_i + t: a mesh mixed of the vertices V_i of atoms, then placed by a pose. */
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
   * (f X / |Z| + centre): where a perspective camera sees points placed by a pose (…, scale, t).
   *
   * camera holds position x y z of the centroid, focal lengths x y and principal point x y; depths
   * are negative where y points up.
   */
  function seenInPerspective(points, scale, t, camera) {
    const seen = new Float64Array((points.length / 3) * 2);
    for (let i = 0, j = 0; i < points.length; i += 3, j += 2) {
      const depth = Math.abs(points[i + 2] / scale + camera[2]);
      seen[j] = (camera[3] * ((points[i] - t[0]) / scale + camera[0])) / depth + camera[5];
      seen[j + 1] = (camera[4] * ((points[i + 1] - t[1]) / scale + camera[1])) / depth + camera[6];
    }
    return seen;
  }

  /**
   * The upright box around points with `axes` coordinates each, those that are not NaN: {low,
   * middle, extent}; null around none. extent is half of its width and height or, in space, how far
   * points are from the vertical axis through the middle, and half of the height.
   */
  function box(points, axes) {
    const [low, high] = [new Array(axes).fill(Infinity), new Array(axes).fill(-Infinity)];
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
    return { low, middle, extent };
  }

  /** A ball of radius 1 as triangles: an octahedron whose faces are divided once. */
  function ball() {
    const unit = (point) => point.map((value) => value / Math.hypot(...point));
    const between = (a, b) => unit(a.map((value, i) => value + b[i]));
    const triangles = [];
    for (const x of [-1, 1]) for (const y of [-1, 1]) for (const z of [-1, 1]) {
      const [a, b, c] = [[x, 0, 0], [0, y, 0], [0, 0, z]];
      const [ab, bc, ca] = [between(a, b), between(b, c), between(c, a)];
      triangles.push(a, ab, ca, b, bc, ab, c, ca, bc, ab, bc, ca);
    }
    return triangles;
  }

  return { IDENTITY, viewRotation, inverse, uprightRotation, turn, project, blend, seenInPerspective, box, ball };
})();
