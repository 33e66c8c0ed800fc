// Rows of a table as text with commas: cells of text as they stand, numbers with the fewest digits
// that read back to the same double.
#pragma once

#include "../base/registry.hpp"

namespace shapefit {

struct CsvRowsData {
    Arguments& from;
    Vector<const uint64_t> letters = from("letters", "w");  // of the texts, one after another
    Vector<const int64_t> starts = from("starts", "1+t");   // of each text, and the end of the last
    Matrix<const int64_t> texts = from("texts", "n c");     // of each row, by their numbers
    Matrix<const double> numbers = from("numbers", "n d");  // nan is an empty cell
    long leading = from("leading");  // texts of a row before its numbers; the others follow them
    bool as_python = from("as_python");  // as `repr` has numbers; else as orjson
    Vector<uint64_t> rows = from("rows", "s");  // room for all texts, commas, 25 bytes a number
};

// Returns the number of bytes of the rows.
long write_csv_rows(const CsvRowsData& data);

}  // namespace shapefit
