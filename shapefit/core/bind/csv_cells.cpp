// Cells of a table: where they are, as numbers, and as texts that are numbered. A cell
// is what stands from its first letter to its last, in a text that is given once for
// all of them.
#include "../base/registry.hpp"

#include <algorithm>
#include <bit>
#include <charconv>
#include <limits>
#include <string_view>
#include <unordered_map>
#include <vector>

namespace shapefit {

// The lines of a table, and where their cells end. Each cell begins one letter behind
// the end of the one before it.
struct CsvLinesData {
    Arguments& from;
    Vector<const uint64_t> letters = from("letters", "w");  // of l lines, ends included
    Matrix<int64_t> ends = from("ends", "l c");
};

// Cells of a column that may be numbers.
struct CsvNumbersData {
    Arguments& from;
    Vector<const uint64_t> letters = from("letters", "w");
    Matrix<const int64_t> ends = from("ends", "l c");
    Index column = from("column");
    bool spaced = from("spaced");  // spaces around cells do not belong to them
    Vector<double> numbers = from("numbers", "l");  // nan for an empty cell
    Vector<bool> is_read = from("is_read", "l");  // false for what else may be a number
};

// Cells of a column that are texts.
struct CsvTextsData {
    Arguments& from;
    Vector<const uint64_t> letters = from("letters", "w");
    Matrix<const int64_t> ends = from("ends", "l c");
    Index column = from("column");
    bool spaced = from("spaced");  // spaces around cells do not belong to them
    Vector<int64_t> numbers = from("numbers", "l");  // of the texts of the cells
    Vector<uint64_t> unique = from("unique", "w");   // each text once, as a line
};

namespace {

constexpr Index WORD_BYTES = 8;
constexpr uint64_t EACH_BYTE = 0x0101010101010101;
constexpr uint64_t HIGH_BITS = 0x80 * EACH_BYTE;

// The high bit of each byte of `word` that is `letter`.
uint64_t find_letter(uint64_t word, char letter) {
    const uint64_t x = word ^ EACH_BYTE * static_cast<uint8_t>(letter);
    return ~(((x & ~HIGH_BITS) + ~HIGH_BITS) | x) & HIGH_BITS;
}

// The word whose lowest byte is the first letter.
uint64_t first_letter_lowest(uint64_t word) {
    return std::endian::native == std::endian::little ? word : __builtin_bswap64(word);
}

// Whether Python's `str.strip` removes a letter, which is ASCII.
bool is_space(char letter) {
    return letter == ' ' || (letter >= '\t' && letter <= '\r') ||
           (letter >= '\x1c' && letter <= '\x1f');
}

// A text without the spaces around it.
std::string_view strip(std::string_view text) {
    while (!text.empty() && is_space(text.front())) text.remove_prefix(1);
    while (!text.empty() && is_space(text.back())) text.remove_suffix(1);
    return text;
}

// The text of the cell of a line in a column.
template <class Data>
std::string_view cell_of(const Data& data, Index line) {
    const char* letters = reinterpret_cast<const char*>(data.letters.data);
    const int64_t* end = data.ends.data + line * data.ends.size[1] + data.column;
    const int64_t start = line + data.column == 0 ? 0 : end[-1] + 1;
    const std::string_view text(letters + start, static_cast<size_t>(*end - start));
    return data.spaced ? strip(text) : text;
}

// Set `number` to that of a cell which is a decimal number in its usual form, as Python
// reads it; false for any other cell.
bool read_number(std::string_view cell, double& number) {
#if defined(__cpp_lib_to_chars)
    if (cell.empty()) return false;
    const char sign_or_digit = cell[0];
    const bool usual = sign_or_digit == '-' || sign_or_digit == '.' ||
                       (sign_or_digit >= '0' && sign_or_digit <= '9');
    const char last = cell.back();  // not of inf or nan
    const bool ends_in_digit = last >= '0' && last <= '9';
    if (!usual || !ends_in_digit) return false;
    const char* const end = cell.data() + cell.size();
    const auto [stop, error] = std::from_chars(cell.data(), end, number);
    return error == std::errc() && stop == end;
#else
    (void)cell, (void)number;
    return false;
#endif
}

}  // namespace

// Find the cells of lines, none of them in quotes; returns how many lines have a cell
// for each column, the first of them not empty, before one that does not.
//
// Commas and ends of lines are looked for in eight letters at a time.
Index split_csv_lines(const CsvLinesData& data) {
    const char* letters = reinterpret_cast<const char*>(data.letters.data);
    const Index lines = data.ends.size[0];
    const Index columns = data.ends.size[1];
    int64_t* end = data.ends.data;
    Index line = 0;
    Index column = 0;
    Index line_start = 0;
    for (Index w = 0; w < data.letters.size[0]; ++w) {
        const uint64_t word = first_letter_lowest(data.letters[w]);
        uint64_t marks = find_letter(word, ',') | find_letter(word, '\n');
        for (; marks != 0; marks &= marks - 1) {
            const Index at = WORD_BYTES * w + std::countr_zero(marks) / 8;
            const bool is_last = column == columns - 1;
            const bool is_empty = column == 0 && at == line_start;
            if ((letters[at] == '\n') != is_last || is_empty) return line;
            *end++ = at;
            ++column;
            if (is_last) {
                column = 0;
                line_start = at + 1;
                if (++line == lines) return line;
            }
        }
    }
    return line;
}

// Read the cells that are decimal numbers in their usual form, and those that are
// empty, and flag them in `is_read`; returns how many others there are, which are left
// to Python.
Index read_csv_numbers(const CsvNumbersData& data) {
    Index others = 0;
    for (Index line = 0; line < data.numbers.size[0]; ++line) {
        const auto cell = cell_of(data, line);
        double number = std::numeric_limits<double>::quiet_NaN();
        const bool is_read = cell.empty() || read_number(cell, number);
        data.numbers[line] = number;
        data.is_read[line] = is_read;
        others += !is_read;
    }
    return others;
}

// Number the different texts of the cells from 0 in the order in which they first
// occur; write the number of each cell, and the texts themselves as lines into
// `unique`; returns the number of bytes of these lines.
//
// In most tables a text is followed by the one that followed it before: the item of the
// row before, or the next landmark. Only others are looked up.
Index number_csv_texts(const CsvTextsData& data) {
    std::unordered_map<std::string_view, int64_t> number_of;
    std::vector<std::string_view> texts;
    std::vector<int64_t> following;  // of each text, the number that came next
    int64_t before = -1;
    char* const start = reinterpret_cast<char*>(data.unique.data);
    char* out = start;
    for (Index n = 0; n < data.numbers.size[0]; ++n) {
        const auto cell = cell_of(data, n);
        int64_t number = before < 0 ? -1 : following[before];
        if (number < 0 || texts[number] != cell) {
            const auto found = number_of.try_emplace(cell, texts.size());
            number = found.first->second;
            if (found.second) {
                out = std::copy(cell.begin(), cell.end(), out);
                *out++ = '\n';
                texts.push_back(cell);
                following.push_back(number);
            }
            if (before >= 0) following[before] = number;
        }
        data.numbers[n] = number;
        before = number;
    }
    return out - start;
}

const Exported<split_csv_lines> split_csv_lines_exported{"split_csv_lines"};
const Exported<read_csv_numbers> read_csv_numbers_exported{"read_csv_numbers"};
const Exported<number_csv_texts> number_csv_texts_exported{"number_csv_texts"};

}  // namespace shapefit
