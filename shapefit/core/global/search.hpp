// Depth-first search of all cells with one cut: which of them cannot be dropped, and is there a
// rotation below it.
#pragma once

#include "bound.hpp"

namespace shapefit {

constexpr long CELLS_BETWEEN_LOOKS = 256;  // at the clock

// Whether the time of an image is over, or a share of it.
class Clock {
  public:
    explicit Clock(double seconds);
    bool is_over(double share = 1) const;

  private:
    double begin_, seconds_;
};

class CellSearch {
  public:
    CellSearch(Workspace& workspace, RotationObjective& objective, const RootCells& roots, long most_cells);

    // Start over with the cells of the 600-cell; the vertices keep what is known of them.
    void begin();

    // Lay the vertices of the 600-cell for the image that the objective is turned to.
    void begin_image();

    // The next cell; false where none is left.
    bool take(Cell& cell);

    // Whether the cell holds no rotation below the cut. If not, `edge` is the one to split.
    bool is_dropped(const Cell& cell, int& edge);

    // Replace a cell by its halves; `middle` is the new vertex. False where there is no room.
    bool split(const Cell& cell, int edge, int& middle);

    void put_back(const Cell& cell) { stack_[waiting_++] = cell; }

    // The largest cut, at most the present one, at which all cells that wait can be dropped.
    double prove_rest();

    int longest_edge(const Cell& cell);

    Vertices vertices;
    long tested = 0;  // cells of the image

  private:
    Verdict judge(const Cell& cell);
    int choose_edge(const Cell& cell, const Verdict& verdict);
    double inner_along(const Cell& cell, int edge);

    const RootCells& roots_;
    CellTest test_;
    Cell* stack_;
    long waiting_ = 0, room_;
};

}  // namespace shapefit
