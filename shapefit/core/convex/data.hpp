// The convex program of an image, its dual, and what its kernels read and write.
//
//     min_{M,T}  f(Omega o (W - sum_i M_i B_i - T 1^T)) + lambda sum_i ||M_i||_2
//     max_Y      <Y, Omega o W> - delta/2 ||Y||_F^2
//                over ||(Omega o Y) B_i^T||_* <= lambda, |Y| <= bound and Y omega = 0
//
// The losses f differ in delta and the bound alone: squared 1 and infinity, exact 0 and
// infinity, l1 0 and 1, sparse errors 1 and beta. Arrays are those of Python.
#pragma once

#include "../base/registry.hpp"

namespace shapefit {

// The programs of n images, which have their atoms and their loss in common.
struct ConvexProgram {
    Arguments& from;
    // W; what it holds where the weight is 0 is ignored
    Tensor<const double> landmarks = from("landmarks", "n 2 p");
    Matrix<const double> weights = from("weights", "n p");  // Omega, 0 = hidden
    Tensor<const double> atoms = from("atoms", "k 3 p");    // B
    Vector<const double> lam = from("lam", "n");
    double delta = from("delta");
    double bound = from("bound");
};

// The transforms of one image that are not 0: their atoms, in order, and blocks (count,
// 2, 3).
struct ImageTransforms {
    const int64_t* atom;
    const double* blocks;
    Index count;
};

// Those of n images in one list: each has `count` of them, from `first` on.
template <class Integer, class Number>
struct SparseTransforms {
    Arguments& from;
    Vector<Integer> first = from("first", "n"), count = from("count", "n");
    Vector<Integer> atom = from("atom", "a");
    Tensor<Number> blocks = from("blocks", "a 2 3");

    // The transforms of one image.
    ImageTransforms operator[](Index image) const {
        const Index at = first[image];
        return {atom.data + at, blocks.data + 6 * at, count[image]};
    }
};
using GivenTransforms = SparseTransforms<const int64_t, const double>;
// Images take their places in the list as they are done: whoever reads it must not rely
// on their order.
struct FoundTransforms : SparseTransforms<int64_t, double> {
    Vector<int64_t> used = from("used", "1");  // places that are taken
};

// A point of the dual for each image, and what of the program goes with its transforms.
struct ConvexPoint {
    Arguments& from;
    Matrix<double> translation = from("translation", "n 2");  // T
    Tensor<double> dual = from("dual", "n 2 p");              // Y
    // E, 0 before an image is solved; the squared loss has none
    Tensor<double> errors = from("errors", "n 2 p?");
};

// What a point proves: P, (P - D) / P and ||Omega o (W - sum M_i B_i - T)|| / ||Omega o
// (W - mean)||.
struct ConvexProof {
    Arguments& from;
    Vector<double> objective = from("objective", "n");
    Vector<double> relative_gap = from("relative_gap", "n");
    Vector<double> residual = from("residual", "n");
};

struct ConvexOptions {
    Arguments& from;
    // which images begin a block: only within one do images start from one another's
    // solutions
    Vector<const bool> begins = from("begins", "n");
    double tolerance = from("tolerance");
    Index max_steps = from("max_steps");
};

// How many steps the solver took on each image, and how it ended.
struct ConvexEnd {
    Arguments& from;
    Vector<int64_t> steps = from("steps", "n");    // Newton steps
    Vector<int64_t> status = from("status", "n");  // a Status
};

// Programs to solve, and what is written of each.
struct ConvexTask {
    Arguments& from;
    ConvexProgram program{from};
    ConvexOptions options{from};
    FoundTransforms transforms{from};
    ConvexPoint point{from};
    ConvexProof proof{from};
    ConvexEnd end{from};
};

// A point whose proof is looked for.
struct CertificateTask {
    Arguments& from;
    ConvexProgram program{from};
    GivenTransforms transforms{from};
    ConvexPoint point{from};
    ConvexProof proof{from};
};

}  // namespace shapefit
