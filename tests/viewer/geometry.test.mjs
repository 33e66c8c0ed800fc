// The pure mathematics of the page: `node --test tests/viewer/`.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import test from "node:test";
import vm from "node:vm";

const read = (name) => readFileSync(new URL(`../../shapefit/viewer/scripts/${name}.js`, import.meta.url), "utf8");
const names = ["blocks", "geometry", "scene", "look", "plane", "strip"];
const { blocks, geometry, scene, look, plane, strip } = vm.runInThisContext(`${names.map(read).join("\n")}; ({ ${names} })`);

function near(actual, expected, tolerance = 1e-12) {
  assert.equal(actual.length, expected.length);
  expected.forEach((value, i) => assert.ok(Math.abs(actual[i] - value) <= tolerance, `${actual} != ${expected}`));
}

const base64 = (array) => Buffer.from(array.buffer).toString("base64");
const SPIN = geometry.viewRotation(35, -20);

test("a view rotation is proper", () => {
  for (const axis of [[1, 0, 0], [0, 1, 0], [0, 0, 1]]) near(geometry.turn(geometry.turn(axis, SPIN), geometry.inverse(SPIN)), axis);
  const [a, b, c, d, e, f, g, h, i] = SPIN;
  near([a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)], [1]);
});

test("yaw takes the near side to the right, pitch the upper side to the viewer", () => {
  near(geometry.turn([0, 0, 1], geometry.viewRotation(90, 0), [0, 0, 0]), [1, 0, 0]);
  near(geometry.turn([0, 1, 0], geometry.viewRotation(0, 90), [0, 0, 0]), [0, 0, 1]);
});

test("the camera frame stands upright where y points down", () => {
  near(geometry.turn([1, 2, 3], geometry.uprightRotation(true), [0, 0, 0]), [1, -2, -3]);
  near(geometry.turn([1, 2, 3], geometry.uprightRotation(false), [0, 0, 0]), [1, 2, 3]);
});

test("points are turned around the centre, and hidden ones stay unknown", () => {
  const turned = geometry.turn([1, 1, 1, NaN, 0, 0], SPIN, [1, 1, 1]);
  near(turned.slice(0, 3), [0, 0, 0]);
  assert.ok(Number.isNaN(turned[3]));
});

test("projection puts the centre in the middle and y up", () => {
  const camera = { zoom: 10, pan: [3, 4] };
  near(geometry.project([0, 0, 5, 1, 2, -7], camera, 200, 100).flat(), [103, 54, 113, 34]);
});

test("a blend is s R (sum of weighted atoms) + t", () => {
  const atoms = [[1, 0, 0, 0, 1, 0], [0, 0, 2, 1, 1, 1]];
  const pose = [0, -1, 0, 1, 0, 0, 0, 0, 1, 2, 10, 20, 30];
  near(geometry.blend(atoms, [[0, 1], [1, 0.5]], pose), [10, 22, 32, 7, 21, 31]);
});

test("perspective: x focal / depth + centre, whichever way z points", () => {
  const camera = [1, 2, 8, 100, 200, 5, 6];
  near(geometry.seenInPerspective([11, 22, 6], 3, [11, 22, 0], camera), [15, 46]);
  const behind = [1, 2, -8, 100, 200, 5, 6];
  near(geometry.seenInPerspective([11, 22, -6], 3, [11, 22, 0], behind), [15, 46]);
});

test("the strip is high where it is bad, and keeps the worst of a column", () => {
  assert.deepEqual(strip.badness([0, 5, 10, NaN], { scale: "linear", bad: "high" }), [0, 0.5, 1, Infinity]);
  assert.deepEqual(strip.badness([-10, 0], { scale: "linear", bad: "low" }), [1, 0]);
  near(strip.badness([1e-8, 1e-6, 1e-4], { scale: "log", bad: "high" }), [0, 0.5, 1]);
  assert.deepEqual(strip.badness([0.1, 0.6], { scale: "share", bad: "high" }), [0.1, 0.6]);
  assert.deepEqual(strip.badness([1, 1], { scale: "linear", bad: "low" }), [0, 0]);
  assert.deepEqual(strip.columnsOf([0, 3, 1, Infinity], 2), [3, Infinity]);
  assert.deepEqual(strip.columnsOf([1, 2], 4), [1, 1, 2, 2]);
  assert.deepEqual(strip.ranking([0.5, Infinity, 0.7, 0.5]), [1, 2, 0, 3]);
});

