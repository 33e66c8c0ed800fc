// The vertices of an image's cells: at each rotation the best coefficients, and their multiplier.
//
// The multiplier Y = w - Rbar sum_i c_i B_i is feasible at its own rotation; scaled by s it has the
// value D(s Y) = s <Y, w> - s^2 ||Y||^2 / 2, and s is the least one at which that reaches the cut.
#pragma once

#include "cells.hpp"
#include "objective.hpp"

namespace shapefit {

struct Vertex {
    double q[4];
    double objective;  // v
    double square;     // ||Y||^2
    double along;      // <Y, w>
    double largest;    // max_i ||Y B_i^T||_F
    double scale;      // s; nan where no scaled Y reaches the cut
    long scaled_for;   // number of the cut
    double* products;  // Y B_i^T (6, padded k), atoms innermost
    double* Y;         // (2, row)
    long count;        // coefficients that are not 0
    long* index;       // (room,) their atoms
    double* x;         // (room,)
};

class Vertices {
  public:
    Vertices(Workspace& workspace, RotationObjective& objective, long most);

    // Forget all and begin with those of the 600-cell.
    void begin(const RootCells& roots);

    // A new vertex at q, whose coefficients start from those of another one, if any.
    Vertex& add(const double* q, const Vertex* like);

    // The vertex half-way between two; false where there is no room for it.
    bool middle(int a, int b, int& number);

    // Change what a scaled multiplier has to reach.
    void set_cut(double value);

    // s of the vertex, for the cut; false where it does not reach it.
    bool reaches(Vertex& vertex) const;

    Vertex& operator[](int number) { return *all_[number]; }
    int count() const { return count_; }
    double cut() const { return cut_; }

  private:
    void lay(Vertex& vertex);
    void find_products(Vertex& vertex);
    void grow_table();
    long* place_of_edge(uint64_t key);

    Workspace& workspace_;
    RotationObjective& objective_;
    const long most_;
    Vertex** all_;
    int laid_ = 0, count_ = 0;
    double cut_ = 0;
    long number_of_cut_ = 0;
    uint64_t* keys_ = nullptr;  // of the edges whose middle is known: open addressing
    long* middles_ = nullptr;
    long table_ = 0;
};

}  // namespace shapefit
