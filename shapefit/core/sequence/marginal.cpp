#include "marginal.hpp"

#include "../base/small_matrices.hpp"

namespace shapefit {

void Marginal::write(const SequenceData& data, const Place& at, Index f,
                     const double* Sigma) {
    const Index D = D_, d = data.points.size[1], p = d / 3;
    const double* C = mix(data, at, f, Sigma) ? whole_ : Sigma;
    double *sd = data.deviation[f].data, *correlation = data.correlation[f].data;
    for (Index e = 0; e < d; ++e) sd[e] = root(larger(C[e * D + e], 0.0));
    for (Index e = 0; e < d; ++e) {
        const Index first = (e / p == 2 ? p : 0) + e % p,
                    second = (e / p == 0 ? p : 2 * p) + e % p;
        correlation[e] = C[first * D + second] / larger(sd[first] * sd[second], TINY);
    }
    if (data.covariance.size[0])
        for (Index e = 0; e < d; ++e)
            for (Index i = 0; i < d; ++i) data.covariance[f][e][i] = C[e * D + i];
}

bool Marginal::mix(const SequenceData& data, const Place& at, Index f,
                   const double* Sigma) {
    const Index D = D_, DD = D * D, K = data.log_share.size[1];
    Index modes = 0;
    for (Index k = 0; k < K; ++k) modes += data.log_share[f][k] > -INFINITE;
    if (modes < 2) return false;
    for (Index e = 0; e < DD; ++e) whole_[e] = Sigma[e];
    if (!is_finite(cholesky_inverse(whole_, V_, D, D))) return false;
    multiply_out(V_, rest_, D, D);
    add_precision(data, at, f, -1, rest_);
    double best = -INFINITE, total = 0;
    for (Index k = 0; k < K; ++k) {
        weight_[k] =
            data.log_share[f][k] > -INFINITE ? weigh(data, at, f, k) : -INFINITE;
        best = larger(weight_[k], best);
    }
    if (!is_finite(best)) return false;
    for (Index k = 0; k < K; ++k) total += weight_[k] = exp(weight_[k] - best);
    for (Index e = 0; e < D; ++e) mean_[e] = 0;
    for (Index k = 0; k < K; ++k) add_to(mean_, weight_[k] /= total, delta_ + k * D, D);
    for (Index e = 0; e < DD; ++e) whole_[e] = 0;
    for (Index k = 0; k < K; ++k) {
        if (!(weight_[k] > 0)) continue;
        double* delta = delta_ + k * D;
        add_to(delta, -1, mean_, D);
        add_to(whole_, weight_[k], each_ + k * DD, DD);
        for (Index e = 0; e < D; ++e)
            add_to(whole_ + e * D, weight_[k] * delta[e], delta, D);
    }
    return true;
}

double Marginal::weigh(const SequenceData& data, const Place& at, Index f, Index k) {
    const Index D = D_, d = data.means.size[2];
    double *Q = each_ + k * D * D, *delta = delta_ + k * D;
    const double *P = data.precisions[f][k].data, *mean = data.means[f][k].data;
    const double larger_unit = square(data.growth[f]);
    for (Index e = 0; e < D * D; ++e) Q[e] = rest_[e];
    for (Index i = 0; i < d; ++i)
        for (Index j = i; j < d; ++j) Q[i * D + j] += larger_unit * P[i * d + j];
    const double log_det = cholesky_inverse(Q, V_, D, D);
    if (!is_finite(log_det)) return -INFINITE;
    for (Index e = 0; e < d; ++e) away_[e] = mean[e] - at.y[f][e];
    const double distance = larger_unit * multiply_symmetric(P, away_, d, linear_term_);
    for (Index e = 0; e < d; ++e)
        linear_term_[e] = larger_unit * linear_term_[e] + at.linear_term[f][e];
    multiply_out(V_, Q, D, D);
    mirror(Q, D, D);
    mix_rows(linear_term_, D, Q, D, D, delta);
    return data.log_share[f][k] + 0.5 * (dot(linear_term_, delta, d) - distance -
                                         data.log_det[f][k] - log_det);
}

}  // namespace shapefit
