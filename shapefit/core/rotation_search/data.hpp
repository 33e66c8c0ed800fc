// What the search over all rotations reads and writes, as Python lays it out.
#pragma once

#include <stdint.h>

#include "../algebra/views.hpp"

namespace shapefit {

// How the search of an image ended, as in lifting/estimate.py.
struct SearchStatus {
    enum : int64_t { OPTIMAL = 0, LIMIT = 1, DEGENERATE = 2, FAILED = 3 };
};

// Where a search gives up.
struct SearchLimits {
    long cells;      // tests of a cell
    double seconds;  // wall-clock
};

// min 1/2 ||Omega o (W - Rbar sum_i c_i B_i - T 1^T)||_F^2 + lambda ||c||_1 over all rotations.
struct SearchProblem {
    Tensor<const double> landmarks;  // W (n, 2, p)
    Matrix<const double> weights;    // Omega (n, p)
    Tensor<const double> atoms;      // B (k, 3, p)
    Vector<const double> lam;        // (n,)
    bool is_signed;                  // c of either sign, or c >= 0
};

// The global optimum of each image and what is proven of it.
struct GlobalData {
    SearchProblem problem;
    Blocks<const double> starts;  // (n, s, 3, 3) proper rotations; nan where there is none
    double tolerance;             // relative gap at which the search ends
    SearchLimits limits;          // of each image
    Matrix<double> coefficients;  // (n, k)
    Tensor<double> rotation;      // (n, 3, 3)
    Vector<double> objective;     // U (n,)
    Vector<double> bound;         // L (n,): no rotation has an objective below it
    Vector<int64_t> cells;        // tests (n,)
    Vector<int64_t> vertices;     // rotations whose coefficients were found (n,)
    Vector<int64_t> status;       // (n,), a SearchStatus
};

// All readings of each image: minima within a share of the optimum, apart from one another.
struct ModesData {
    SearchProblem problem;
    Tensor<const double> best;  // the global optimum (n, 3, 3)
    double within;              // nothing is missed up to (1 + within) times the least objective
    double apart;               // least angle between modes, radians
    SearchLimits limits;        // of each image
    Blocks<double> rotation;    // (n, m, 3, 3), best first
    Matrix<double> objective;   // (n, m)
    Vector<int64_t> count;      // modes (n,) <= m
    Vector<int64_t> valleys;    // rotations (n,) beside the modes that their valleys reach
    Vector<int64_t> cells;      // tests (n,)
    Vector<int64_t> status;     // (n,), a SearchStatus: OPTIMAL where the list is complete
};

// The coefficients at given rotations: image j of problem, rotation R (n, 3, 3).
struct CoefficientsData {
    SearchProblem problem;
    Tensor<const double> rotation;  // (n, 3, 3)
    Matrix<double> coefficients;    // (n, k)
    Vector<double> objective;       // (n,)
};

// The tree of one image's search with a fixed cut, from which the bound can be checked.
struct TreeData {
    SearchProblem problem;  // of one image
    double cut;             // what the tree proves
    long most_cells;
    Matrix<double> vertices;     // quaternions (v, 4)
    Tensor<double> multipliers;  // s Y of each vertex (v, 2, p)
    Vector<int64_t> splits;      // (c,) of each cell, depth first: the edge that is split, or -1
};

// The inequalities of one cell, for the tests that judge them.
struct CellData {
    SearchProblem problem;              // of one image
    Matrix<const double> corners;       // quaternions (4, 4)
    double cut;
};

struct TreeSize {
    long cells;
    long vertices;
    bool complete;  // every cell was dropped
};

}  // namespace shapefit
