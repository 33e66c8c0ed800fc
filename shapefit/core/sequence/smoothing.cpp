// The shapes of a whole sequence at once: the minimum of the objective of objective.hpp
// over the frames y and the lengths l, by the method of Levenberg and Marquardt.
#include "../base/small_matrices.hpp"
#include "banded.hpp"

namespace shapefit {

// Precisions (factor C + ridge I)^-1 in the place of covariances C, and log det of the
// covariances, for those that are `wanted`.
struct PrecisionData {
    Arguments& from;
    Blocks<double> matrices = from("matrices", "n K d d");
    Matrix<const double> factor = from("factor", "n K");  // 0 where C is not known
    Matrix<const double> ridge = from("ridge", "n K");
    Matrix<const bool> wanted = from("wanted", "n K");
    Matrix<double> log_det = from("log_det", "n K");
};

// Overwrite the wanted covariances C of the range by (factor C + ridge I)^-1, and write
// log det (factor C + ridge I).
void find_precisions(const PrecisionData& data, Range range) {
    const Index K = data.wanted.size[1], d = data.matrices.size[2], D = padded(d);
    Workspace workspace;
    double *S = workspace.zeros<double>(D * D), *V = workspace.zeros<double>(D * D);
    for (Index image = range.first; image < range.last; ++image)
        for (Index k = 0; k < K; ++k) {
            check_interrupt();
            if (!data.wanted[image][k]) continue;
            double *C = data.matrices[image][k].data, factor = data.factor[image][k];
            for (Index i = 0; i < D; ++i)
                for (Index j = 0; j < D; ++j)
                    S[i * D + j] = i >= d || j >= d ? (i == j ? 1.0 : 0.0)
                                   : factor > 0     ? factor * C[i * d + j]
                                                    : 0.0;
            for (Index i = 0; i < d; ++i) S[i * D + i] += data.ridge[image][k];
            data.log_det[image][k] = cholesky_inverse(S, V, D, D);
            multiply_out(V, S, D, D);
            mirror(S, D, D);
            for (Index i = 0; i < d; ++i)
                for (Index j = 0; j < d; ++j) C[i * d + j] = S[i * D + j];
        }
}

const Exported<find_precisions> find_precisions_exported{"find_precisions"};

namespace {

// Of a coordinate, in units of the size of the landmarks.
constexpr double MAX_STEP = 0.5;
constexpr double FIRST_DAMPING = 1e-1, MIN_DAMPING = 1e-2, MAX_DAMPING = 1e8;
constexpr double DAMPING_INCREASE = 6, DAMPING_DECREASE = 5;

// A step of frames and lengths, and the system of the lengths.
struct Step {
    Step(Workspace& workspace, const SequenceData& data)
        : frames(workspace.matrix<double>(data.points.size[0],
                                          padded(data.points.size[1]))),
          lengths(workspace.vector<double>(data.lengths.size[0])),
          schur(workspace.zeros<double>(matrix_size(data))),
          inverse(workspace.zeros<double>(matrix_size(data))),
          side(workspace.zeros<double>(padded(data.lengths.size[0]))) {}

    // How many numbers there are in a matrix over the lengths, padded.
    static Index matrix_size(const SequenceData& data) {
        const Index e = padded(data.lengths.size[0]);
        return e * e;
    }

