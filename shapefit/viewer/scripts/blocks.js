"use strict";
/**
 * Blocks of numbers in the page: base64 text in, one row at a time out.
 *
 * A block is {type, shape: [rows, ...], data} with, for `i2`, value = offset[axis] + scale * code;
 * the code -32768 stands for a missing value (NaN). `bf` holds the upper half of each 32-bit
 * float. All numbers are little-endian.
 */
const blocks = (() => {
  const TYPES = { i2: Int16Array, f4: Float32Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array, bf: Uint16Array };
  const MISSING = -32768;

  function bytesOf(base64) {
    const text = atob(base64);
    const bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    return bytes;
  }

  /** All numbers of a block of type f4, u1, u2, u4 or bf, as a typed array. */
  function numbers(block) {
    const codes = new TYPES[block.type](bytesOf(block.data).buffer);
    if (block.type !== "bf") return codes;
    const wide = new Uint32Array(codes.length);
    for (let i = 0; i < codes.length; i++) wide[i] = codes[i] << 16;
    return new Float32Array(wide.buffer);
  }

  /** {count, row(i)}: each row as a Float64Array, NaN where a value is missing. */
  function open(block) {
    const size = block.shape.slice(1).reduce((product, length) => product * length, 1);
    const axes = block.shape[block.shape.length - 1];
    const codes = numbers(block);
    const scaled = block.type === "i2";

    function row(index) {
      const values = new Float64Array(size);
      for (let i = 0, at = index * size; i < size; i++, at++) {
        const code = codes[at];
        if (!scaled) values[i] = code;
        else values[i] = code === MISSING ? NaN : block.offset[i % axes] + block.scale * code;
      }
      return values;
    }
    return { count: block.shape[0], row };
  }

  /** Whether bit `index` of a row of packed bits (least significant first) is set. */
  function bit(bytes, index) {
    return ((bytes[index >> 3] >> (index & 7)) & 1) === 1;
  }

  return { numbers, open, bit };
})();
if (typeof module !== "undefined") module.exports = blocks;
