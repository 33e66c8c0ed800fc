/**
 * The page at work: its state, what is drawn of it, and what keys, mouse and buttons
 * do to it.
 */
(() => {
    const $ = (id) => document.getElementById(id);
    const AS_AT_FIRST =
        {yaw: 30, pitch: 15, zoom: 1, pan: [0, 0], planeZoom: 1, planePan: [0, 0]};
    const DEGREES_A_PIXEL = 0.5;
    const FIRST_CHART = 'knee angle r';
    const NEAR = 14;  // px from a joint that is meant by a click
    const data = scene.open(JSON.parse($('page').textContent));
    const view = {
        frame: 0,
        ...AS_AT_FIRST,
        joint: null,
        shown:
            new Set(data.layers.filter((layer, i) => i === 0 || !data.layers[0].faces)),
        hidden: new Set(),
        mesh: true,
        whole: false,
        upright: data.rigid,
        pictures: {},
        film: null,
        playing: null,
        drawn: 0,
        projected: {},
    };
    let due = false;

    const recording = () => data.recordingOf(view.frame);
    const time = () => data.timeOf(view.frame);
    const clamp = (value, low, high) => Math.max(low, Math.min(high, value));
    const shown = () => data.layers.filter((layer) => view.shown.has(layer));
    const visible = (frame) => !view.hidden.has(data.sequenceOf(frame));

    /** Change the state and draw it: at most once a frame of the screen. */
    function change(state = {}) {
        Object.assign(view, state);
        if (!due) requestAnimationFrame(() => due && draw());
        due = true;
    }

    /** Draw both panels and the chart, as the state is. */
    function draw() {
        due = false;
        if (data.layers.length) view.projected = space.draw($('space'), data, view);
        // until the film is there, the panel of the image stays as it is
        if (data.flat && (!view.film || view.film.there))
            plane.draw($('plane'), data, view);
        drawChart();
        view.drawn++;
    }

    /** Mark the frame on the chart; its lines are drawn only when they change. */
    function drawChart() {
        const {length, tracks} = recording();
        const sides = chart.LEFT + chart.RIGHT;
        $('marker').style.left =
            `calc(${chart.LEFT}px + (100% - ${sides}px) * ${(time() + 0.5) / length})`;
        $('chart').setAttribute('aria-valuenow', time() + 1);
        const key = [
            tracks[0].start, $('measure').value, $('chart').clientWidth,
            look.text('background'), ...view.hidden, ...shown().map(({name}) => name)
        ].join();
        if (drawChart.key === key) return;
        drawChart.key = key;
        const rows = chartRows();
        const unit = rows[0]?.unit ?? '';
        chart.draw(
            look.pen($('chart')),
            rows.length ? rows : [{values: new Array(length).fill(NaN), states: []}], {
                unit,
                dots: !data.video,
                rate: data.video && data.rate_known && data.frame_rate
            });
    }

    /**
     * The chosen quantity over the recording: a row for each shown layer that has it,
     * and individual.
     */
    function chartRows() {
        return shown().flatMap((layer) => {
            const measure = measureOf(layer, $('measure').value);
            return (measure ? recording().tracks : [])
                .flatMap(
                    ({frames, sequence}, track) => (view.hidden.has(sequence) ? [] : [{
                        unit: measure.unit,
                        tint: look.text(look.colourOf(data, layer, track)),
                        values: Array.from(
                            frames,
                            (frame) => (frame < 0 ? NaN : measure.values[frame])),
                        sd: measure.sd &&
                            Array.from(
                                frames,
                                (frame) => (frame < 0 ? NaN : measure.sd[frame])),
                        states: Array.from(
                            frames,
                            (frame) => (frame < 0 ? '' : stateOf(layer, frame))),
                    }]));
        });
    }

    /**
     * A quantity of a layer by its name; that of a joint is its error bar, the length
     * of its deviations.
     */
    function measureOf(layer, name) {
        const joint = name.startsWith('joint ') ? Number(name.slice(6)) : null;
        if (joint === null) return layer.measures.find((m) => m.name === name);
        if (!layer.sd(0)) return undefined;
        const [unit, many] = data.length;
        const values = Float64Array.from({length: data.count}, (_, frame) => {
            const sd = layer.sd(frame);
            return many *
                Math.hypot(sd[3 * joint], sd[3 * joint + 1], sd[3 * joint + 2]);
        });
        return {values, unit};
    }

    /** "none", "doubtful" or "trusted": what a layer has for a frame. */
    const stateOf = (layer, frame) =>
        (!layer.has(frame)         ? 'none' :
             layer.reason?.(frame) ? 'doubtful' :
                                     'trusted');

    /* Frames. */
    /** Show a frame: its sequence, its picture and film, and what is told of it. */
    function go(frame) {
        const before = data.sequenceOf(view.frame);
        view.frame = clamp(Math.round(frame), 0, data.count - 1);
        if (data.sequenceOf(view.frame) !== before) enterSequence();
        const picture = data.pictures[view.frame];
        if (picture)
            view.pictures[view.frame] ??=
                Object.assign(new Image(), {onload: () => change(), src: picture.data});
        if (!view.playing?.byFilm) view.film?.seek(view.frame);
        clearTimeout(go.telling);
        if (!view.playing) go.telling = setTimeout(tell, 80);
        change();
    }

    /**
     * The frame at another time: of the same individual or, where it is not there, of
     * one that is; where nobody is, that of the next time in steps of `step`.
     */
    function frameAt(wanted, step = 1) {
        const {tracks, length} = recording();
        const own =
            tracks.find(({sequence}) => sequence === data.sequenceOf(view.frame));
        for (let at = clamp(wanted, 0, length - 1); at >= 0 && at < length;
             at += step) {
            const [found] = [own.frames[at], ...scene.framesAt(recording(), at)].filter(
                (frame) => frame >= 0);
            if (found !== undefined) return found;
        }
        return view.frame;
    }

    /** Adapt the chart, the button to play and the ticks to the frame's recording. */
    function enterSequence() {
        const {length} = recording();
        $('chart').setAttribute('aria-valuemin', 1);
        $('chart').setAttribute('aria-valuemax', length);
        $('play').disabled = length < 2;
        fillLayers();
    }

    /**
     * Say in words what is shown, whether it is trusted and why not, and mark it in
     * the list.
     */
    function tell() {
        const {tracks, length} = recording();
        const layers = shown();
        const frames = scene.framesAt(recording(), time())
                           .filter((frame) => visible(frame) || frame === view.frame);
        const named = (layer, frame, text) => {
            const name = tracks.length > 1 ?
                tracks.find(({sequence}) => sequence === data.sequenceOf(frame)).label :
                layers.length > 1 ? layer.name :
                                    '';
            return name && text ? `${name}: ${text}` : text;
        };
        const reasons =
            layers
                .flatMap(
                    (layer) => frames.map(
                        (frame) => named(layer, frame, layer.reason?.(frame))))
                .filter(Boolean);
        $('badge').hidden = !layers.some((layer) => layer.reason);
        $('badge').className = reasons.length ? 'doubtful' : '';
        $('badge').textContent =
            reasons.length ? `doubtful: ${reasons.join('; ')}` : 'trusted';
        const own =
            layers.map((layer) => named(layer, view.frame, describe(layer, view.frame)))
                .filter(Boolean);
        $('told').textContent = [
            data.items[view.frame],
            `${data.video ? 'frame' : 'image'} ${time() + 1} of ${length}`, ...own
        ].join(' · ');
        $('list').value = data.video ? tracks[0].start : view.frame;
    }

    /** The status and the numbers of a frame of a layer, in words. */
    function describe(layer, frame) {
        if (!layer.has(frame)) return layer.role === 'result' ? 'no shape' : '';
        const short = (value) =>
            (Math.abs(value) < 1e-3 && value !== 0 ?
                 value.toExponential(1) :
                 String(Number(value.toPrecision(3))));
        const known =
            layer.measures
                .filter(
                    (m) => (m.unit !== '°' || m.name === $('measure').value) &&
                        Number.isFinite(m.values[frame]))
                .map(
                    (m) => `${m.name} ${short(m.values[frame])}${
                               m.unit === '°' ? '' : ' '}${m.unit}`
                               .trim());
        return [layer.word(frame), ...known].filter(Boolean).join(', ');
    }

    /* Playing. */
    /** Begin to play, or stop; by default the other of what is. */
    function play(on = !view.playing) {
        const isOn = on && data.video && recording().length > 1;
        view.playing = null;
        if (isOn) begin();
        else {
            view.film?.stop();
            go(view.frame);  // the film has gone on, and comes back
            tell();
        }
        $('play').textContent = isOn ? 'Pause' : 'Play';
        $('play').setAttribute('aria-pressed', Boolean(isOn));
    }

    /** Play on from the frame that is shown: by the film, where it has this frame. */
    function begin() {
        const byFilm = Boolean(view.film?.has(view.frame));
        if (byFilm) view.film.seek(view.frame);
        view.playing = {since: performance.now(), from: time(), byFilm};
        view.film?.[byFilm ? 'play' : 'stop'](Number($('speed').value));
        if (!byFilm) requestAnimationFrame(advance);
    }

    /** Without a film, show the frame that is due at a time in ms, again and again. */
    function advance(now) {
        if (!view.playing || view.playing.byFilm) return;
        const passed = (Math.max(0, now - view.playing.since) / 1000) *
            data.frame_rate * Number($('speed').value);
        const frame =
            frameAt((view.playing.from + Math.floor(passed)) % recording().length, -1);
        const isRound = data.timeOf(frame) < time();
        if (frame !== view.frame) go(frame);
        if (isRound && view.film?.has(frame)) return begin();
        requestAnimationFrame(advance);
    }

    /** Play on from the frame that is shown, if the page plays. */
    const restart = () => view.playing && begin();

    /** Show, with a frame of the film that plays, its frame of the page. */
    function follow(place) {
        if (!view.playing?.byFilm) return;
        const {times, last} = placesOf(recording());
        if (place > last) return goRound();
        const at = times.get(place);
        if (at === undefined)
            return;  // nobody is seen, or the frame is not on the page
        const frame = frameAt(at);
        if (frame !== view.frame) go(frame);
        draw();
    }

    /** At the end of the film, play on what it lacks, or begin anew. */
    function goRound() {
        if (!view.playing?.byFilm) return;
        record.running?.stop();
        const next = frameAt(time() + 1);
        if (data.timeOf(next) > time() && !view.film.has(next)) jump(next);
        else jump(frameAt(0));
    }

    /** {times, last}: the times of a recording by frames of the film, and the last. */
    function placesOf(recording) {
        if (recording.places) return recording.places;
        const times = new Map();
        for (let at = 0; at < recording.length; at++) {
            const [frame] = scene.framesAt(recording, at);
            if (frame !== undefined && view.film.has(frame))
                times.set(view.film.placeOf(frame), at);
        }
        return (recording.places = {times, last: Math.max(...times.keys())});
    }

    /** Go to a frame as the user asks; playing goes on from there. */
    function jump(frame) {
        go(frame);
        restart();
    }

    /** Go to the first frame of the sequence that is `step` further in the list. */
    const jumpSequence = (step) =>
        jump(data
                 .sequences[clamp(
                     data.sequenceOf(view.frame) + step, 0, data.sequences.length - 1)]
                 .start);

    /** Go to the next frame that is not trusted, if there is one. */
    function jumpDoubtful() {
        const isUntrusted = (frame) =>
            visible(frame) && shown().some((layer) => layer.reason?.(frame));
        jump(scene.nextUntrusted(data, view.frame, isUntrusted) ?? view.frame);
    }

    /* The camera. */
    /** Turn the view in 3D by degrees. */
    const turn = (yaw, pitch) =>
        change({yaw: view.yaw + yaw, pitch: clamp(view.pitch + pitch, -90, 90)});

    /** Magnify the panel in 3D, or by `planeZoom` that of the image. */
    const zoom = (factor, name = 'zoom') =>
        change({[name]: clamp(view[name] * factor, 0.05, 50)});

    /**
     * Call dragged(dx, dy, moving) for each step of a drag in px, pointed(x, y,
     * clicked) without one, and zoomed(factor) for the wheel.
     */
    function listen(canvas, dragged, zoomed, pointed = () => {}) {
        let [last, far] = [null, 0];
        canvas.addEventListener('pointerdown', (event) => {
            [last, far] = [[event.clientX, event.clientY], 0];
            canvas.setPointerCapture(event.pointerId);
        });
        canvas.addEventListener('pointermove', (event) => {
            if (!last) return pointed(event.offsetX, event.offsetY, false);
            const [dx, dy] = [event.clientX - last[0], event.clientY - last[1]];
            far += Math.abs(dx) + Math.abs(dy);
            dragged(dx, dy, event.shiftKey || event.buttons === 2);
            last = [event.clientX, event.clientY];
        });
        canvas.addEventListener('pointerup', (event) => {
            if (last && far < 4) pointed(event.offsetX, event.offsetY, true);
            last = null;
        });
        canvas.addEventListener('pointercancel', () => (last = null));
        canvas.addEventListener('contextmenu', (event) => event.preventDefault());
        canvas.addEventListener('wheel', (event) => {
            event.preventDefault();
            zoomed(Math.exp(-0.0015 * event.deltaY));
        }, {passive: false});
    }

    /**
     * Name the joint at a place of the 3D panel; a click makes the chart show its
     * error bar.
     */
    function pointAt(x, y, clicked) {
        const [places = []] = Object.values(view.projected);
        const away = places.map((place) => Math.hypot(place[0] - x, place[1] - y));
        const nearest = away.reduce(
            (best, value, j) => (value < (away[best] ?? NEAR) ? j : best), null);
        if (nearest !== view.joint) change({joint: nearest});
        if (!clicked || nearest === null || !data.layers.some((layer) => layer.sd(0)))
            return;
        $('of-joint')?.remove();
        const option = Object.assign(
            new Option(`error bar of ${data.landmarks[nearest]}`, `joint ${nearest}`),
            {id: 'of-joint'});
        $('measure').append(option);
        $('measure').value = option.value;
        $('measure-label').hidden = false;
    }

    const moved = (pan, dx, dy) => [pan[0] + dx, pan[1] + dy];
    listen($('space'), (dx, dy, moving) => {
        if (moving) change({pan: moved(view.pan, dx, dy)});
        else turn(DEGREES_A_PIXEL * dx, DEGREES_A_PIXEL * dy);
    }, zoom, pointAt);
    listen(
        $('plane'), (dx, dy) => change({planePan: moved(view.planePan, dx, dy)}),
        (factor) => zoom(factor, 'planeZoom'));

    /* Pictures and videos of the panels. */
    /** Draw the panels, side by side, into a canvas, which is returned. */
    function paint(target) {
        const panels =
            [data.layers.length && $('space'), data.flat && $('plane')].filter(Boolean);
        // even, as films have to be
        const even = (length) => 2 * Math.ceil(length / 2);
        target.width = even(panels.reduce((sum, {width}) => sum + width, 0));
        target.height = even(Math.max(...panels.map(({height}) => height)));
        const context = target.getContext('2d');
        context.fillStyle = look.text('background');
        context.fillRect(0, 0, target.width, target.height);
        panels.reduce(
            (left, panel) => (context.drawImage(panel, left, 0), left + panel.width),
            0);
        return target;
    }

    /** Save a blob as a file that is named after the page. */
    function download(blob, ending) {
        const link = Object.assign(
            document.createElement('a'),
            {href: URL.createObjectURL(blob), download: `${document.title}.${ending}`});
        link.click();
        setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    }

    /**
     * Record what is shown, once through the sequence or until the key is pressed
     * again.
     */
    function record() {
        if (record.running) return record.running.stop();
        const canvas = paint(document.createElement('canvas'));
        const recorder =
            (record.running =
                 new MediaRecorder(canvas.captureStream(30), {mimeType: 'video/webm'}));
        recorder.ondataavailable = (event) => download(event.data, 'webm');
        recorder.onstop = () => (record.running = null);
        recorder.start();
        jump(frameAt(0));
        play(true);
        const end = performance.now() +
            (1000 * recording().length) / (data.frame_rate * Number($('speed').value));
        // a film says itself when it is over
        const copy = (now) => {
            if (!record.running) return;
            paint(canvas);
            if (now > end && !view.playing?.byFilm) recorder.stop();
            else requestAnimationFrame(copy);
        };
        requestAnimationFrame(copy);
        return recorder;
    }

    /* Keys. */
    /** Go `count` times on, or back where it is negative. */
    const step = (count) => jump(frameAt(time() + count, Math.sign(count)));
    const KEYS = {
        ' ': () => play(),
        d: jumpDoubtful,
        0: () => change(AS_AT_FIRST),
        1: () => change({yaw: 0, pitch: 0}),
        2: () => change({yaw: -90, pitch: 0}),
        3: () => change({yaw: 0, pitch: 90}),
        '+': () => zoom(1.2),
        '=': () => zoom(1.2),
        '-': () => zoom(1 / 1.2),
        home: () => jump(frameAt(0)),
        end: () => jump(frameAt(recording().length - 1, -1)),
        arrowleft: (shift) => step(shift ? -10 : -1),
        arrowright: (shift) => step(shift ? 10 : 1),
        arrowup: () => jumpSequence(-1),
        arrowdown: () => jumpSequence(1),
        s: () => paint(document.createElement('canvas'))
                     .toBlob((blob) => download(blob, 'png')),
        r: record,
    };
    const TURNS =
        {arrowleft: [-5, 0], arrowright: [5, 0], arrowup: [0, -5], arrowdown: [0, 5]};

    document.addEventListener('keydown', (event) => {
        const {target} = event;
        const key = event.key.toLowerCase();
        if (event.ctrlKey || event.metaKey || target.tagName === 'SELECT') return;
        if (key === ' ' && ['BUTTON', 'INPUT', 'SUMMARY'].includes(target.tagName))
            return;
        const action =
            event.altKey && TURNS[key] ? () => turn(...TURNS[key]) : KEYS[key];
        if (!action) return;
        event.preventDefault();
        action(event.shiftKey);
    });

    /* Controls. */
    /**
     * The label with a tick box for a layer or an individual; changed(checked) is
     * called when the user changes it.
     */
    function choice(colour, text, shorter, checked, changed) {
        const [row, box, patch, name] =
            ['label', 'input', 'i', 'bdi'].map((tag) => document.createElement(tag));
        Object.assign(box, {type: 'checkbox', checked});
        box.addEventListener('change', () => {
            changed(box.checked);
            tell();
            change();
        });
        patch.style.background = `var(--${colour})`;
        [name.textContent, row.title] = [shorter, text];
        row.append(box, patch, name);
        return row;
    }

    /**
     * Make tick boxes for several layers, and for several individuals; the one whose
     * frames are shown stays.
     */
    function fillLayers() {
        const {tracks} = recording();
        const names = scene.short(data.layers.map(({name}) => name));
        const layers = data.layers.length < 2 ?
            [] :
            data.layers.map(
                (layer, i) => (choice(
                    look.colourOf(data, layer, 0), layer.name, names[i],
                    view.shown.has(layer),
                    (on) => view.shown[on ? 'add' : 'delete'](layer))));
        const individuals = tracks.length < 2 ?
            [] :
            tracks.map(
                ({label, sequence}, track) => (choice(
                    look.colourOf(data, data.layers[0] ?? {}, track), label, label,
                    !view.hidden.has(sequence),
                    (on) => view.hidden[on ? 'delete' : 'add'](sequence))));
        $('layers').replaceChildren(...layers, ...individuals);
    }

    /**
     * Fill the drop-down list: recordings of videos, else images, by names that differ
     * where they are read.
     */
    function fillList() {
        const frames = data.video ? data.recordings.map(({tracks}) => tracks[0].start) :
                                    data.items.map((_, frame) => frame);
        const whole = frames.map(
            (frame) => (data.video ? data.sequences[data.sequenceOf(frame)].name :
                                     data.items[frame]) ||
                'all frames');
        const names = scene.short(whole);
        $('list').replaceChildren(...frames.map(
            (frame, i) =>
                Object.assign(new Option(names[i], frame), {title: whole[i]})));
        $('list').hidden = frames.length < 2;
    }

    /** Hide what this page has no use for. */
    function hideTheRest() {
        const measures = data.layers.flatMap((layer) => layer.measures);
        const units = Object.fromEntries(measures.map((m) => [m.name, m.unit]));
        $('measure').append(...Object.entries(units).map(
            ([name, unit]) => new Option(unit ? `${name} (${unit})` : name, name)));
        if (FIRST_CHART in units) $('measure').value = FIRST_CHART;
        const results = data.layers.filter((layer) => layer.role === 'result');
        const has = {
            play: data.video,
            speed: data.video,
            time: data.count > 1,
            'measure-label': measures.length,
            doubtful: results.some((layer) => layer.reason),
            flat: data.flat,
            'whole-choice':
                data.image || data.film || Object.keys(data.pictures).length,
            solid: data.layers.length,
            sides: data.sides && !data.layers[0]?.faces,
            'mesh-choice': results.some((layer) => layer.faces),
            'upright-choice': !data.video && results.some((layer) => layer.pose(0)),
            'key-observed': data.observed(0),
            'key-hidden': results.length && data.observed(0),
            'key-residual': results.length && data.observed(0),
            'key-outlier': data.outliers(0).length,
            'key-bars': data.layers.some((layer) => layer.sd(0)),
        };
        for (const [id, there] of Object.entries(has)) $(id).hidden = !there;
        $('upright').checked = view.upright;
        $('doubtful').disabled =
            !results.some((layer) => layer.reasons?.words.some(Boolean));
    }

    const on = (id, event, act) => $(id).addEventListener(event, act);
    on('list', 'change', () => {
        jump(Number($('list').value));
        $('list').blur();  // the keys are the page's again
    });
    on('speed', 'change', restart);
    on('measure', 'change', () => change());
    const scrub = (event) => {
        const box = $('chart').getBoundingClientRect();
        jump(frameAt(
            chart.timeAt(event.clientX - box.left, box.width, recording().length)));
    };
    on('chart', 'pointerdown', (event) => {
        $('chart').setPointerCapture(event.pointerId);
        scrub(event);
    });
    on('chart', 'pointermove', (event) => event.buttons && scrub(event));
    for (const key of ['mesh', 'upright', 'whole'])
        on(key, 'change', () => change({[key]: $(key).checked}));
    for (const button of document.querySelectorAll('[data-key]'))
        button.addEventListener('click', () => KEYS[button.dataset.key]());
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => {
        look.restyle();
        change();
    });
    window.addEventListener('resize', () => change());
    window.addEventListener('hashchange', followLink);

    /**
     * Go to the item that the address names, page.html#item=NAME; returns whether there
     * is one.
     */
    function followLink() {
        const item = new URLSearchParams(location.hash.slice(1)).get('item');
        const frame = item === null ? -1 : data.items.indexOf(item);
        if (frame >= 0) jump(frame);
        return frame >= 0;
    }

    /** What the page shows, for scripts and tests. */
    window.shapefit = {
        data,
        view,
        get item() { return data.items[view.frame]; },
        layer: (name) => data.layers.find((layer) => layer.name === name),
        chart: () => chartRows(),
        go: jump,
        paint: () => paint(document.createElement('canvas')),
    };

    /** Open the film of the page; a note says so where the browser cannot play it. */
    function openFilm() {
        const noted = 'This browser does not play the film; all play H.264 in MP4.';
        view.film = film.open(data.film, {
            arrived: () => change(),
            passed: follow,
            ended: goRound,
            failed: () => {
                view.film = null;
                $('notes').append(
                    Object.assign(document.createElement('li'), {textContent: noted}));
                restart();
                change();
            }
        });
    }

    if (data.film) openFilm();
    hideTheRest();
    fillList();
    enterSequence();
    const linked = followLink();
    if (!linked) go(0);
    if (!linked && !matchMedia('(prefers-reduced-motion: reduce)').matches) play(true);
})();
