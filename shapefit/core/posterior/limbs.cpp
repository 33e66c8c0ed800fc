#include "limbs.hpp"

#include <utility>

namespace shapefit {
namespace {

constexpr int STEPS = 3;  // the fourth changes shapes by less than 1e-3 of their size
constexpr double MIN_SQUARED_LENGTH = 1e-300;  // of a limb that is a point

// X <- A^-1 X for A (n, n), which is overwritten, and X (n, columns), by elimination
// with the largest pivot of each column. Returns log |det A|.
double solve_in_place(double* A, double* X, Index n, Index columns) {
    double log_determinant = 0;
    for (Index k = 0; k < n; ++k) {
        Index pivot = k;
        for (Index i = k + 1; i < n; ++i)
            if (magnitude(A[i * n + k]) > magnitude(A[pivot * n + k])) pivot = i;
        for (Index j = 0; j < n; ++j) std::swap(A[k * n + j], A[pivot * n + j]);
        for (Index j = 0; j < columns; ++j)
            std::swap(X[k * columns + j], X[pivot * columns + j]);
        log_determinant += log(magnitude(A[k * n + k]));
        for (Index i = 0; i < n; ++i) {
            if (i == k) continue;
            const double factor = A[i * n + k] / A[k * n + k];
            for (Index j = k; j < n; ++j) A[i * n + j] -= factor * A[k * n + j];
            for (Index j = 0; j < columns; ++j)
                X[i * columns + j] -= factor * X[k * columns + j];
        }
    }
    for (Index i = 0; i < n; ++i)
        for (Index j = 0; j < columns; ++j) X[i * columns + j] /= A[i * n + i];
    return log_determinant;
}

}  // namespace

LimbLengths::LimbLengths(Workspace& workspace, const PosteriorData& data)
    : p_(data.landmarks.size[2]),
      d_(3 * p_),
      count_(data.limbs.size[0]),
      limbs_(data.limbs),
      log_length_(data.limb_log_length),
      Q_(data.limb_precision),
      m_(workspace.zeros<double>(d_)),
      excess_(workspace.zeros<double>(count_)),
      u_(workspace.zeros<double>(3 * count_)),
      JC_(workspace.zeros<double>(count_ * d_)),
      JCJ_(workspace.zeros<double>(count_ * count_)),
      system_(workspace.zeros<double>(count_ * count_)),
      G_(workspace.zeros<double>(count_ * count_)),
      force_(workspace.zeros<double>(count_)),
      GJC_(workspace.zeros<double>(count_ * d_)) {}

double LimbLengths::condition(double* y, double* C) {
    for (Index e = 0; e < d_; ++e) m_[e] = y[e];
    double log_determinant = 0;
    for (int step = 0; step < STEPS; ++step) {
        log_determinant = linearise(y, C);
        for (Index e = 0; e < d_; ++e) {
            double change = 0;
            for (Index a = 0; a < count_; ++a) change += JC_[a * d_ + e] * force_[a];
            y[e] = m_[e] - change;
        }
    }
    double moved = 0, strained = 0;
    for (Index a = 0; a < count_; ++a)
        for (Index b = 0; b < count_; ++b) {
            moved += force_[a] * JCJ_[a * count_ + b] * force_[b];
            strained += excess_[a] * Q_[a][b] * excess_[b];
        }
    for (Index a = 0; a < count_; ++a)
        for (Index e = 0; e < d_; ++e) {
            double total = 0;
            for (Index b = 0; b < count_; ++b)
                total += G_[a * count_ + b] * JC_[b * d_ + e];
            GJC_[a * d_ + e] = total;
        }
    for (Index e = 0; e < d_; ++e)
        for (Index a = 0; a < count_; ++a) {
            const double factor = JC_[a * d_ + e];
            for (Index f = 0; f <= e; ++f) C[e * d_ + f] -= factor * GJC_[a * d_ + f];
        }
    return 0.5 * (moved + strained + log_determinant);
}

double LimbLengths::linearise(const double* y, const double* C) {
    for (Index a = 0; a < count_; ++a) {
        const int64_t i = limbs_[a][0], j = limbs_[a][1];
        double* u = u_ + 3 * a;
        double length_square = 0;
        for (int axis = 0; axis < 3; ++axis) {
            u[axis] = y[axis * p_ + i] - y[axis * p_ + j];
            length_square += u[axis] * u[axis];
        }
        length_square = larger(length_square, MIN_SQUARED_LENGTH);
        excess_[a] = 0.5 * log(length_square) - log_length_[a];
        for (int axis = 0; axis < 3; ++axis) u[axis] /= length_square;
        double* row = JC_ + a * d_;
        for (Index e = 0; e < d_; ++e) row[e] = 0;
        for (int axis = 0; axis < 3; ++axis) {
            const double* from = C + (axis * p_ + i) * d_;
            const double* to = C + (axis * p_ + j) * d_;
            for (Index e = 0; e < d_; ++e) row[e] += u[axis] * (from[e] - to[e]);
        }
    }
    for (Index a = 0; a < count_; ++a)
        for (Index b = 0; b < count_; ++b) {
            const double* row = JC_ + a * d_;
            double total = 0;
            for (int axis = 0; axis < 3; ++axis)
                total += u_[3 * b + axis] * (row[axis * p_ + limbs_[b][0]] -
                                             row[axis * p_ + limbs_[b][1]]);
            JCJ_[a * count_ + b] = total;
        }
    for (Index a = 0; a < count_; ++a)
        for (Index b = 0; b < count_; ++b) {
            double total = a == b;
            for (Index c = 0; c < count_; ++c) total += Q_[a][c] * JCJ_[c * count_ + b];
            system_[a * count_ + b] = total;
            G_[a * count_ + b] = Q_[a][b];
        }
    const double log_determinant = solve_in_place(system_, G_, count_, count_);
    for (Index a = 0; a < count_; ++a) force_[a] = 0;
    for (Index b = 0; b < count_; ++b) {
        double ahead = excess_[b];
        for (int axis = 0; axis < 3; ++axis) {
            const Index i = axis * p_ + limbs_[b][0], j = axis * p_ + limbs_[b][1];
            ahead += u_[3 * b + axis] * ((m_[i] - m_[j]) - (y[i] - y[j]));
        }
        for (Index a = 0; a < count_; ++a) force_[a] += G_[a * count_ + b] * ahead;
    }
    return log_determinant;
}

}  // namespace shapefit
