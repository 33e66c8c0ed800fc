// The pure mathematics of the page: `node --test tests/viewer/`.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import test from "node:test";
import vm from "node:vm";

const read = (name) => readFileSync(new URL(`../../shapefit/viewer/scripts/${name}.js`, import.meta.url), "utf8");
const names = ["blocks", "geometry", "scene", "look", "chart"];
const { blocks, geometry, scene, look, chart } = vm.runInThisContext(`${names.map(read).join("\n")}; ({ ${names} })`);

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

test("points are turned around the centre, and hidden ones stay unknown", () => {
  const turned = geometry.turn([1, 1, 1, NaN, 0, 0], SPIN, [1, 1, 1]);
  near(turned.slice(0, 3), [0, 0, 0]);
  assert.ok(Number.isNaN(turned[3]));
});

test("a blend is s R (sum of weighted atoms) + t", () => {
  const atoms = [[1, 0, 0, 0, 1, 0], [0, 0, 2, 1, 1, 1]];
  const pose = [0, -1, 0, 1, 0, 0, 0, 0, 1, 2, 10, 20, 30];
  near(geometry.blend(atoms, [[0, 1], [1, 0.5]], pose), [10, 22, 32, 7, 21, 31]);
});

test("a box leaves out what is unknown, and reaches as far as a body does whichever way it turns", () => {
  const flat = geometry.box([1, 2, NaN, NaN, 5, 8], 2);
  assert.deepEqual(flat, { low: [1, 2], middle: [3, 5], extent: [2, 3] });
  assert.deepEqual(geometry.box([-3, 0, -4, 3, 2, 4, NaN, NaN, NaN], 3).extent, [5, 1]);
  assert.equal(geometry.box([NaN, NaN, NaN], 3), null);
});

test("a camera sees x focal / depth + centre, whichever way z points, or x focal + centre", () => {
  const camera = [100, 200, 5, 6];
  near([...geometry.project([1, 2, 10, 1, 2, -10], camera, true)], [15, 46, 15, 46]);
  near([...geometry.project([1, 2, 10], camera, false)], [105, 406]);
});

test("an ellipse is that of the projected covariance", () => {
  near(Object.values(geometry.ellipse([[1, 0, 0], [0, 1, 0]], [3, 2, 9])), [3, 2, 0]);
  const { long, short, angle } = geometry.ellipse([[0, 0, 2], [1, 0, 0]], [1, 5, 4]);
  near([long, short, angle], [8, 1, 0]);
  const tilted = geometry.ellipse([[1, 1, 0], [1, -1, 0]], [2, 1, 0]);
  near([tilted.long, tilted.short, tilted.angle], [Math.sqrt(8), Math.sqrt(2), Math.PI / 4]);
});

test("blocks: each row of points has a scale of its own, missing ones are NaN", () => {
  const codes = Int16Array.from([-32768, 10, 32767, 0]);
  const places = { type: "f4", shape: [2, 3], data: base64(Float32Array.of(100, 200, 0.5, -1, -2, 2)) };
  const row = blocks.rows({ type: "i2", shape: [2, 1, 2], places, data: base64(codes) });
  assert.deepEqual([...row(0)], [NaN, 205]);
  assert.deepEqual([...row(1)], [-1 + 2 * 32767, -2]);
});

const GROUND = { upright: [1, 0, 0, 0, 1, 0, 0, 0, 1] };
const PAGE = { meshes: [], layers: [], landmarks: [], edges: [], recordings: [[0]] };

/** Two individuals of one video, five moments of it, and an image by itself. */
function couple() {
  const times = { type: "u1", shape: [6], data: base64(Uint8Array.of(0, 1, 2, 2, 4, 0)) };
  return scene.open({
    ...PAGE, times, recordings: [[0, 1], [2]], grounds: [GROUND, GROUND, GROUND],
    items: ["a0", "a1", "a2", "b2", "b4", "w"], sequences: [["v/a", 0], ["v/b", 3], ["w", 5]],
  });
}

test("a recording has a row of frames for each individual, by their times", () => {
  const data = couple();
  const [both, alone] = data.recordings;
  assert.deepEqual(both.tracks.map(({ label, frames }) => [label, [...frames]]), [["a", [0, 1, 2, -1, -1]], ["b", [-1, -1, 3, -1, 4]]]);
  assert.deepEqual([both.length, alone.length], [5, 1]);
  assert.deepEqual([0, 2, 3, 4].map((time) => scene.framesAt(both, time)), [[0], [2, 3], [], [4]]);
  assert.deepEqual([0, 4, 5].map(data.sequenceOf), [0, 1, 2]);
  assert.deepEqual([0, 4, 5].map(data.timeOf), [0, 4, 0]);
  assert.equal(data.recordingOf(4), both);
});

