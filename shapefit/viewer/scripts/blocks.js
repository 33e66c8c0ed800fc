"use strict";
/**
 * Blocks of numbers in the page: base64 text in, one row at a time out.
 *
 * A block is {type, shape: [rows, ...], data}. One of points has `places`, too: for each row the
 * offset of each axis and a scale; value = offset + scale * code, and the code -32768 is a missing
 * value (NaN). All numbers are little-endian.
 */
const blocks = (() => {
  const TYPES = { i2: Int16Array, f4: Float32Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array };
  const MISSING = -32768;

  /** All numbers of a block as a typed array. */
  function numbers(block) {
    const text = atob(block.data);
    const bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    return new TYPES[block.type](bytes.buffer);
  }

  /** {count, row(i)}: each row as a Float64Array, NaN where a value is missing. */
  function open(block) {
    const [count, ...axes] = block.shape;
    const size = axes.reduce((product, length) => product * length, 1);
    const codes = numbers(block);
    const places = block.places && numbers(block.places);
    const dimensions = axes.at(-1);

    function row(index) {
      const values = Float64Array.from(codes.subarray(index * size, (index + 1) * size));
      if (!places) return values;
      const place = places.subarray(index * (dimensions + 1), (index + 1) * (dimensions + 1));
      return values.map((code, i) => (code === MISSING ? NaN : place[i % dimensions] + place[dimensions] * code));
    }
    return { count, row };
  }

  return { numbers, open };
})();
