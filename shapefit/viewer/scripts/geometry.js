"use strict";
/**
 * The mathematics of the page: rotations, the orthographic camera of the 3D panel, blended meshes.
 *
 * Points are flat arrays x0 y0 z0 x1 ...; rotations are 9 numbers, row by row. The frame of the
 * viewer is x right, y up, z towards the viewer. Angles are in degrees.
 */
const geometry = (() => {
  const DEGREE = Math.PI / 180;
  const IDENTITY = [1, 0, 0, 0, 1, 0, 0, 0, 1];

  /** Rx(pitch) Ry(yaw): walk around the object by yaw, then rise above it by pitch. */
  function viewRotation(yaw, pitch) {
    const [c, s] = [Math.cos(yaw * DEGREE), Math.sin(yaw * DEGREE)];
    const [d, t] = [Math.cos(pitch * DEGREE), Math.sin(pitch * DEGREE)];
    return [c, 0, s, t * s, d, -t * c, -d * s, t, d * c];
  }

  /** The product A B of two rotations. */
  function compose(A, B) {
    const product = new Array(9);
    for (let i = 0; i < 3; i++) {
      for (let j = 0; j < 3; j++) {
        product[3 * i + j] = A[3 * i] * B[j] + A[3 * i + 1] * B[3 + j] + A[3 * i + 2] * B[6 + j];
      }
    }
    return product;
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
  function turn(points, R, centre) {
    const turned = new Float64Array(points.length);
    for (let i = 0; i < points.length; i += 3) {
      const x = points[i] - centre[0];
      const y = points[i + 1] - centre[1];
      const z = points[i + 2] - centre[2];
      turned[i] = R[0] * x + R[1] * y + R[2] * z;
      turned[i + 1] = R[3] * x + R[4] * y + R[5] * z;
      turned[i + 2] = R[6] * x + R[7] * y + R[8] * z;
    }
    return turned;
  }

  /** Pixels [u, v] (v down) of points that were turned: zoom px a unit, pan in px from the middle. */
  function project(turned, camera, width, height) {
    const pixels = [];
    for (let i = 0; i < turned.length; i += 3) {
      pixels.push([
        width / 2 + camera.pan[0] + camera.zoom * turned[i],
        height / 2 + camera.pan[1] - camera.zoom * turned[i + 1],
      ]);
    }
    return pixels;
  }

  /** s R sum_i w_i V_i + t: a mesh mixed of the vertices V_i of atoms, then placed by a pose. */
  function blend(vertices, weights, pose) {
    const [R, scale, t] = [pose.slice(0, 9), pose[9], pose.slice(10, 13)];
    const mixed = new Float64Array(weights.length ? vertices[weights[0][0]].length : 0);
    for (const [atom, weight] of weights) {
      const own = vertices[atom];
      for (let i = 0; i < mixed.length; i++) mixed[i] += weight * own[i];
    }
    const placed = turn(mixed, R, [0, 0, 0]);
    for (let i = 0; i < placed.length; i++) placed[i] = scale * placed[i] + t[i % 3];
    return placed;
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

  /** {middle, radius} of points with `axes` coordinates each; NaN ones do not count. */
  function extent(points, axes) {
    const middle = new Array(axes).fill(0);
    let count = 0;
    for (let i = 0; i < points.length; i += axes) {
      if (!Number.isFinite(points[i])) continue;
      count++;
      for (let a = 0; a < axes; a++) middle[a] += points[i + a];
    }
    if (!count) return null;
    for (let a = 0; a < axes; a++) middle[a] /= count;
    let radius = 0;
    for (let i = 0; i < points.length; i += axes) {
      if (!Number.isFinite(points[i])) continue;
      let square = 0;
      for (let a = 0; a < axes; a++) square += (points[i + a] - middle[a]) ** 2;
      radius = Math.max(radius, Math.sqrt(square));
    }
    return { middle, radius };
  }

  /**
   * How far points (x y z, y up) reach: {low, high} along y, and `wide`, from the axis through the
   * middle, whichever way they turn about it; null for none.
   */
  function reach(points) {
    const found = { low: Infinity, high: -Infinity, wide: 0 };
    for (let i = 0; i < points.length; i += 3) {
      if (!Number.isFinite(points[i])) continue;
      found.low = Math.min(found.low, points[i + 1]);
      found.high = Math.max(found.high, points[i + 1]);
      found.wide = Math.max(found.wide, Math.hypot(points[i], points[i + 2]));
    }
    return found.low > found.high ? null : found;
  }

  /** Half of what a camera at this pitch sees of a body of this reach: [across, up]. */
  function halves({ low, high, wide }, pitch) {
    const [c, s] = [Math.cos(pitch * DEGREE), Math.abs(Math.sin(pitch * DEGREE))];
    return [wide, (c * (high - low)) / 2 + s * wide];
  }

  /** {middle, halves} of the upright box around points x0 y0 x1 ...; one of nothing around none. */
  function box(points) {
    const sides = [0, 1].map((axis) => {
      const known = Array.from(points).filter((value, i) => i % 2 === axis && Number.isFinite(value));
      return [Math.min(...known), Math.max(...known)];
    });
    if (!Number.isFinite(sides[0][0])) return { middle: [0, 0], halves: [0, 0] };
    return { middle: sides.map(([low, high]) => (low + high) / 2), halves: sides.map(([low, high]) => (high - low) / 2) };
  }

  /** A ball of radius 1: {vertices, faces}, from an octahedron whose faces are divided once. */
  function ball() {
    const corners = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
    const between = (a, b) => {
      const middle = a.map((value, i) => value + b[i]);
      return middle.map((value) => value / Math.hypot(...middle));
    };
    const [vertices, faces] = [[], []];
    for (const x of [0, 1]) for (const y of [2, 3]) for (const z of [4, 5]) {
      const [a, b, c] = [corners[x], corners[y], corners[z]];
      const [ab, bc, ca] = [between(a, b), between(b, c), between(c, a)];
      for (const face of [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]) {
        for (const corner of face) {
          faces.push(vertices.length / 3);
          vertices.push(...corner);
        }
      }
    }
    return { vertices, faces };
  }

  return { IDENTITY, reach, halves, box, ball, viewRotation, compose, inverse, uprightRotation, turn, project, blend, seenInPerspective, extent };
})();
if (typeof module !== "undefined") module.exports = geometry;
