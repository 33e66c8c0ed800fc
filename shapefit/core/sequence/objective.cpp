#include "objective.hpp"

namespace shapefit {
namespace {

// The landmarks i and j at the ends of a bone, the unit vector from j to i, and its
// length.
struct Bone {
    Index i, j;
    double along[3], length;
};

// The ends, length and direction of bone b at the points y (3 p,).
Bone bone_of(const SequenceData& data, const double* y, Index b) {
    const Index p = data.stiffness.size[0];
    Bone bone{data.bones[b].data[0], data.bones[b].data[1], {}, 0};
    for (int a = 0; a < 3; ++a) {
        bone.along[a] = y[a * p + bone.i] - y[a * p + bone.j];
        bone.length += square(bone.along[a]);
    }
    bone.length = root(bone.length);
    for (int a = 0; a < 3; ++a) bone.along[a] /= larger(bone.length, 1e-12);
    return bone;
}

// -log sum_k share_k N(y; m_k, P_k^-1) of frame f; sets share (K,) to the shares of the
// modes at y, and linear_term (D,) to the gradient.
double mix(const SequenceData& data, Index f, const double* y, double* share,
           double* linear_term, double* scratch) {
    const Index K = data.log_share.size[1], d = data.means.size[2], D = padded(d);
    const double larger_unit = square(data.growth[f]);
    double best = -INFINITE, whole = 0;
    for (Index k = 0; k < K; ++k) {
        share[k] = data.log_share[f][k];
        if (!(share[k] > -INFINITE)) continue;
        const double* mean = data.means[f][k].data;
        double *away = scratch, *pulled = scratch + (1 + k) * D;
        for (Index e = 0; e < d; ++e) away[e] = y[e] - mean[e];
        const double distance =
            larger_unit *
            multiply_symmetric(data.precisions[f][k].data, away, d, pulled);
        share[k] -= 0.5 * (distance + data.log_det[f][k]);
        best = larger(share[k], best);
    }
    for (Index k = 0; k < K; ++k) whole += share[k] = exp(share[k] - best);
    for (Index e = 0; e < d; ++e) linear_term[e] = 0;
    for (Index k = 0; k < K; ++k) {
        share[k] /= whole;
        if (share[k] > 0)
            add_to(linear_term, larger_unit * share[k], scratch + (1 + k) * D, d);
    }
    return -(best + log(whole));
}

}  // namespace

double multiply_symmetric(const double* P, const double* x, Index d,
                          double* __restrict out) {
    for (Index i = 0; i < d; ++i) out[i] = 0;
    for (Index i = 0; i < d; ++i) {
        const double *row = P + i * d, xi = x[i];
        double total = row[i] * xi;
        for (Index j = i + 1; j < d; ++j) {
            total += row[j] * x[j];
            out[j] += xi * row[j];
        }
        out[i] += total;
    }
    return dot(x, out, d);
}

double length_gradient(const SequenceData& data, const Place& at, Index b) {
    double total = 0;
    for (Index c = 0; c < data.lengths.size[0]; ++c)
        total += data.length_precision[b][c] * (at.lengths[c] - data.usual_lengths[c]);
    return total;
}

double difference_product(const SequenceData& data, Index f, Index lag) {
    double total = 0;
    for (int a = 0; a + lag < 3 && a <= f; ++a) {
        // f is member a of the difference that begins at f - a
        const double* c = data.differences[f - a].data;
        total += c[a] * c[a + lag];
    }
    return total;
}

void evaluate(const SequenceData& data, Place& at, double* scratch) {
    const Index t = at.y.size[0], p = data.stiffness.size[0];
    double energy = 0;
    for (Index b = 0; b < data.lengths.size[0]; ++b) at.too_long[b] = 0;
    for (Index f = 0; f < t; ++f) {
        check_interrupt();
        const double before = energy;
        const double *y = at.y[f].data, *w = data.landmarks[f].data,
                     *weight = data.weight[f].data;
        energy += mix(data, f, y, at.share[f].data, at.linear_term[f].data, scratch);
        for (Index e = 0; e < 2 * p; ++e)
            energy += 0.5 * weight[e] * square(y[e] - w[e]);
        for (Index b = 0; b < data.lengths.size[0]; ++b) {
            const double longer = bone_of(data, y, b).length - at.lengths[b];
            at.too_long[b] += longer;
            energy += 0.5 * data.rigidity[b] * square(longer);
        }
        at.energies[f] = energy - before;
        if (f + 2 >= t) continue;
        const double *next = at.y[f + 1].data, *last = at.y[f + 2].data,
                     *c = data.differences[f].data;
        for (int a = 0; a < 3; ++a)
            for (Index j = 0; j < p; ++j) {
                const Index e = a * p + j;
                energy += 0.5 * data.stiffness[j] *
                          square(c[0] * y[e] + c[1] * next[e] + c[2] * last[e]);
            }
        at.energies[f] = energy - before;
    }
    for (Index b = 0; b < data.lengths.size[0]; ++b)
        energy += 0.5 * (at.lengths[b] - data.usual_lengths[b]) *
                  length_gradient(data, at, b);
    at.energy = energy;
}

void add_precision(const SequenceData& data, const Place& at, Index f, double sign,
                   double* S) {
    const Index D = at.y.size[1], d = data.means.size[2];
    for (Index k = 0; k < data.log_share.size[1]; ++k) {
        if (at.share[f][k] < 1e-12) continue;
        const double share = sign * at.share[f][k] * square(data.growth[f]);
        const double* P = data.precisions[f][k].data;
        for (Index i = 0; i < d; ++i)
            for (Index j = i; j < d; ++j) S[i * D + j] += share * P[i * d + j];
    }
}

void derive(const SequenceData& data, const Place& at, Index f, Bones bones, double* S,
            double* R, Index E) {
    const Index t = at.y.size[0], D = at.y.size[1], p = data.stiffness.size[0],
                d = 3 * p;
    const double *y = at.y[f].data, *w = data.landmarks[f].data,
                 *weight = data.weight[f].data;
    for (Index e = 0; e < D * D; ++e) S[e] = 0;
    for (Index e = 0; e < D * E; ++e) R[e] = 0;
    add_precision(data, at, f, 1, S);
    for (Index e = 0; e < d; ++e) R[e * E] = at.linear_term[f][e];
    for (Index e = 0; e < 2 * p; ++e) {
        S[e * D + e] += weight[e];
        R[e * E] += weight[e] * (y[e] - w[e]);
    }
    for (Index other = f < 2 ? 0 : f - 2; other <= f + 2 && other < t; ++other) {
        const double tied = other < f ? difference_product(data, other, f - other)
                                      : difference_product(data, f, other - f);
        for (int a = 0; a < 3; ++a)
            for (Index j = 0; j < p; ++j)
                R[(a * p + j) * E] += tied * data.stiffness[j] * at.y[other][a * p + j];
    }
    for (Index b = 0; b < data.lengths.size[0]; ++b) {
        const Bone bone = bone_of(data, y, b);
        const double rigidity = data.rigidity[b], longer = bone.length - at.lengths[b];
        const double across = bones == Bones::WHOLE
                                  ? rigidity * longer / larger(bone.length, 1e-12)
                                  : 0.0;
        for (int end = 0; end < 6; ++end) {
            const double along = (end < 3 ? 1 : -1) * bone.along[end % 3];
            const Index e = end % 3 * p + (end < 3 ? bone.i : bone.j);
            R[e * E] += rigidity * longer * along;
            R[e * E + 1 + b] = -rigidity * along;
            for (int other = 0; other < 6; ++other) {
                const Index o = other % 3 * p + (other < 3 ? bone.i : bone.j);
                const double with = (other < 3 ? 1 : -1) * bone.along[other % 3];
                const double same = (end < 3) == (other < 3) ? 1.0 : -1.0;
                const double unit = end % 3 == other % 3 ? same : 0.0;
                if (o >= e)
                    S[e * D + o] += (rigidity - across) * along * with + across * unit;
            }
        }
    }
    for (Index e = d; e < D; ++e) S[e * D + e] = 1;
}

}  // namespace shapefit
