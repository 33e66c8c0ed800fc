/** What the page shows, read from its JSON: frames, sequences, layers (results, truth), pictures. */
const scene = (() => {
  const LOOKED_AT = 200; // frames of a sequence, evenly spread, that tell its size

  function open(page) {
    const count = page.items.length;
    const sequences = page.sequences.map(([name, start], i) => ({ name, start, end: page.sequences[i + 1]?.[1] ?? count }));
    const owners = new Uint32Array(count); // the sequence of each frame
    sequences.forEach(({ start, end }, i) => owners.fill(i, start, end));
    const meshes = page.meshes.map(({ vertices, faces }) => {
      const block = blocks.open(vertices);
      return { atoms: Array.from({ length: block.count }, (_, i) => block.row(i)), faces: Uint32Array.from(blocks.numbers(faces)) };
    });
    const outliers = page.outliers && blocks.open(page.outliers);
    const data = {
      ...page,
      count,
      sequences,
      sequenceOf: (frame) => owners[frame],
      together: openMoments(page.moments ? blocks.numbers(page.moments) : []),
      seen: page.seen ? blocks.open(page.seen).row : () => null,
      outliers: outliers ? outliers.row : () => [],
      hasOutliers: Boolean(outliers),
      layers: page.layers.map((layer) => openLayer(layer, meshes)),
    };
    data.group = memo((index) => groupOf(data, index));
    data.size = memo((index) => sizeOf(data, sequences[index]));
    return data;
  }

  /** The function, which finds the value of each index once. */
  function memo(find) {
    const found = new Map();
    return (index) => {
      if (!found.has(index)) found.set(index, find(index));
      return found.get(index);
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
  function groupOf(data, index) {
    const { start, end } = data.sequences[index];
    const frames = Array.from({ length: end - start }, (_, i) => data.together(start + i)).flat();
    return [...new Set(frames.map(data.sequenceOf))].sort((a, b) => a - b);
  }

  /**
   * {solid, flat}: extents that hold 95% of the frames of a sequence, in space and in the image, so
   * that all are shown in one scale; 0 for frames that are no sequence.
   */
  function sizeOf(data, { name, start, end }) {
    if (!name && !data.rate_known) return { solid: [0, 0], flat: [0, 0] };
    const [solid, flat] = [[], []];
    for (let frame = start; frame < end; frame += Math.max(1, Math.floor((end - start) / LOOKED_AT))) {
      for (const layer of data.layers) solid.push(geometry.box(layer.points(frame), 3));
      flat.push(geometry.box(data.seen(frame) ?? [], 2));
    }
    const most = (boxes) => [0, 1].map((axis) => {
      const known = boxes.filter(Boolean).map(({ extent }) => extent[axis]).sort((a, b) => a - b);
      return known[Math.floor(0.95 * known.length)] ?? 0;
    });
    return { solid: most(solid), flat: most(flat) };
  }

  function openLayer(layer, meshes) {
    const row = (name) => (layer[name] ? blocks.open(layer[name]).row : null);
    const [points, pose, camera, fitted] = ["points", "pose", "camera", "fitted"].map(row);
    const mesh = layer.blend ? openBlend(layer.blend, meshes[layer.blend.mesh_set], pose) : () => null;

    /** Where the image shows points of this layer: x and y, or the camera's perspective. */
    function inImage(frame, values) {
      if (!camera) return values.filter((_, i) => i % 3 < 2);
      const placed = pose(frame);
      return geometry.seenInPerspective(values, placed[9], placed.slice(10), camera(frame));
    }
    /** Where the camera has points of this layer, or as they are: in one space with other individuals. */
    function inSpace(frame, values) {
      if (!camera) return values;
      const [placed, at] = [pose(frame), camera(frame)];
      return values.map((value, i) => (value - placed[10 + (i % 3)]) / placed[9] + at[i % 3]);
    }
    return {
      ...layer,
      points,
      mesh,
      inImage,
      inSpace,
      hasCamera: Boolean(camera),
      unit: (frame) => (camera ? pose(frame)[9] : 1),
      pose: pose ?? (() => null),
      faces: layer.blend ? meshes[layer.blend.mesh_set].faces : null,
      fitted: fitted ?? ((frame) => inImage(frame, points(frame))),
      sd: row("sd") ?? (() => null),
      measures: layer.measures.map((measure) => ({ ...measure, values: blocks.numbers(measure.values) })),
      status: layer.status ? openWords(layer.status) : () => null,
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
        [last, vertices] = [frame, used.length ? geometry.blend(mesh.atoms, used, pose(frame)) : null];
      }
      return vertices;
    };
  }

  function openWords({ words, codes }) {
    const numbers = blocks.numbers(codes);
    return (frame) => words[numbers[frame]];
  }

  /**
   * Rows of the list, {sequence} or {frame}: all sequences and the frames of the current one or,
   * for a text, those whose names hold it, whatever the case.
   */
  function find(data, text, current) {
    const rows = [];
    const wanted = text.trim().toLowerCase();
    const has = (name) => name.toLowerCase().includes(wanted);
    data.sequences.forEach((sequence, index) => {
      if (data.sequences.length > 1 && has(sequence.name)) rows.push({ sequence: index });
      if (!wanted && index !== current) return;
      for (let frame = sequence.start; frame < sequence.end; frame++) {
        if (has(data.items[frame])) rows.push({ frame });
      }
    });
    return rows;
  }

  /** The first frame after `from` of start..end, going round, whose shape a shown layer doubts; else `from`. */
  function nextDoubtful(layers, from, start, end) {
    const following = (step) => start + ((from - start + step) % (end - start));
    const frames = Array.from({ length: end - start }, (_, i) => following(i + 1));
    return frames.find((frame) => layers.some((layer) => layer.doubt?.(frame))) ?? from;
  }

  return { open, find, nextDoubtful };
})();
