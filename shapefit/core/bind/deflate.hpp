// Numbers that are mostly 0 as a zlib stream (RFC 1950 and 1951), many times faster than zlib: one block
// with the fixed codes, in which runs of 0 are matches at a distance of 1, and all else is literal.
#pragma once

#include "../base/registry.hpp"

namespace shapefit {

struct DeflateData {
    Arguments& from;
    Vector<const uint64_t> numbers = from("numbers", "w");  // fewer than 2^25, little-endian
    Vector<uint64_t> stream = from("stream", "s");  // room for 9 bits a byte and 4 more numbers
};

// Returns the number of bytes of the stream.
long deflate(const DeflateData& data);

}  // namespace shapefit
