// What the search over all rotations reads and writes, as Python lays it out.
#pragma once

#include "../base/arguments.hpp"

namespace shapefit {

// How the search of an image ended, as in lifting/estimate.py.
struct SearchStatus {
    enum : int64_t { OPTIMAL = 0, LIMIT = 1, DEGENERATE = 2, FAILED = 3 };
};

// Where a search gives up.
struct SearchLimits {
    Arguments& from;
    long cells = from("most_cells");  // tests of a cell
    double seconds = from("most_seconds");  // wall-clock
};

// min 1/2 ||Omega o (W - Rbar sum_i c_i B_i - T 1^T)||_F^2 + lambda ||c||_1 over all rotations.
struct SearchProblem {
    Arguments& from;
    Tensor<const double> landmarks = from("landmarks", "n 2 p");  // W
    Matrix<const double> weights = from("weights", "n p");  // Omega
    Tensor<const double> atoms = from("atoms", "k 3 p");  // B
    Vector<const double> lam = from("lam", "n");
    bool is_signed = from("is_signed");  // c of either sign, or c >= 0
};

// The global optimum of each image and what is proven of it.
struct GlobalData {
    Arguments& from;
    SearchProblem problem{from};
    // proper rotations; nan where there is none
    Blocks<const double> starts = from("starts", "n s 3 3");
    double tolerance = from("tolerance");  // relative gap at which the search ends
    SearchLimits limits{from};  // of each image
    Matrix<double> coefficients = from("coefficients", "n k");
    Tensor<double> rotation = from("rotation", "n 3 3");
    Vector<double> objective = from("objective", "n");  // U
    Vector<double> bound = from("bound", "n");  // L: no rotation has an objective below it
    Vector<int64_t> cells = from("cells", "n");  // tests
    Vector<int64_t> vertices = from("vertices", "n");  // rotations whose coefficients were found
    Vector<int64_t> status = from("status", "n");  // a SearchStatus
};

// All readings of each image: minima within a share of the optimum, apart from one another.
struct ModesData {
    Arguments& from;
    SearchProblem problem{from};
    Tensor<const double> best = from("best", "n 3 3");  // the global optimum
    // nothing is missed up to (1 + within) times the least objective
    double within = from("within");
    double apart = from("apart");  // least angle between modes, radians
    SearchLimits limits{from};  // of each image
    Blocks<double> rotation = from("rotation", "n m 3 3");  // best first
    Matrix<double> objective = from("objective", "n m");
    Vector<int64_t> count = from("count", "n");  // modes <= m
    // rotations beside the modes that their valleys reach
    Vector<int64_t> valleys = from("valleys", "n");
    Vector<int64_t> cells = from("cells", "n");  // tests
    // a SearchStatus: OPTIMAL where the list is complete
    Vector<int64_t> status = from("status", "n");
};

// The coefficients at given rotations: image j of problem, rotation R (n, 3, 3).
struct CoefficientsData {
    Arguments& from;
    SearchProblem problem{from};
    Tensor<const double> rotation = from("rotation", "n 3 3");
    Matrix<double> coefficients = from("coefficients", "n k");
    Vector<double> objective = from("objective", "n");
};

// The tree of one image's search with a fixed cut, from which the bound can be checked.
struct TreeData {
    Arguments& from;
    SearchProblem problem{from};  // of one image
    double cut = from("cut");  // what the tree proves
    long most_cells = from("most_cells");
    Matrix<double> vertices = from("vertices", "v 4");  // quaternions
    Tensor<double> multipliers = from("multipliers", "v 2 p");  // s Y of each vertex
    // of each cell, depth first: the edge that is split, or -1
    Vector<int64_t> splits = from("splits", "c");
};

// The inequalities of one cell, for the tests that judge them.
struct CellData {
    Arguments& from;
    SearchProblem problem{from};  // of one image
    Matrix<const double> corners = from("corners", "4 4");  // quaternions
    double cut = from("cut");
    Vector<double> excess = from("excess", "20");
};

// The descent from a quaternion, likewise.
struct DescentData {
    Arguments& from;
    SearchProblem problem{from};  // of one image
    Vector<double> q = from("q", "4");
    double share = from("share");
};

struct TreeSize {
    long cells;
    long vertices;
    bool complete;  // every cell was dropped

    void give_to(Arguments& to) const {
        to.give_count(cells), to.give_count(vertices), to.give_flag(complete);
    }
};

}  // namespace shapefit
