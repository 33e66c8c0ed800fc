#include "banded.hpp"

#include "../base/small_matrices.hpp"

namespace shapefit {
namespace {

// out = C^T of (n, n).
void transpose(const double* C, Index n, double* __restrict out) {
    for (Index i = 0; i < n; ++i)
        for (Index j = 0; j < n; ++j) out[j * n + i] = C[i * n + j];
}

void clear(double* x, Index n) {
    for (Index e = 0; e < n; ++e) x[e] = 0;
}

}  // namespace

void Banded::scales(const SequenceData& data, Index f, Index lag, double* out) const {
    const Index p = data.stiffness.size[0];
    const double tied = tie(data, f, lag);
    for (Index e = 0; e < D_; ++e)
        out[e] = e < 3 * p ? tied * data.stiffness[e % p] : 0.0;
}

bool Banded::factorise(const SequenceData& data, const Place& at, Bones bones,
                       double damping) {
    const Index d = data.points.size[1], D = D_, DD = D * D, DE = D * E_;
    double* tied = work_;
    clear(products_, E_ * E_);
    for (Index f = 0; f < t_; ++f) {
        check_interrupt();
        double *V = V_ + f * DD, *N = N_ + f * DD, *F = F_ + f * DE;
        double* W = W_ + f % 3 * DD;
        const double *W1 = W_ + (f + 2) % 3 * DD,
                     *W2 = W_ + (f + 1) % 3 * DD;  // of f - 1, f - 2
        derive(data, at, f, bones, S_, R_, E_);
        scales(data, f, 0, tied);
        for (Index e = 0; e < d; ++e) S_[e * D + e] += tied[e] + damping;
        if (f > 0) {
            add_product(-1, transposed(N - DD, D), N - DD, S_, D, D, D, D, upper(D));
            add_product(-1, transposed(N - DD, D), F - DE, R_, D, E_, E_, E_, every(D));
        }
        if (f > 1) {
            add_product(-1, transposed(W2, D), W2, S_, D, D, D, D,
                        upper_from_column(D));
            add_product(-1, transposed(W2, D), F - 2 * DE, R_, D, E_, E_, E_, every(D));
        }
        if (!is_finite(cholesky_inverse(S_, V, D, D))) return false;
        clear(F, DE);
        add_product(1, plain(V, D), R_, F, D, E_, E_, E_, up_to_row());
        add_product(1, transposed(F, E_), F, products_, E_, E_, E_, E_, every(D));
        if (f + 1 == t_) break;
        clear(S_, DD);
        scales(data, f, 1, tied);
        for (Index e = 0; e < D; ++e) S_[e * D + e] = tied[e];
        if (f > 0)
            add_product(-1, transposed(N - DD, D), W1, S_, D, D, D, D, from_column(D));
        clear(N, DD);
        add_product(1, plain(V, D), S_, N, D, D, D, D, up_to_row());
        scales(data, f, 2, tied);
        for (Index i = 0; i < D; ++i)
            for (Index j = 0; j < D; ++j) W[i * D + j] = V[i * D + j] * tied[j];
    }
    return true;
}

void Banded::solve(const SequenceData& data, const double* x,
                   Matrix<double> out) const {
    const Index D = D_, e = data.lengths.size[0];
    double *scaled = work_, *left = work_ + D;
    for (Index f = t_ - 1; f >= 0; --f) {
        const double *V = V_ + f * D * D, *N = N_ + f * D * D, *F = F_ + f * D * E_;
        for (Index i = 0; i < D; ++i) left[i] = F[i * E_] + dot(F + i * E_ + 1, x, e);
        if (f + 1 < t_)
            for (Index i = 0; i < D; ++i)
                left[i] -= dot_padded(N + i * D, out[f + 1].data, D);
        if (f + 2 < t_) {
            scales(data, f, 2, scaled);
            for (Index i = 0; i < D; ++i) scaled[i] *= out[f + 2][i];
            for (Index i = 0; i < D; ++i)
                left[i] -= dot_padded(V + i * D, scaled, padded(i + 1));
        }
        mix_rows(left, D, V, D, D, out[f].data);
    }
}

// The blocks of A^-1 from the last frame to the first, G_N = U_ff^-1 N_f and G_W =
// U_ff^-1 W_f:
//
//   Sigma_f,f+1 = -G_N Sigma_f+1,f+1 - G_W Sigma_f+2,f+1
//   Sigma_f,f+2 = -G_N Sigma_f+1,f+2 - G_W Sigma_f+2,f+2
//   Sigma_ff = V^T V - Sigma_f,f+1 G_N^T - Sigma_f,f+2 G_W^T
void Banded::write_covariances(const SequenceData& data, const Place& at,
                               Marginal& marginal) const {
    const Index D = D_, DD = D * D;
    double* left = work_;
    const auto take = [&] { return left += DD, left - DD; };
    double *here = take(), *next = take(),
           *last = take();     // Sigma_ff of f, f + 1, f + 2
    double* between = take();  // Sigma_f+1,f+2
    double *GN = take(), *GW = take(), *one = take(), *two = take();
    double *turned = S_, *tied = R_;
    clear(next, DD);
    clear(last, DD);
    clear(between, DD);
    for (Index f = t_ - 1; f >= 0; --f) {
        check_interrupt();
        const double *V = V_ + f * DD, *N = N_ + f * DD;
        multiply_out(V, here, D, D);
        mirror(here, D, D);
        scales(data, f, 2, tied);
        clear(GN, DD);
        clear(one, DD);
        clear(two, DD);
        for (Index i = 0; i < D; ++i)
            for (Index j = 0; j < D; ++j) GW[i * D + j] = here[i * D + j] * tied[j];
        if (f + 1 < t_) add_product(1, transposed(V, D), N, GN, D, D, D, D, every(D));
        transpose(between, D, turned);
        add_product(-1, plain(GN, D), next, one, D, D, D, D, every(D));
        add_product(-1, plain(GW, D), turned, one, D, D, D, D, every(D));
        add_product(-1, plain(GN, D), between, two, D, D, D, D, every(D));
        add_product(-1, plain(GW, D), last, two, D, D, D, D, every(D));
        transpose(GN, D, turned);
        add_product(-1, plain(one, D), turned, here, D, D, D, D, upper(D));
        transpose(GW, D, turned);
        add_product(-1, plain(two, D), turned, here, D, D, D, D, upper(D));
        mirror(here, D, D);
        marginal.write(data, at, f, here);
        data.energies[f] = at.energies[f];
        for (Index e = 0; e < DD; ++e) between[e] = one[e];
        double* free = last;
        last = next;
        next = here;
        here = free;
    }
}

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

// Log of the weight of mode k, but for a constant, with its Q^-1 and delta; -infinity
// where rounding has left Q without a factor.
double Marginal::weigh(const SequenceData& data, const Place& at, Index f, Index k) {
    const Index D = D_, d = data.means.size[2];
    double *Q = each_ + k * D * D, *delta = delta_ + k * D;
    const double *P = data.precisions[f][k].data, *mean = data.means[f][k].data;
    for (Index e = 0; e < D * D; ++e) Q[e] = rest_[e];
    for (Index i = 0; i < d; ++i)
        for (Index j = i; j < d; ++j) Q[i * D + j] += P[i * d + j];
    const double log_det = cholesky_inverse(Q, V_, D, D);
    if (!is_finite(log_det)) return -INFINITE;
    for (Index e = 0; e < d; ++e) away_[e] = mean[e] - at.y[f][e];
    const double square = multiply_symmetric(P, away_, d, linear_term_);
    for (Index e = 0; e < d; ++e) linear_term_[e] += at.linear_term[f][e];
    multiply_out(V_, Q, D, D);
    mirror(Q, D, D);
    mix_rows(linear_term_, D, Q, D, D, delta);
    return data.log_share[f][k] +
           0.5 * (dot(linear_term_, delta, d) - square - data.log_det[f][k] - log_det);
}

}  // namespace shapefit