test("the next doubtful frame is sought over all individuals and recordings, going round", () => {
  const next = (from, ...untrusted) => scene.nextUntrusted(couple(), from, (frame) => untrusted.includes(frame));
  assert.equal(next(0, 3), 3);
  assert.equal(next(2, 3), 3); // going round: this moment again, last of all
  assert.equal(next(0, 5, 4), 4);
  assert.equal(next(3, 3, 4), 4); // and not this one again
  assert.equal(next(4, 5), 5);
  assert.equal(next(4, 1), 1);
  assert.equal(next(0), null);
});

test("frames of a recording share a scale, but for a few of them; single images have their own", () => {
  const radii = [...new Array(38).fill(1), 2, 90];
  const points = { type: "f4", shape: [40, 2, 3], data: base64(Float32Array.from(radii.flatMap((r) => [-r, -r, 0, r, r, 0]))) };
  const layer = { name: "fit", role: "result", points, measures: [] };
  const times = { type: "u1", shape: [40], data: base64(Uint8Array.from(radii, (_, i) => i)) };
  const page = (name) => scene.open({ ...PAGE, times, video: Boolean(name), items: radii.map(String), sequences: [[name, 0]], grounds: [GROUND], layers: [layer], landmarks: ["a", "b"] });
  const [walk, single] = ["walk", ""].map((name) => ((data) => data.size(data.recordings[0]).solid)(page(name)));
  assert.deepEqual([walk, single], [[2, 2], [0, 0]]);
});

test("a chart reaches over what is known and its bands, but not over the wildest hundredth", () => {
  assert.deepEqual(chart.rangeOf([{ values: [1, NaN, 3], sd: [0.5, 0, 1] }]), [0.5, 4]);
  assert.deepEqual(chart.rangeOf([{ values: [2, 2] }]), [1.5, 2.5]);
  assert.deepEqual(chart.rangeOf([{ values: [NaN] }]), [0, 1]);
  const most = Array.from({ length: 200 }, (_, i) => i);
  assert.ok(chart.rangeOf([{ values: [...most, 1e9] }])[1] < 200);
});

test("a click on the chart finds its moment, between the borders", () => {
  const wide = 1000 + chart.LEFT + chart.RIGHT;
  assert.deepEqual([-5, 0, 99, 499, 999, 2000].map((x) => chart.timeAt(x + chart.LEFT, wide, 10)), [0, 0, 0, 4, 9, 9]);
});

test("a scale has a round length", () => {
  assert.deepEqual([0.3, 1, 1.5, 30, 60].map(look.niceStep), [0.5, 1, 2, 50, 100]);
});

test("long names differ where they are read", () => {
  const long = ["session_2024_03_07_camera_1/person_1", "session_2024_03_07_camera_1/person_2"];
  assert.deepEqual(scene.short(long), ["…person_1", "…person_2"]);
  assert.deepEqual(scene.short(["a/1", "a/2"]), ["a/1", "a/2"]);
  const ends = scene.short(["first_of_all_sedans_in_the_set/view_1", "last_of_all_sedans_in_the_set/view_2"]);
  assert.deepEqual(ends, ["first_of…_the_set/view_1", "last_of_…_the_set/view_2"]);
  const cars = ["image171206072248672_car0000", "image180206032437542_car0001"];
  assert.deepEqual(scene.short(cars), ["…71206072248672_car0000", "…80206032437542_car0001"]);
  const alike = ["a sedan of the first kind, from the left", "b sedan of the other kind, from the left", "a sedan of the third kind, from the left"];
  assert.deepEqual(scene.short(alike), alike); // both ends would not tell them apart
  assert.deepEqual(scene.short(["the only one, whose name is far too long"]), ["the only…is far too long"]);
});

test("one result is coloured by individual, several by result", () => {
  const [fit, other, truth] = [{ role: "result" }, { role: "result" }, { role: "truth" }];
  const colours = (layers, layer) => [0, 1, 7].map((track) => look.colourOf({ layers }, layer, track));
  assert.deepEqual(colours([fit, truth], fit), ["body-0", "body-1", "body-1"]);
  assert.deepEqual(colours([fit, other], other), ["body-1", "body-1", "body-1"]);
  assert.deepEqual(colours([fit, truth], truth), ["truth", "truth", "truth"]);
});
