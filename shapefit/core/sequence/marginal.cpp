#include "marginal.hpp"

#include "../base/small_matrices.hpp"

namespace shapefit {

Marginal::Marginal(Workspace& workspace, const SequenceData& data)
    : D_(padded(data.points.size[1])),
      rest_(workspace.zeros<double>(D_ * D_)),
      whole_(workspace.zeros<double>(D_ * D_)),
      V_(workspace.zeros<double>(D_ * D_)),
      each_(workspace.zeros<double>(data.log_share.size[1] * D_ * D_)),
      weight_(workspace.zeros<double>(data.log_share.size[1])),
      delta_(workspace.zeros<double>(data.log_share.size[1] * D_)),
      away_(workspace.zeros<double>(D_)),
      pull_(workspace.zeros<double>(D_)),
      mean_(workspace.zeros<double>(D_)) {}

void Marginal::write(const SequenceData& data, const Place& at, long f, const double* Sigma) {
    const long D = D_, d = data.points.size[1], p = d / 3;
    const double* C = mix(data, at, f, Sigma) ? whole_ : Sigma;
    double *sd = data.deviation[f].data, *correlation = data.correlation[f].data;
    for (long e = 0; e < d; ++e) sd[e] = root(larger(C[e * D + e], 0.0));
    for (long e = 0; e < d; ++e) {
        const long first = (e / p == 2 ? p : 0) + e % p, second = (e / p == 0 ? p : 2 * p) + e % p;
        correlation[e] = C[first * D + second] / larger(sd[first] * sd[second], TINY);
    }
    if (data.covariance.size[0])
        for (long e = 0; e < d; ++e)
            for (long i = 0; i < d; ++i) data.covariance[f][e][i] = C[e * D + i];
}

bool Marginal::mix(const SequenceData& data, const Place& at, long f, const double* Sigma) {
    const long D = D_, DD = D * D, K = data.log_share.size[1];
    long modes = 0;
    for (long k = 0; k < K; ++k) modes += data.log_share[f][k] > -INFINITE;
    if (modes < 2) return false;
    for (long e = 0; e < DD; ++e) whole_[e] = Sigma[e];
    if (!is_finite(factorise_block(whole_, V_, D, D))) return false;
    multiply_out(V_, rest_, D, D);
    add_precision(data, at, f, -1, rest_);
    double best = -INFINITE, total = 0;
    for (long k = 0; k < K; ++k) {
        weight_[k] = data.log_share[f][k] > -INFINITE ? weigh(data, at, f, k) : -INFINITE;
        best = larger(weight_[k], best);
    }
    if (!is_finite(best)) return false;
    for (long k = 0; k < K; ++k) total += weight_[k] = exp(weight_[k] - best);
    for (long e = 0; e < D; ++e) mean_[e] = 0;
    for (long k = 0; k < K; ++k) add_to(mean_, weight_[k] /= total, delta_ + k * D, D);
    for (long e = 0; e < DD; ++e) whole_[e] = 0;
    for (long k = 0; k < K; ++k) {
        if (!(weight_[k] > 0)) continue;
        double* delta = delta_ + k * D;
        add_to(delta, -1, mean_, D);
        add_to(whole_, weight_[k], each_ + k * DD, DD);
        for (long e = 0; e < D; ++e) add_to(whole_ + e * D, weight_[k] * delta[e], delta, D);
    }
    return true;
}

// Log of the weight of mode k, but for a constant, with its Q^-1 and delta; -infinity where rounding
// has left Q without a factor.
double Marginal::weigh(const SequenceData& data, const Place& at, long f, long k) {
    const long D = D_, d = data.means.size[2];
    double *Q = each_ + k * D * D, *delta = delta_ + k * D;
    const double *P = data.precisions[f][k].data, *mean = data.means[f][k].data;
    for (long e = 0; e < D * D; ++e) Q[e] = rest_[e];
    for (long i = 0; i < d; ++i)
        for (long j = i; j < d; ++j) Q[i * D + j] += P[i * d + j];
    const double log_det = factorise_block(Q, V_, D, D);
    if (!is_finite(log_det)) return -INFINITE;
    for (long e = 0; e < d; ++e) away_[e] = mean[e] - at.y[f][e];
    const double square = multiply_symmetric(P, away_, d, pull_);
    for (long e = 0; e < d; ++e) pull_[e] += at.pull[f][e];
    multiply_out(V_, Q, D, D);
    mirror(Q, D, D);
    mix_rows(pull_, D, Q, D, D, delta);
    return data.log_share[f][k] +
           0.5 * (dot(pull_, delta, d) - square - data.log_det[f][k] - log_det);
}

}  // namespace shapefit