    Matrix<double> frames;
    Vector<double> lengths;
    double *schur, *inverse, *side;
};

// Solve the damped Newton system at a place: first for the step of the lengths, with
// the frames eliminated, then for that of the frames. False where the system is not
// positive definite.
bool find_step(const SequenceData& data, const Place& at, const Banded& factor,
               Step& step) {
    const Index e = data.lengths.size[0], E = factor.columns(), n = padded(e);
    const double* G = factor.products();
    const double t = static_cast<double>(at.y.size[0]);
    for (Index a = 0; a < n; ++a) {
        for (Index b = 0; b < n; ++b)
            step.schur[a * n + b] =
                a < e && b < e ? data.length_precision[a][b] - G[(1 + a) * E + 1 + b]
                               : 0.0;
        step.schur[a * n + a] += a < e ? t * data.rigidity[a] + 1e-9 : 1.0;
        step.side[a] = 0;
        if (a < e)
            step.side[a] = length_gradient(data, at, a) -
                           data.rigidity[a] * at.too_long[a] - G[(1 + a) * E];
    }
    if (!is_finite(cholesky_inverse(step.schur, step.inverse, n, n))) return false;
    multiply_out(step.inverse, step.schur, n, n);
    mirror(step.schur, n, n);
    for (Index a = 0; a < e; ++a)
        step.lengths[a] = -dot(step.schur + a * n, step.side, n);
    factor.solve(data, step.lengths.data, step.frames);
    return true;
}

// to = from - shrink * step for the frames, from + shrink * step for the lengths, with
// `shrink` below 1 where a coordinate would move more than MAX_STEP.
void move(const Place& from, const Step& step, Place& to) {
    const Index count = from.y.size[0] * from.y.size[1];
    double farthest = 0;
    for (Index i = 0; i < count; ++i)
        farthest = larger(magnitude(step.frames.data[i]), farthest);
    const double shrink = smaller(1.0, MAX_STEP / larger(farthest, TINY));
    for (Index i = 0; i < count; ++i)
        to.y.data[i] = from.y.data[i] - shrink * step.frames.data[i];
    for (Index a = 0; a < from.lengths.size[0]; ++a)
        to.lengths[a] = from.lengths[a] + shrink * step.lengths[a];
}

// Copy the first `width` numbers of each row.
void copy_rows(Matrix<const double> from, Matrix<double> to, Index width) {
    for (Index f = 0; f < from.size[0]; ++f)
        for (Index e = 0; e < width; ++e) to[f][e] = from[f][e];
}

}  // namespace

// Find a local minimum near the start, by the method of Levenberg and Marquardt, and
// the deviations there for fixed lengths; no step raises the objective.
void smooth_sequence(const SequenceData& data) {
    const Index t = data.points.size[0], d = data.points.size[1],
                e = data.lengths.size[0];
    Workspace workspace;
    Banded factor(workspace, data);
    Step step(workspace, data);
    Place one(workspace, data), other(workspace, data);
    Place *at = &one, *tried = &other;
    double* scratch = workspace.zeros<double>((1 + data.log_share.size[1]) * padded(d));
    copy_rows(data.points, at->y, d);
    for (Index b = 0; b < e; ++b) at->lengths[b] = data.lengths[b];
    evaluate(data, *at, scratch);
    double damping = FIRST_DAMPING;
    Index rounds = 0;
    while (rounds < data.max_rounds) {
        bool lower = false;
        for (; damping < MAX_DAMPING; damping *= DAMPING_INCREASE) {
            if (!factor.factorise(data, *at, Bones::HELD, damping) ||
                !find_step(data, *at, factor, step))
                continue;
            move(*at, step, *tried);
            evaluate(data, *tried, scratch);
            lower = tried->energy <= at->energy;
            if (lower) break;
        }
        if (!lower) break;
        ++rounds;
        const double gain = at->energy - tried->energy;
        Place* before = at;
        at = tried;
        tried = before;
        damping = larger(damping / DAMPING_DECREASE, MIN_DAMPING);
        if (gain < data.tolerance * static_cast<double>(t)) break;
    }
    copy_rows(at->y, data.points, d);
    for (Index b = 0; b < e; ++b) data.lengths[b] = at->lengths[b];
    data.end[0] = at->energy;
    data.end[1] = static_cast<double>(rounds);
    // the Hessian itself where it is positive definite, which Gauss and Newton's always
    // is but for rounding
    if (factor.factorise(data, *at, Bones::WHOLE, 0) ||
        factor.factorise(data, *at, Bones::HELD, 0)) {
        Marginal marginal(workspace, data);
        return factor.write_covariances(data, *at, marginal);
    }
    for (Index i = 0; i < t * d; ++i)
        data.deviation.data[i] = data.correlation.data[i] = NOT_A_NUMBER;
    for (Index i = 0; i < data.covariance.size[0] * d * d; ++i)
        data.covariance.data[i] = NOT_A_NUMBER;
}

const Exported<smooth_sequence> smooth_sequence_exported{"smooth_sequence"};

}  // namespace shapefit
