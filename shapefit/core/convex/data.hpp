// What the kernels of the convex program read and write, as Python lays it out.
#pragma once

#include <stdint.h>

#include "../algebra/views.hpp"

namespace shapefit {

// min_{M,T} f(Omega o (W - sum_i M_i B_i - T 1^T)) + lambda sum_i ||M_i||_2 for n images.
//
// The dual is max_Y <Y, Omega o W> - delta/2 ||Y||_F^2 over ||(Omega o Y) B_i^T||_* <= lambda,
// |Y| <= bound and Y omega = 0. The losses differ in delta and the bound alone: squared 1 and
// infinity, exact 0 and infinity, l1 0 and 1, sparse errors 1 and beta.
struct ConvexProgram {
    Tensor<const double> landmarks;  // W (n, 2, p); what it holds where the weight is 0 is ignored
    Matrix<const double> weights;    // Omega (n, p), 0 = hidden
    Tensor<const double> atoms;      // B (k, 3, p)
    Vector<const double> lam;        // (n,)
    double delta = 1;
    double bound = 0;
};

// A point of the program and of its dual for each image.
struct ConvexPoint {
    Blocks<double> transforms;  // M (n, k, 2, 3)
    Matrix<double> translation;  // T (n, 2)
    Tensor<double> dual;         // Y (n, 2, p)
    Tensor<double> errors;       // E (n, 2, p)
};

// What a point proves: P, (P - D) / P and ||Omega o (W - sum M_i B_i - T)|| / ||Omega o (W - mean)||.
struct ConvexProof {
    Vector<double> objective;     // (n,)
    Vector<double> relative_gap;  // (n,)
    Vector<double> residual;      // (n,)
};

struct ConvexOptions {
    double tolerance = 1e-4;
    long most_steps = 1000;
    bool started = false;  // the point holds a start for each image, in place of the neighbour's
};

struct ConvexEnd {
    Vector<int64_t> steps;   // (n,) Newton steps
    Vector<int64_t> status;  // (n,) 0 optimal, 1 iteration limit, 2 degenerate, 3 numerical failure
};

// What the parts read that the tests judge one at a time (parts.hpp).
struct MoreauData {
    Matrix<const double> M, N, dN;  // (6, k)
    double step, sigma, t;
};
struct DerivativeData {
    Vector<const double> argument, moved;  // (6,)
    double t, sigma;
    bool resolvent;
    Matrix<const double> atom;  // (3, n)
    Vector<double> prox, weighted;
    Matrix<double> rows;
};
struct GramData {
    Matrix<const double> F;
    Vector<const double> f, r;
    Matrix<const double> C;
    double shift;
    bool by_rows;
};
struct SoftData {
    Matrix<const double> E, Y, D;  // (2, p)
    Vector<const double> rho;
    double step, threshold;
};

struct ConvexTask {
    ConvexProgram program;
    ConvexOptions options;
    ConvexPoint point;
    ConvexProof proof;
    ConvexEnd end;
};

}  // namespace shapefit
