/**
 * The film under the landmarks. While it plays it is the clock; else it is taken to the
 * frame that is shown.
 */
const film = (() => {
    // Places in a frame that are sought one after the other, as shares of its time:
    // a browser that does not know how long a frame lasts may show the one beside it.
    const SOUGHT = [0.5, 0.9, 0.1, 0.98];
    const PATIENCE = 300;  // ms after which a frame that nothing is told of is taken
    const GRABS = 3;       // of a picture, until the film does not go on meanwhile

    /**
     * Open the film of a page.
     *
     * `starts` are the seconds at which its frames begin, and its end; `places` which
     * of them each frame of the page is, NaN for none. arrived() is called when the
     * frame that was sought is there, passed(place) for each frame that it shows while
     * it plays, ended() after the last, and failed() where the browser cannot play it.
     */
    function open(source, {arrived, passed, ended, failed}) {
        const [starts, places] = [source.starts, source.places].map(blocks.numbers);
        // what was shown when the frame was told: the film itself plays on
        const still = document.createElement('canvas');
        let wanted = null;      // its frame that is sought, null where it is there
        let attempt = 0;        // of SOUGHT
        let isOutside = false;  // it has no frame for that of the page
        let waiting = 0;        // timer of PATIENCE
        let isKept = false;     // something has been shown

        const video = Object.assign(document.createElement('video'), {
            muted: true,
            playsInline: true,
            preload: 'auto',
            src: blocks.address(source)
        });
        const has = (frame) => Number.isFinite(places[frame]);

        /** Take the film to its frame that goes with a frame of the page. */
        function seek(frame) {
            isOutside = !has(frame);
            if (isOutside) return;
            const isOnItsWay = wanted !== null && video.seeking;
            [wanted, attempt] = [places[frame], 0];
            if (!isOnItsWay) set();
        }

        /** Set the time of the film to the next place to try in the wanted frame. */
        function set() {
            clearTimeout(waiting);
            const [start, next] = [starts[wanted], starts[wanted + 1]];
            video.currentTime = start + SOUGHT[attempt] * (next - start);
        }

        /** Arrive if the film shows the wanted frame; else try another place in it. */
        function take(place) {
            if (place === wanted) return arrive();
            const isBeside = video.currentTime >= starts[wanted] &&
                video.currentTime < starts[wanted + 1];
            // another may have been wanted on the way
            attempt = isBeside ? attempt + 1 : 0;
            if (attempt < SOUGHT.length) set();
            else arrive();
        }

        /** Tell the page that the wanted frame is there. */
        function arrive() {
            clearTimeout(waiting);
            wanted = null;
            arrived();
        }

        video.addEventListener('seeked', () => {
            if (wanted === null) return;
            const place = keep(null);
            if (place === wanted) return arrive();
            clearTimeout(waiting);
            waiting = setTimeout(() => wanted !== null && take(keep(wanted)), PATIENCE);
        });
        video.addEventListener('error', failed);
        video.addEventListener('ended', ended);

        /** Copy each frame that the browser shows: it is passed, or the wanted one. */
        function follow(_, {mediaTime}) {
            video.requestVideoFrameCallback(follow);
            if (wanted === null && video.paused) return;
            const place = keep(placeAt(starts, mediaTime));
            if (place === null) return;
            if (wanted === null) passed(place);
            else if (!video.seeking) take(place);
        }
        video.requestVideoFrameCallback(follow);

        /**
         * Copy what the film shows; returns which of its frames that is, `told` where
         * the browser does not say, null where it shows nothing.
         */
        function keep(told) {
            if (video.readyState < 2) return null;
            const {videoWidth: width, videoHeight: height} = video;
            if (still.width !== width || still.height !== height)
                Object.assign(still, {width, height});
            let time = null;
            for (let grab = 0; grab < GRABS; grab++) {
                time = timeOf(video);
                still.getContext('2d').drawImage(video, 0, 0);
                if (timeOf(video) === time) break;
            }
            isKept = true;
            return time === null ? told : placeAt(starts, time);
        }

        return {
            still,
            seek,
            has,
            /** Which of its frames one of the page is, NaN for none. */
            placeOf: (frame) => places[frame],
            play(speed) {
                video.playbackRate = speed;
                // one that is stopped before it began says so
                video.play().catch(() => {});
            },
            stop: () => video.pause(),
            get ready() { return isKept && !isOutside; },
            get there() { return wanted === null; }
        };
    }

    /**
     * The time in seconds of the frame that a film shows, null where the browser does
     * not say: it may not know the class, or be between two frames.
     */
    function timeOf(video) {
        if (!window.VideoFrame) return null;
        try {
            const frame = new VideoFrame(video);
            const {timestamp} = frame;
            frame.close();
            return timestamp / 1e6;
        } catch {
            return null;
        }
    }

    /** The index of the frame whose start is nearest to a time in seconds. */
    function placeAt(starts, seconds) {
        let [low, high] = [0, starts.length - 2];
        while (low < high) {
            const middle = Math.ceil((low + high) / 2);
            if ((starts[middle - 1] + starts[middle]) / 2 <= seconds) low = middle;
            else high = middle - 1;
        }
        return low;
    }

    return {open, placeAt};
})();
