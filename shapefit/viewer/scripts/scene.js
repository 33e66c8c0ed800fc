/**
 * What the page shows, read from its JSON: frames, recordings, layers (results,
 * truth), pictures.
 */
const scene = (() => {
    const LOOKED_AT = 200;  // frames of a recording, evenly spread, that tell its size
    const LONG = 24;        // letters of a name that fit into the list

    /**
     * The scene of the page's JSON, with functions of a frame in place of its blocks.
     *
     * A recording has a row of frames for each of its tracks, one individual each, -1
     * where it is not there: tracks[i].frames[time]. A sequence that is alone is a
     * recording of one track.
     */
    function open(page) {
        const count = page.items.length;
        const sequences = page.sequences.map(
            ([name, start], i) =>
                ({name, start, end: page.sequences[i + 1]?.[1] ?? count}));
        const [owners, homes] = [
            new Uint32Array(count), new Uint32Array(count)
        ];  // sequence and recording of frames
        sequences.forEach(({start, end}, i) => owners.fill(i, start, end));
        const times = blocks.numbers(page.times);
        const recordings = page.recordings.map((members, home) => {
            const labels =
                short(members.map((i) => sequences[i].name.split('/').pop()), 0);
            const tracks = members.map(
                (i, m) => ({...sequences[i], label: labels[m], sequence: i}));
            const length = 1 +
                Math.max(...tracks.map(
                    ({start, end}) =>
                        times.subarray(start, end).reduce((a, b) => Math.max(a, b))));
            for (const track of tracks) {
                homes.fill(home, track.start, track.end);
                track.frames = new Int32Array(length).fill(-1);
                for (let frame = track.start; frame < track.end; frame++)
                    track.frames[times[frame]] = frame;
            }
            return {tracks, length};
        });
        const meshes = page.meshes.map(({vertices, faces}) => {
            const row = blocks.rows(vertices);
            return {
                atoms: Array.from({length: vertices.shape[0]}, (_, i) => row(i)),
                faces: Uint32Array.from(blocks.numbers(faces))
            };
        });
        const data = {
            ...page,
            count,
            sequences,
            recordings,
            sequenceOf: (frame) => owners[frame],
            groundOf: (frame) => page.grounds[owners[frame]],
            recordingOf: (frame) => recordings[homes[frame]],
            timeOf: (frame) => times[frame],
            observed: page.observed ? blocks.rows(page.observed) : () => null,
            outliers: page.outliers ? blocks.rows(page.outliers) : () => [],
            layers: page.layers.map((layer) => openLayer(layer, meshes)),
        };
        data.size = (recording) =>
            (recording.size ??=
                 sizeOf(data, recording, page.grounds[recording.tracks[0].sequence]));
        return data;
    }

    /** The frames of all individuals at a time of a recording. */
    function framesAt(recording, time) {
        return recording.tracks.map(({frames}) => frames[time])
            .filter((frame) => frame >= 0);
    }

    /**
     * {solid, flat, path}: extents that hold 95% of the frames of a recording, in space
     * and in the image, so that all are shown in one scale; 0 for frames that are no
     * sequence. path is the box of all its landmarks in the image, null for none.
     */
    function sizeOf(data, recording, {upright}) {
        if (!data.video) return {solid: [0, 0], flat: [0, 0], path: null};
        const [solid, flat] = [[], []];
        for (let time = 0; time < recording.length;
             time += Math.max(1, Math.floor(recording.length / LOOKED_AT))) {
            const frames = framesAt(recording, time);
            const whole = (rows) => frames.flatMap(
                (frame) => rows.flatMap((row) => Array.from(row(frame) ?? [])));
            solid.push(geometry.box(
                geometry.turn(whole(data.layers.map(({points}) => points)), upright),
                3));
            flat.push(geometry.box(whole([data.observed]), 2));
        }
        const most = (boxes) => [0, 1].map((axis) => {
            const known = boxes.filter(Boolean)
                              .map(({extent}) => extent[axis])
                              .sort((a, b) => a - b);
            return known[Math.floor(0.95 * known.length)] ?? 0;
        });
        return {solid: most(solid), flat: most(flat), path: around(flat)};
    }

    /** The box around boxes, of which some may be null; null where all are. */
    function around(boxes) {
        const corners = boxes.filter(Boolean).flatMap(
            ({middle, extent}) => [-1, 1].flatMap(
                (side) => middle.map((at, axis) => at + side * extent[axis])));
        return geometry.box(corners, 2);
    }

    /** A layer of the page, with functions of a frame in place of its blocks. */
    function openLayer(layer, meshes) {
        const row = (name) => (layer[name] ? blocks.rows(layer[name]) : () => null);
        const [points, pose, camera, fitted, sd] =
            ['points', 'pose', 'camera', 'fitted', 'sd'].map(row);
        return {
            ...layer,
            points,
            pose,
            camera,
            fitted,
            sd,
            mesh: layer.blend ?
                openBlend(layer.blend, meshes[layer.blend.mesh_set], pose) :
                () => null,
            faces: layer.blend ? meshes[layer.blend.mesh_set].faces : null,
            inImage: (frame, values) => camera(frame) &&
                geometry.project(values, camera(frame), layer.perspective),
            magnification: (frame, depth) =>
                geometry.magnification(camera(frame), layer.perspective, depth),
            has: (frame) => points(frame).some(Number.isFinite),
            measures:
                layer.measures.map((measure) => ({
                                       ...measure,
                                       values: blocks.numbers(measure.values),
                                       sd: measure.sd && blocks.numbers(measure.sd)
                                   })),
            word: layer.status ? openWords(layer.status) : () => '',
            reason: layer.reasons ? openWords(layer.reasons) : null,
        };
    }

    /**
     * The function from a frame to its blended vertices, null where it has none.
     */
    function openBlend({start, atom, weight}, mesh, pose) {
        const [starts, atoms, weights] = [start, atom, weight].map(blocks.numbers);
        return (frame) => {
            const used = [];
            for (let i = starts[frame]; i < starts[frame + 1]; i++)
                used.push([atoms[i], weights[i]]);
            return used.length ? geometry.blend(mesh.atoms, used, pose(frame)) : null;
        };
    }

    /** The function from a frame to its text, of texts that were encoded. */
    function openWords({words, codes}) {
        const numbers = blocks.numbers(codes);
        return (frame) => words[numbers[frame]];
    }

    /**
     * Names, shortened so that they differ where they are read: those longer than
     * `long` without the words that all begin with, or without the letters where there
     * are no such words; what is too long still is shown by both its ends.
     */
    function short(names, long = LONG) {
        if (names.length > 1 && names.some(({length}) => length > long)) {
            let same = 0;
            while (names.every(
                (name) => same < name.length && name[same] === names[0][same]))
                same++;
            const words = [...names[0].slice(0, same).matchAll(/[/_ -]/g)].map(
                ({index}) => index + 1);
            const kept =
                words.findLast(
                    (end) => names.every((name) => /[a-z]/i.test(name.slice(end)))) ??
                (long && names.every(({length}) => length > same) ? same : 0);
            names = names.map(
                (name) => (kept && long ? `…${name.slice(kept)}` : name.slice(kept)));
        }
        const cut = names.map(
            (name) =>
                (name.length <= LONG ? name :
                                       `${name.slice(0, 8)}…${name.slice(9 - LONG)}`));
        return new Set(cut).size < new Set(names).size ? names : cut;
    }

    /**
     * The first frame after `from`, over all recordings and going round, in which
     * `isUntrusted` holds; null for none.
     */
    function nextUntrusted(data, from, isUntrusted) {
        const moments = data.recordings.flatMap(
            (recording) => Array.from(
                {length: recording.length}, (_, time) => framesAt(recording, time)));
        const next = 1 + moments.findIndex((frames) => frames.includes(from));
        return [...moments.slice(next), ...moments.slice(0, next)].flat().find(
                   isUntrusted) ??
            null;
    }

    return {open, framesAt, short, nextUntrusted};
})();
