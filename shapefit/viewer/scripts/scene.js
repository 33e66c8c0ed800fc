"use strict";
/** What the page shows, read from its JSON: frames, sequences, layers (results, truth), pictures. */
const scene = (() => {
  function open(page) {
    const starts = page.sequences.map((sequence) => sequence.start);
    const count = page.items.length;
    const sequences = page.sequences.map(({ name, start }, i) => ({ name, start, end: starts[i + 1] ?? count }));
    const meshes = page.meshes.map(openMesh);
    const together = page.moments ? openMoments(blocks.numbers(page.moments)) : () => [];
    const sequenceOf = (frame) => lastAtMost(starts, frame);
    return {
      ...page,
      count,
      hasOutliers: Boolean(page.outliers),
      sequences,
      sequenceOf,
      together,
      group: openGroups(sequences, together, sequenceOf),
      seen: page.seen ? blocks.open(page.seen).row : () => null,
      outliers: page.outliers ? openBits(page.outliers, page.landmarks.length) : () => [],
      layers: page.layers.map((layer) => openLayer(layer, meshes, page)),
    };
  }

  /** The frames of the same moment as a frame, itself among them; [] where it is alone. */
  function openMoments(moments) {
    const frames = new Map();
    moments.forEach((moment, frame) => {
      if (moment) frames.set(moment, [...(frames.get(moment) ?? []), frame]);
    });
    return (frame) => frames.get(moments[frame]) ?? [];
  }

  /** The sequences of which some frame is of one moment with one of this sequence, itself among them. */
  function openGroups(sequences, together, sequenceOf) {
    const found = new Map();
    return (index) => {
      if (!found.has(index)) {
        const group = new Set();
        for (let frame = sequences[index].start; frame < sequences[index].end; frame++) {
          for (const other of together(frame)) group.add(sequenceOf(other));
        }
        found.set(index, [...group].sort((a, b) => a - b));
      }
      return found.get(index);
    };
  }

  /** Index of the last of the ascending numbers that is at most `value`. */
  function lastAtMost(numbers, value) {
    let [low, high] = [0, numbers.length - 1];
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (numbers[middle] <= value) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  function openBits(block, landmarks) {
    const bytes = blocks.numbers(block);
    const width = block.shape[1];
    return (frame) => {
      const row = bytes.subarray(frame * width, (frame + 1) * width);
      return Array.from({ length: landmarks }, (_, j) => blocks.bit(row, j));
    };
  }

  function openMesh({ vertices, faces }) {
    const block = blocks.open(vertices);
    const atoms = Array.from({ length: block.count }, (_, i) => block.row(i));
    return { atoms, faces: Uint32Array.from(blocks.numbers(faces)) };
  }

  function openLayer(layer, meshes) {
    const points = blocks.open(layer.points).row;
    const pose = layer.pose ? blocks.open(layer.pose).row : () => null;
    const camera = layer.camera ? blocks.open(layer.camera).row : null;
    const fitted = layer.fitted ? blocks.open(layer.fitted).row : null;
    const mesh = layer.mesh ? openBlend(layer.mesh, meshes[layer.mesh.of], pose) : () => null;

    /** Where the image shows points of this layer: x and y, or the camera's perspective. */
    function inImage(frame, values) {
      if (camera) {
        const placed = pose(frame);
        return geometry.seenInPerspective(values, placed[9], placed.slice(10), camera(frame));
      }
      return values.filter((_, i) => i % 3 < 2);
    }
    /** Where the camera has points of this layer, or as they are: in one space with other individuals. */
    function inSpace(frame, values) {
      if (!camera) return values;
      const [placed, at] = [pose(frame), camera(frame)];
      return values.map((value, i) => (value - placed[10 + (i % 3)]) / placed[9] + at[i % 3]);
    }
    return {
      name: layer.name,
      role: layer.role,
      points,
      inSpace,
      hasCamera: Boolean(camera),
      unit: (frame) => (camera ? pose(frame)[9] : 1),
      pose,
      mesh,
      faces: layer.mesh ? meshes[layer.mesh.of].faces : null,
      inImage,
      fitted: (frame) => (fitted ? fitted(frame) : inImage(frame, points(frame))),
      sd: layer.sd ? blocks.open(layer.sd).row : () => null,
      measures: layer.measures.map((measure) => ({ ...measure, values: blocks.numbers(measure.values) })),
      words: layer.status ? openWords(layer.status) : () => null,
      doubt: layer.doubts ? openWords(layer.doubts) : null,
    };
  }

  /** The blended vertices of a frame; those of the last frame asked for are kept. */
  function openBlend({ start, atom, weight }, mesh, pose) {
    const [starts, atoms, weights] = [start, atom, weight].map(blocks.numbers);
    let [last, vertices] = [-1, null];
    return (frame) => {
      if (frame !== last) {
        const used = [];
        for (let i = starts[frame]; i < starts[frame + 1]; i++) used.push([atoms[i], weights[i]]);
        vertices = used.length ? geometry.blend(mesh.atoms, used, pose(frame)) : null;
        last = frame;
      }
      return vertices;
    };
  }

  function openWords({ words, codes }) {
    const numbers = blocks.numbers(codes);
    return (frame) => words[numbers[frame]];
  }

  /** Frames and sequences whose names hold the text, whatever the case: [{sequence} or {frame}]. */
  function find(open_, text, current) {
    const rows = [];
    const wanted = text.trim().toLowerCase();
    const has = (name) => name.toLowerCase().includes(wanted);
    const many = open_.sequences.length > 1;
    open_.sequences.forEach((sequence, index) => {
      if (many && (!wanted || has(sequence.name))) rows.push({ sequence: index });
      if (!wanted && index !== current) return;
      for (let frame = sequence.start; frame < sequence.end; frame++) {
        if (!wanted || has(open_.items[frame])) rows.push({ frame });
      }
    });
    return rows;
  }

  /** The first frame after `from` of start..end, going round, whose shape a shown layer doubts; -1 for none. */
  function nextDoubtful(layers, from, start, end) {
    const count = end - start;
    for (let step = 1; step <= count; step++) {
      const frame = start + ((from - start + step) % count);
      if (layers.some((layer) => layer.doubt?.(frame))) return frame;
    }
    return -1;
  }

  return { open, find, lastAtMost, nextDoubtful };
})();
if (typeof module !== "undefined") module.exports = scene;
