#include "limbs.hpp"

#include "../base/small_matrices.hpp"

namespace shapefit {
namespace {

constexpr int STEPS = 3;  // the fourth changes shapes by less than 1e-3 of their size
constexpr double MIN_SQUARED_LENGTH = 1e-15;  // of a limb that is a point

// Set `root` (n, n) to A^T with A A^T = Q, for a symmetric Q that may be singular.
void find_root(Workspace& workspace, Matrix<const double> Q, double* root) {
    const Index n = Q.size[0];
    double *copy = workspace.zeros<double>(n * n), *values = workspace.zeros<double>(n);
    for (Index e = 0; e < n * n; ++e) copy[e] = Q.data[e];
    symmetric_eigen({copy, {n, n}}, {values, {n}}, {root, {n, n}});
    for (Index e = 0; e < n * n; ++e)
        root[e] *= shapefit::root(larger(values[e / n], 0.0));
}

}  // namespace

LimbLengths::LimbLengths(Workspace& workspace, const PosteriorData& data)
    : count_(data.limbs.size[0]),
      n_(tiled(count_)),
      limbs_(data.limbs),
      log_length_(data.limb_log_length),
      root_(workspace.zeros<double>(count_ * count_)),
      m_(workspace.zeros<Doubles>(3 * data.landmarks.size[2])),
      u_(workspace.zeros<Doubles>(3 * count_)),
      r_(workspace.zeros<Doubles>(n_)),
      ahead_(workspace.zeros<Doubles>(n_)),
      row_(workspace.zeros<Doubles>(3 * data.landmarks.size[2] + n_)),
      K_(workspace.zeros<Doubles>(3 * data.landmarks.size[2] * n_)),
      L_{workspace.zeros<Doubles>(Triangle<Doubles>::size(n_))},
      reciprocal_(workspace.zeros<Doubles>(n_)),
      v_(workspace.zeros<Doubles>(n_)),
      t_(workspace.zeros<Doubles>(n_)),
      W_(workspace.zeros<Doubles>(3 * data.landmarks.size[2] * n_)) {
    if (are_known()) find_root(workspace, data.limb_precision, root_);
}

Doubles LimbLengths::condition(Description& modes) {
    const Index d = 3 * modes.p;
    for (Index e = 0; e < d; ++e) m_[e] = modes.mean[e];
    Doubles log_det = {};
    for (int step = 0; step < STEPS; ++step) {
        log_det = linearise(modes);
        for (Index e = 0; e < d; ++e) modes.mean[e] = m_[e] - dot(K_ + e * n_, t_, n_);
    }
    for (Index e = 0; e < d; e += 3) multiply<3>(n_, L_, K_ + e * n_, W_ + e * n_);
    for (Index e = 0; e < d; ++e)
        for (Index f = 0; f <= e; ++f) {
            Doubles& C = modes.C[e * modes.d + f];
            C -= dot(W_ + e * n_, W_ + f * n_, n_);
            modes.C[f * modes.d + e] = C;
        }
    Doubles least = dot(v_, v_, n_) - dot(t_, t_, n_);
    for (Index b = 0; b < count_; ++b) {
        Doubles strained = {};  // row b of A^T r
        for (Index a = 0; a < count_; ++a) strained += root_[b * count_ + a] * r_[a];
        least += strained * strained;
    }
    return 0.5 * (least + log_det);
}

Doubles LimbLengths::linearise(const Description& modes) {
    const Index d = 3 * modes.p;
    for (Index e = 0; e < d * n_; ++e) K_[e] = Doubles{};
    for (Index b = 0; b < n_; ++b) ahead_[b] = Doubles{};
    for (Index a = 0; a < count_; ++a) {
        r_[a] = measure(modes.mean, a) - log_length_[a];
        const Doubles ahead = r_[a] + along(a, m_, 1) - along(a, modes.mean, 1);
        for (Index e = 0; e < d; ++e) row_[e] = along(a, modes.C + e, modes.d);
        for (Index b = 0; b < count_; ++b) {
            const double root = root_[b * count_ + a];
            ahead_[b] += root * ahead;
            for (Index e = 0; e < d; ++e) K_[e * n_ + b] += root * row_[e];
        }
    }
    for (Index b = 0; b < n_; ++b) {
        for (Index a = 0; a < count_; ++a) row_[a] = along(a, K_ + b, n_);
        for (Index c = 0; c <= b; ++c) {
            Doubles total = all(b == c ? 1.0 : 0.0);  // alone, in what is padded
            for (Index a = 0; b < count_ && a < count_; ++a)
                total += row_[a] * root_[c * count_ + a];
            L_[b][c] = total;
        }
    }
    const Doubles log_det = factorise(n_, L_, reciprocal_);
    invert(n_, L_, reciprocal_);
    multiply<1>(n_, L_, ahead_, v_);
    multiply_transposed<1>(n_, L_, v_, t_);
    return log_det;
}

Doubles LimbLengths::measure(const Doubles* y, Index a) {
    const Doubles *from = y + 3 * limbs_[a][0], *to = y + 3 * limbs_[a][1];
    Doubles* u = u_ + 3 * a;
    Doubles square = {};
    for (int axis = 0; axis < 3; ++axis) {
        u[axis] = from[axis] - to[axis];
        square += u[axis] * u[axis];
    }
    square = larger(square, all(MIN_SQUARED_LENGTH));
    for (int axis = 0; axis < 3; ++axis) u[axis] /= square;
    return 0.5 * logarithm(square);
}

Doubles LimbLengths::along(Index a, const Doubles* x, Index stride) const {
    const Doubles* u = u_ + 3 * a;
    const Doubles *from = x + 3 * limbs_[a][0] * stride,
                  *to = x + 3 * limbs_[a][1] * stride;
    Doubles total = {};
    for (int axis = 0; axis < 3; ++axis)
        total += u[axis] * (from[axis * stride] - to[axis * stride]);
    return total;
}

}  // namespace shapefit