test("the limit of a measure stands on the scale of its values, beyond them too", () => {
  const plausibility = { scale: "linear", bad: "low", limit: 0.25 };
  const threshold = (values, measure) => strip.badness(values, measure, [measure.limit])[0];
  assert.equal(threshold([0, 0.5, 1], plausibility), 0.75);
  near(strip.badness([0.75, 1], plausibility), [1 / 3, 0]);
  assert.equal(threshold([0.75, 1], plausibility), 1);
});

test("the next doubtful frame is sought in the sequence, going round", () => {
  const layer = { doubt: (frame) => ["", "implausible", "", "", "wide", "implausible"][frame] };
  const next = (from) => scene.nextDoubtful([{ doubt: null }, layer], from, 0, 5);
  assert.deepEqual([0, 1, 2, 4].map(next), [1, 4, 4, 1]);
  assert.equal(scene.nextDoubtful([layer], 2, 2, 4), 2);
});

test("a click on the strip finds its frame", () => {
  assert.deepEqual([-5, 0, 499, 999, 2000].map((x) => strip.frameAt(x, 1000, 10)), [0, 0, 4, 9, 9]);
});

test("search finds sequences and items whatever the case; without text the current sequence", () => {
  const open = { items: ["A/1", "A/2", "b/1"], sequences: [{ name: "A", start: 0, end: 2 }, { name: "b", start: 2, end: 3 }] };
  assert.deepEqual(scene.find(open, "", 1), [{ sequence: 0 }, { sequence: 1 }, { frame: 2 }]);
  assert.deepEqual(scene.find(open, " /1", 0), [{ frame: 0 }, { frame: 2 }]);
  assert.deepEqual(scene.find(open, "B", 0), [{ sequence: 1 }, { frame: 2 }]);
});

test("individuals of one moment are found from each other's frames", () => {
  const moments = { type: "u4", shape: [5], data: base64(Uint32Array.of(0, 1, 2, 2, 1)) };
  const sequences = [["v/a", 0], ["v/b", 3], ["w", 5]];
  const open = scene.open({ items: ["a0", "a1", "a2", "b2", "b1", "w"], sequences, moments, meshes: [], layers: [], landmarks: [] });
  assert.deepEqual([0, 1, 2, 3].map(open.together), [[], [1, 4], [2, 3], [2, 3]]);
  assert.deepEqual([0, 1, 2].map(open.group), [[0, 1], [0, 1], []]);
  assert.deepEqual([0, 2, 3, 5].map(open.sequenceOf), [0, 0, 1, 2]);
});

test("blocks: each row of points has a scale of its own, missing ones are NaN", () => {
  const codes = Int16Array.from([-32768, 10, 32767, 0]);
  const places = { type: "f4", shape: [2, 3], data: base64(Float32Array.of(100, 200, 0.5, -1, -2, 2)) };
  const points = blocks.open({ type: "i2", shape: [2, 1, 2], places, data: base64(codes) });
  assert.deepEqual([...points.row(0)], [NaN, 205]);
  assert.deepEqual([...points.row(1)], [-1 + 2 * 32767, -2]);
});

test("a box leaves out what is unknown, and reaches as far as a body does whichever way it turns", () => {
  const flat = geometry.box([1, 2, NaN, NaN, 5, 8], 2);
  assert.deepEqual(flat, { low: [1, 2], middle: [3, 5], extent: [2, 3] });
  assert.deepEqual(geometry.box([-3, 0, -4, 3, 2, 4, NaN, NaN, NaN], 3).extent, [5, 1]);
  assert.equal(geometry.box([NaN, NaN, NaN], 3), null);
});

test("frames of a sequence share a scale, but for a few of them; single images have their own", () => {
  const radii = [...new Array(38).fill(1), 2, 90];
  const points = { type: "f4", shape: [40, 2, 3], data: base64(Float32Array.from(radii.flatMap((r) => [-r, -r, 0, r, r, 0]))) };
  const layer = { name: "fit", role: "result", points, measures: [] };
  const page = (name) => ({ items: radii.map(String), sequences: [[name, 0]], meshes: [], layers: [layer], landmarks: ["a", "b"] });
  assert.deepEqual(scene.open(page("walk")).size(0).solid, [2, 2]);
  assert.deepEqual(scene.open(page("")).size(0).solid, [0, 0]);
});

test("the scale has a round length", () => {
  assert.deepEqual([0.3, 1, 1.5, 30, 60].map(plane.niceStep), [0.5, 1, 2, 50, 100]);
});

test("names that would cover others are left out", () => {
  assert.deepEqual(look.apart([[0, 0], [5, 5], [0, 40], [NaN, 0]], ["a", "b", "c", "d"]), [0, 2]);
});

test("a ball is round", () => {
  const corners = geometry.ball();
  assert.equal(corners.length, 3 * 8 * 4);
  for (const corner of corners) near([Math.hypot(...corner)], [1]);
});
