// Rows of a table as text with commas: cells of text as they stand, numbers with the
// fewest digits that read back to the same double.
#include "../base/registry.hpp"

#include <charconv>
#include <cmath>
#include <cstring>

namespace shapefit {

// The texts and numbers of the rows of a table.
struct CsvRowsData {
    Arguments& from;
    // of the texts, one after another
    Vector<const uint64_t> letters = from("letters", "w");
    // of each text, and the end of the last
    Vector<const int64_t> starts = from("starts", "1+t");
    // of each row, by their numbers
    Matrix<const int64_t> texts = from("texts", "n c");
    Matrix<const double> numbers = from("numbers", "n d");  // nan is an empty cell
    // texts of a row before its numbers; the others follow them
    Index leading = from("leading");
    bool as_python = from("as_python");  // as `repr` has numbers; else as orjson
    // memory for all texts, commas, 25 bytes a number
    Vector<uint64_t> rows = from("rows", "s");
};

namespace {

// Magnitudes between which a number is written without an exponent.
constexpr double MIN_PLAIN_IN_PYTHON = 1e-4, MIN_PLAIN_IN_JSON = 1e-5, MAX_PLAIN = 1e16;

constexpr int ROOM = 25;  // for "-0.000012345678901234567"

// Write a number without an exponent, "2.0" for 2; return the end of its text.
char* put_plain(char* out, double number) {
    out = std::to_chars(out, out + ROOM, number, std::chars_format::fixed).ptr;
    if (number == std::trunc(number)) {
        *out++ = '.';
        *out++ = '0';
    }
    return out;
}

// Write a number such as 1e-07 of Python, which is 1e-7 in JSON; return the end.
char* put_with_exponent(char* out, double number, bool as_python) {
    out = std::to_chars(out, out + ROOM, number, std::chars_format::scientific).ptr;
    if (!as_python && out[-2] == '0' && out[-3] < '0') {  // a sign, then the 0 of e-07
        out[-2] = out[-1];
        --out;
    }
    return out;
}

// Write a number as Python's `repr` or as JSON has it, nothing for nan; return the end.
char* put_number(char* out, double number, bool as_python) {
    if (std::isnan(number) || (std::isinf(number) && !as_python)) return out;
    const double size = std::abs(number),
                 least = as_python ? MIN_PLAIN_IN_PYTHON : MIN_PLAIN_IN_JSON;
    if (size == 0 || (size >= least && size < MAX_PLAIN)) return put_plain(out, number);
    return put_with_exponent(out, number, as_python);
}

}  // namespace

// Write the rows of a table as CSV into `rows`; returns the number of bytes.
Index write_csv_rows(const CsvRowsData& data) {
    const char* letters = reinterpret_cast<const char*>(data.letters.data);
    char* const start = reinterpret_cast<char*>(data.rows.data);
    char* out = start;
    const auto put_text = [&](int64_t text) {
        const int64_t first = data.starts[text], count = data.starts[text + 1] - first;
        std::memcpy(out, letters + first, count);
        out += count;
        *out++ = ',';
    };
    const Index columns = data.texts.size[1];
    for (Index row = 0; row < data.texts.size[0]; ++row) {
        const auto texts = data.texts[row];
        const auto numbers = data.numbers[row];
        for (Index c = 0; c < data.leading; ++c) put_text(texts[c]);
        for (Index d = 0; d < numbers.size[0]; ++d) {
            out = put_number(out, numbers[d], data.as_python);
            *out++ = ',';
        }
        for (Index c = data.leading; c < columns; ++c) put_text(texts[c]);
        out[-1] = '\n';
    }
    return out - start;
}

const Exported<write_csv_rows> write_csv_rows_exported{"write_csv_rows"};

}  // namespace shapefit
