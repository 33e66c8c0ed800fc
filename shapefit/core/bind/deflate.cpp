// Numbers that are mostly 0 as a zlib stream (RFC 1950 and 1951), many times faster than zlib: one block
// with the fixed codes, in which runs of 0 are matches at a distance of 1, and all else is literal.
#include "../base/registry.hpp"

#include <array>

namespace shapefit {

struct DeflateData {
    Arguments& from;
    Vector<const uint64_t> numbers = from("numbers", "w");  // fewer than 2^25, little-endian
    Vector<uint64_t> stream = from("stream", "s");  // room for 9 bits a byte and 4 more numbers
};

namespace {

constexpr int LONGEST = 258, SHORTEST = 3;  // bytes of a match
constexpr uint64_t ADLER = 65521;
constexpr int ZERO_BYTES = sizeof(uint64_t);

// Bits as they enter the stream, the lowest first.
struct Code {
    uint32_t bits = 0;
    int count = 0;
};

// Huffman codes enter with their highest bit first.
constexpr Code huffman(uint32_t value, int count) {
    Code code{0, count};
    for (int b = 0; b < count; ++b) code.bits |= (value >> b & 1) << (count - 1 - b);
    return code;
}

constexpr Code symbol_code(uint32_t symbol) {
    if (symbol < 144) return huffman(0x30 + symbol, 8);
    if (symbol < 256) return huffman(0x190 + symbol - 144, 9);
    return symbol < 280 ? huffman(symbol - 256, 7) : huffman(0xc0 + symbol - 280, 8);
}

// The length, its further bits, and five bits of 0 for the distance 1.
constexpr Code match_code(int length) {
    uint32_t symbol = 257;
    int base = SHORTEST, further = 0;
    while (length < LONGEST && length >= base + (1 << further)) {
        base += 1 << further;
        ++symbol;
        further = symbol < 265 ? 0 : static_cast<int>(symbol - 261) / 4;
    }
    if (length == LONGEST) symbol = 285, base = LONGEST, further = 0;
    Code code = symbol_code(symbol);
    code.bits |= static_cast<uint32_t>(length - base) << code.count;
    code.count += further + 5;
    return code;
}

constexpr auto LITERALS = [] {
    std::array<Code, 256> codes;
    for (uint32_t byte = 0; byte < 256; ++byte) codes[byte] = symbol_code(byte);
    return codes;
}();
constexpr auto MATCHES = [] {
    std::array<Code, LONGEST + 1> codes;
    for (int length = SHORTEST; length <= LONGEST; ++length) codes[length] = match_code(length);
    return codes;
}();

class BitWriter {
  public:
    explicit BitWriter(uint64_t* out) : out_(out) {}

    void put(Code code) { put(code.bits, code.count); }

    // At most 63 bits.
    void put(uint64_t bits, int count) {
        word_ |= bits << used_;
        used_ += count;
        if (used_ < 64) return;
        out_[words_++] = word_;
        used_ -= 64;
        word_ = bits >> (count - used_);
    }

    void fill_byte() { put({0, (8 - used_ % 8) % 8}); }

    long end() {
        out_[words_] = word_;
        return 8 * words_ + used_ / 8;
    }

  private:
    uint64_t* out_;
    uint64_t word_ = 0;
    int used_ = 0;
    long words_ = 0;
};

void put_zeros(BitWriter& writer, long bytes) {
    writer.put(LITERALS[0]);
    for (--bytes; bytes >= SHORTEST;) {
        const long length = bytes < LONGEST ? bytes : LONGEST;
        writer.put(MATCHES[length]);
        bytes -= length;
    }
    for (; bytes > 0; --bytes) writer.put(LITERALS[0]);
}

// The bytes of a number as they are, four codes at a time.
void put_number(BitWriter& writer, uint64_t number) {
    for (int half = 0; half < 2; ++half) {
        uint64_t bits = 0;
        int count = 0;
        for (int b = 0; b < ZERO_BYTES / 2; ++b, number >>= 8) {
            const Code code = LITERALS[number & 0xff];
            bits |= static_cast<uint64_t>(code.bits) << count;
            count += code.count;
        }
        writer.put(bits, count);
    }
}

}  // namespace

// Returns the number of bytes of the stream.
long deflate(const DeflateData& data) {
    BitWriter writer(data.stream.data);
    writer.put({0x0178, 16});    // the header of zlib: the least effort
    writer.put({1 | 1 << 1, 3});  // the last block, with the fixed codes
    const long count = data.numbers.size[0];
    uint64_t first = 1, second = 0;  // of the checksum, whose remainders are taken at the end
    for (long i = 0; i < count;) {
        if (data.numbers[i] == 0) {
            const long start = i;
            while (i < count && data.numbers[i] == 0) ++i;
            put_zeros(writer, ZERO_BYTES * (i - start));
            second += first * ZERO_BYTES * static_cast<uint64_t>(i - start);
            continue;
        }
        put_number(writer, data.numbers[i]);
        for (uint64_t rest = data.numbers[i++], b = 0; b < ZERO_BYTES; ++b, rest >>= 8)
            second += first += rest & 0xff;
    }
    writer.put(symbol_code(256));
    writer.fill_byte();
    for (const uint64_t sum : {second % ADLER, first % ADLER}) {
        writer.put({static_cast<uint32_t>(sum >> 8), 8});
        writer.put({static_cast<uint32_t>(sum & 0xff), 8});
    }
    return writer.end();
}

const Exported<deflate> deflate_exported{"deflate"};

}  // namespace shapefit
