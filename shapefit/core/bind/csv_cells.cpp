// Cells of a table: where they are, as numbers, and as texts that are numbered. A cell
// is what stands from its first letter to its last, in a text that is given once for
// all of them.
#include "../base/registry.hpp"

#include <charconv>
#include <cstring>
#include <string_view>
#include <unordered_map>
#include <vector>

namespace shapefit {

// The lines of a table, and where their cells are.
struct CsvLinesData {
    Arguments& from;
    Vector<const uint64_t> letters = from("letters", "w");  // of l lines, ends included
    Matrix<int64_t> starts = from("starts", "c l");  // of the cells of each column
    Matrix<int64_t> ends = from("ends", "c l");
};

// Cells that may be numbers.
struct CsvNumbersData {
    Arguments& from;
    Vector<const uint64_t> letters = from("letters", "w");
    Vector<const int64_t> starts = from("starts", "n");  // of each cell
    Vector<const int64_t> ends = from("ends", "n");
    Vector<double> numbers = from("numbers", "n");
    Vector<bool> is_read = from("is_read", "n");  // false for what else may be a number
};

// Cells that are texts.
struct CsvTextsData {
    Arguments& from;
    Vector<const uint64_t> letters = from("letters", "w");
    Vector<const int64_t> starts = from("starts", "n");
    Vector<const int64_t> ends = from("ends", "n");
    Vector<int64_t> numbers = from("numbers", "n");  // of the texts of the cells
    Vector<int64_t> first = from("first", "n");      // cells with a new text, in order
};

namespace {

// The text of a cell, from letter `start` up to letter `end` of all letters.
std::string_view cell_of(const char* letters, int64_t start, int64_t end) {
    return {letters + start, static_cast<size_t>(end - start)};
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
Index split_csv_lines(const CsvLinesData& data) {
    const char* letters = reinterpret_cast<const char*>(data.letters.data);
    const Index columns = data.starts.size[0];
    const Index lines = data.starts.size[1];
    Index at = 0;
    for (Index line = 0; line < lines; ++line) {
        for (Index column = 0; column < columns; ++column) {
            data.starts[column][line] = at;
            while (letters[at] != ',' && letters[at] != '\n') ++at;
            data.ends[column][line] = at;
            const bool is_last = column == columns - 1;
            if ((letters[at] == '\n') != is_last) return line;
            ++at;
        }
        if (data.ends[0][line] == data.starts[0][line]) return line;
    }
    return lines;
}

// Read the cells that are decimal numbers in their usual form, and flag them in
// `is_read`; the others are left to Python.
void read_csv_numbers(const CsvNumbersData& data) {
    const char* letters = reinterpret_cast<const char*>(data.letters.data);
    for (Index n = 0; n < data.starts.size[0]; ++n) {
        const auto cell = cell_of(letters, data.starts[n], data.ends[n]);
        data.is_read[n] = read_number(cell, data.numbers[n]);
    }
}

// Number the different texts of the cells from 0 in the order in which they first
// occur, and write the number of each cell; returns how many different texts there are.
//
// In most tables a text is followed by the one that followed it before: the item of the
// row before, or the next landmark. Only others are looked up.
Index number_csv_texts(const CsvTextsData& data) {
    const char* letters = reinterpret_cast<const char*>(data.letters.data);
    std::unordered_map<std::string_view, int64_t> number_of;
    std::vector<std::string_view> texts;
    std::vector<int64_t> following;  // of each text, the number that came next
    int64_t before = -1;
    for (Index n = 0; n < data.starts.size[0]; ++n) {
        const auto cell = cell_of(letters, data.starts[n], data.ends[n]);
        int64_t number = before < 0 ? -1 : following[before];
        if (number < 0 || texts[number] != cell) {
            const auto found = number_of.try_emplace(cell, texts.size());
            number = found.first->second;
            if (found.second) {
                data.first[number] = n;
                texts.push_back(cell);
                following.push_back(number);
            }
            if (before >= 0) following[before] = number;
        }
        data.numbers[n] = number;
        before = number;
    }
    return static_cast<Index>(texts.size());
}

const Exported<split_csv_lines> split_csv_lines_exported{"split_csv_lines"};
const Exported<read_csv_numbers> read_csv_numbers_exported{"read_csv_numbers"};
const Exported<number_csv_texts> number_csv_texts_exported{"number_csv_texts"};

}  // namespace shapefit
