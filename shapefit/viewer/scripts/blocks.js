'use strict';
/**
 * Blocks of numbers in the page: base64 text in, one row at a time out.
 *
 * A block is {type, shape: [rows, ...], data}. One of points has `places`, too: for
 * each row the offset of each axis and a scale; value = offset + scale * code, and the
 * code -32768 is a missing value (NaN). All numbers are little-endian.
 */
const blocks = (() => {
    const TYPES = {
        i2: Int16Array,
        f4: Float32Array,
        u1: Uint8Array,
        u2: Uint16Array,
        u4: Uint32Array
    };
    const MISSING = -32768;

    /** All numbers of a block as a typed array. */
    function numbers(block) {
        return new TYPES[block.type](
            Uint8Array.from(atob(block.data), (letter) => letter.charCodeAt(0)).buffer);
    }

    /**
     * The function from an index to that row of a block, a Float64Array with NaN where
     * a value is missing.
     */
    function rows(block) {
        const size =
            block.shape.slice(1).reduce((product, length) => product * length, 1);
        const [codes, places, d] =
            [numbers(block), block.places && numbers(block.places), block.shape.at(-1)];
        return (index) => {
            const values =
                Float64Array.from(codes.subarray(index * size, (index + 1) * size));
            if (!places) return values;
            const place = places.subarray(index * (d + 1), (index + 1) * (d + 1));
            return values.map(
                (code, i) => (code === MISSING ? NaN : place[i % d] + place[d] * code));
        };
    }

    /** A URL of bytes that the page holds: {kind, a media type, data, in base64}. */
    function address({kind, data}) {
        const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
        return URL.createObjectURL(new Blob([bytes], {type: kind}));
    }

    return {numbers, rows, address};
})();
