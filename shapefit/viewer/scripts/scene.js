/** What the page shows, read from its JSON: frames, recordings, layers (results, truth), pictures. */
const scene = (() => {
  const LOOKED_AT = 200; // frames of a recording, evenly spread, that tell its size
  const LONG = 24; // letters of a name that fit into the list

  /**
   * The page with functions in place of its blocks.
   *
   * A recording has a row of frames for each of its tracks, one individual each, -1 where it is not
   * there: tracks[i].frames[time]. A sequence that is alone is a recording of one track.
   */
  function open(page) {
    const count = page.items.length;
    const sequences = page.sequences.map(([name, start], i) => ({ name, start, end: page.sequences[i + 1]?.[1] ?? count }));
    const [owners, homes, times] = [0, 1, 2].map(() => new Uint32Array(count)); // sequence, recording, time of frames
    sequences.forEach(({ start, end }, i) => {
      for (let frame = start; frame < end; frame++) [owners[frame], times[frame]] = [i, frame - start];
    });
    if (page.times) times.set(blocks.numbers(page.times));
    const recordings = (page.recordings ?? sequences.map((_, i) => [i])).map((members, home) => {
      const frames = members.flatMap((i) => Array.from({ length: sequences[i].end - sequences[i].start }, (_, f) => sequences[i].start + f));
      const labels = distinct(members.map((i) => sequences[i].name.split("/").pop()));
      const length = 1 + frames.reduce((most, frame) => Math.max(most, times[frame]), 0);
      const tracks = members.map((i, m) => ({ ...sequences[i], label: labels[m], sequence: i, frames: new Int32Array(length).fill(-1) }));
      for (const frame of frames) {
        homes[frame] = home;
        tracks[members.indexOf(owners[frame])].frames[times[frame]] = frame;
      }
      return { tracks, length };
    });
    const meshes = page.meshes.map(({ vertices, faces }) => {
      const row = blocks.rows(vertices);
      return { atoms: Array.from({ length: vertices.shape[0] }, (_, i) => row(i)), faces: Uint32Array.from(blocks.numbers(faces)) };
    });
    const data = {
      ...page,
      count,
      sequences,
      recordings,
      sequenceOf: (frame) => owners[frame],
      standOf: (frame) => page.stands[owners[frame]],
      recordingOf: (frame) => recordings[homes[frame]],
      timeOf: (frame) => times[frame],
      seen: page.seen ? blocks.rows(page.seen) : () => null,
      outliers: page.outliers ? blocks.rows(page.outliers) : () => [],
      layers: page.layers.map((layer) => openLayer(layer, meshes)),
    };
    data.size = (recording) => (recording.size ??= sizeOf(data, recording, page.stands[recording.tracks[0].sequence]));
    return data;
  }

  /** Names without the whole words that all begin with: walk_person_1, walk_person_2 are person_1, person_2. */
  function distinct(names) {
    let same = 0;
    while (names.length > 1 && names.every((name) => same < name.length && name[same] === names[0][same])) same++;
    const words = [...names[0].slice(0, same).matchAll(/[_ -]/g)].map(({ index }) => index + 1);
    const kept = words.findLast((end) => names.every((name) => /[a-z]/i.test(name.slice(end)))) ?? 0;
    return names.map((name) => name.slice(kept));
  }

  /** The frames of all individuals at a time of a recording. */
  function framesAt(recording, time) {
    return recording.tracks.map(({ frames }) => frames[time]).filter((frame) => frame >= 0);
  }

  /**
   * {solid, flat}: extents that hold 95% of the frames of a recording, in space and in the image, so
   * that all are shown in one scale; 0 for frames that are no sequence.
   */
  function sizeOf(data, recording, { upright }) {
    if (!data.video) return { solid: [0, 0], flat: [0, 0] };
    const [solid, flat] = [[], []];
    for (let time = 0; time < recording.length; time += Math.max(1, Math.floor(recording.length / LOOKED_AT))) {
      const frames = framesAt(recording, time);
      const whole = (rows) => frames.flatMap((frame) => rows.flatMap((row) => Array.from(row(frame) ?? [])));
      solid.push(geometry.box(geometry.turn(whole(data.layers.map(({ points }) => points)), upright), 3));
      flat.push(geometry.box(whole([data.seen]), 2));
    }
    const most = (boxes) => [0, 1].map((axis) => {
      const known = boxes.filter(Boolean).map(({ extent }) => extent[axis]).sort((a, b) => a - b);
      return known[Math.floor(0.95 * known.length)] ?? 0;
    });
    return { solid: most(solid), flat: most(flat) };
  }

  function openLayer(layer, meshes) {
    const row = (name) => (layer[name] ? blocks.rows(layer[name]) : null);
    const [points, pose, camera, fitted] = ["points", "pose", "camera", "fitted"].map(row);
    const mesh = layer.blend ? openBlend(layer.blend, meshes[layer.blend.mesh_set], pose) : () => null;
    const cameraOf = camera ?? (() => [1, 1, 0, 0]);
    const inImage = (frame, values) => geometry.seen(values, cameraOf(frame), layer.perspective);
    return {
      ...layer,
      points,
      mesh,
      inImage,
      magnification: (frame, depth) => geometry.magnification(cameraOf(frame), layer.perspective, depth),
      pose: pose ?? (() => null),
      faces: layer.blend ? meshes[layer.blend.mesh_set].faces : null,
      fitted: fitted ?? ((frame) => inImage(frame, points(frame))),
      sd: row("sd") ?? (() => null),
      has: (frame) => points(frame).some(Number.isFinite),
      camera: cameraOf,
      measures: layer.measures.map((measure) => ({ ...measure, values: blocks.numbers(measure.values), sd: measure.sd && blocks.numbers(measure.sd) })),
      word: layer.status ? openWords(layer.status) : () => "",
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

  /** Names that differ where they are read: long ones without what all begin with, and with the end of what is left. */
  function short(names) {
    if (names.every(({ length }) => length <= LONG)) return names;
    let same = 0;
    while (names.length > 1 && names.every((name) => same < name.length && name[same] === names[0][same])) same++;
    const kept = names[0].slice(0, same).search(/[^/ ]*$/); // whole words
    return names.map((name) => {
      const rest = kept > 1 ? `…${name.slice(kept)}` : name;
      return rest.length <= LONG ? rest : `${rest.slice(0, 8)}…${rest.slice(9 - LONG)}`;
    });
  }

  /** The first frame after `from`, over all recordings and going round, in which `doubted` doubts some individual; null for none. */
  function nextDoubtful(data, from, doubted) {
    const here = data.recordings.indexOf(data.recordingOf(from));
    for (let step = 0; step <= data.recordings.length; step++) {
      const recording = data.recordings[(here + step) % data.recordings.length];
      for (let time = step ? 0 : data.timeOf(from) + 1; time < recording.length; time++) {
        const found = framesAt(recording, time).find(doubted);
        if (found !== undefined) return found;
      }
    }
    return null;
  }

  return { open, framesAt, short, nextDoubtful };
})();
