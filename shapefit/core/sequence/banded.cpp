#include "banded.hpp"

#include "../base/small_matrices.hpp"

namespace shapefit {
namespace {

// out = C^T of (n, n).
void transpose(const double* C, Index n, double* __restrict out) {
    for (Index i = 0; i < n; ++i)
        for (Index j = 0; j < n; ++j) out[j * n + i] = C[i * n + j];
}

// x_e = 0 for n numbers.
void clear(double* x, Index n) {
    for (Index e = 0; e < n; ++e) x[e] = 0;
}

// out = C diag(scale) of (n, n).
void scale_columns(const double* C, const double* scale, Index n, double* out) {
    for (Index i = 0; i < n; ++i)
        for (Index j = 0; j < n; ++j) out[i * n + j] = C[i * n + j] * scale[j];
}

// C_ij -= sum_k A_ki B_kj for C (n, n).
void subtract(Factor A, const double* B, double* C, Index n) {
    add_product(-1, A, B, C, n, n, n, n, every(n));
}
// C_ij -= sum_k A_ki B_kj for C (n, n), but for tiles in the lower triangle.
void subtract_upper(Factor A, const double* B, double* C, Index n) {
    add_product(-1, A, B, C, n, n, n, n, upper(n));
}

}  // namespace

void Banded::find_motion_diagonal(const SequenceData& data, Index f, Index lag,
                                  double* tied) const {
    const Index p = data.stiffness.size[0];
    const double with = difference_product(data, f, lag);
    for (Index e = 0; e < D_; ++e)
        tied[e] = e < 3 * p ? with * data.stiffness[e % p] : 0.0;
}

bool Banded::factorise(const SequenceData& data, const Place& at, Bones bones,
                       double damping) {
    clear(products_, E_ * E_);
    for (Index f = 0; f < t_; ++f) {
        check_interrupt();
        begin_frame(data, at, f, bones, damping);
        subtract_earlier_frames(f);
        if (!is_finite(cholesky_inverse(S_, V(f), D_, D_))) return false;
        finish_right_side(f);
        if (f + 1 == t_) break;
        find_next_block(data, f);
        find_second_block(data, f);
    }
    return true;
}

// S = A_ff with `damping` on its diagonal, and the right sides R of frame f.
void Banded::begin_frame(const SequenceData& data, const Place& at, Index f,
                         Bones bones, double damping) {
    const Index d = data.points.size[1];
    derive(data, at, f, bones, S_, R_, E_);
    find_motion_diagonal(data, f, 0, tied_);
    for (Index e = 0; e < d; ++e) S_[e * D_ + e] += tied_[e] + damping;
}

// S -= N_(f-1)^T N_(f-1) + W_(f-2)^T W_(f-2), R -= N_(f-1)^T F_(f-1) + W_(f-2)^T
// F_(f-2).
void Banded::subtract_earlier_frames(Index f) {
    const Index D = D_, E = E_;
    if (f > 0) {
        const Factor N_before = transposed(N(f - 1), D);
        subtract_upper(N_before, N(f - 1), S_, D);
        add_product(-1, N_before, F(f - 1), R_, D, E, E, E, every(D));
    }
    if (f > 1) {
        const Factor W_before = transposed(W(f - 2), D);
        add_product(-1, W_before, W(f - 2), S_, D, D, D, D, upper_from_column(D));
        add_product(-1, W_before, F(f - 2), R_, D, E, E, E, every(D));
    }
}

// Set F_f = V_f R, and add F_f^T F_f to the products.
void Banded::finish_right_side(Index f) {
    const Index D = D_, E = E_;
    clear(F(f), D * E);
    add_product(1, plain(V(f), D), R_, F(f), D, E, E, E, up_to_row());
    add_product(1, transposed(F(f), E), F(f), products_, E, E, E, E, every(D));
}

// Set N_f = V_f (A_f,f+1 - N_(f-1)^T W_(f-1)), the factor's block of frames f and f
// + 1.
void Banded::find_next_block(const SequenceData& data, Index f) {
    const Index D = D_;
    clear(S_, D * D);
    find_motion_diagonal(data, f, 1, tied_);
    for (Index e = 0; e < D; ++e) S_[e * D + e] = tied_[e];
    if (f > 0)
        add_product(-1, transposed(N(f - 1), D), W(f - 1), S_, D, D, D, D,
                    from_column(D));
    clear(N(f), D * D);
    add_product(1, plain(V(f), D), S_, N(f), D, D, D, D, up_to_row());
}

// Set W_f = V_f A_f,f+2, the factor's block of frames f and f + 2.
void Banded::find_second_block(const SequenceData& data, Index f) {
    find_motion_diagonal(data, f, 2, tied_);
    scale_columns(V(f), tied_, D_, W(f));
}

void Banded::solve(const SequenceData& data, const double* x,
                   Matrix<double> out) const {
    const Index D = D_, E = E_, lengths = data.lengths.size[0];
    double *tied = tied_, *left = left_;
    for (Index f = t_ - 1; f >= 0; --f) {
        for (Index i = 0; i < D; ++i)
            left[i] = F(f)[i * E] + dot(F(f) + i * E + 1, x, lengths);
        if (f + 1 < t_)
            for (Index i = 0; i < D; ++i)
                left[i] -= dot_padded(N(f) + i * D, out[f + 1].data, D);
        if (f + 2 < t_) {
            find_motion_diagonal(data, f, 2, tied);
            for (Index i = 0; i < D; ++i) tied[i] *= out[f + 2][i];
            for (Index i = 0; i < D; ++i)
                left[i] -= dot_padded(V(f) + i * D, tied, padded(i + 1));
        }
        mix_rows(left, D, V(f), D, D, out[f].data);
    }
}

Banded::Covariances::Covariances(double* memory, Index D) {
    double** const blocks[] = {&here, &next, &last, &between, &GN, &GW, &one, &two};
    for (double** block : blocks) {
        *block = memory;
        memory += D * D;
    }
    clear(next, D * D);
    clear(last, D * D);
    clear(between, D * D);
}

// The blocks of A^-1 from the last frame to the first, with G_N = U_ff^-1 N_f and G_W =
// U_ff^-1 W_f:
//
//   Sigma_f,f+1 = -G_N Sigma_f+1,f+1 - G_W Sigma_f+2,f+1
//   Sigma_f,f+2 = -G_N Sigma_f+1,f+2 - G_W Sigma_f+2,f+2
//   Sigma_ff = V^T V - Sigma_f,f+1 G_N^T - Sigma_f,f+2 G_W^T
void Banded::write_covariances(const SequenceData& data, const Place& at,
                               Marginal& marginal) const {
    Covariances Sigma(covariances_, D_);
    for (Index f = t_ - 1; f >= 0; --f) {
        check_interrupt();
        find_gains(data, f, Sigma);
        find_covariances(Sigma);
        marginal.write(data, at, f, Sigma.here);
        data.energies[f] = at.energies[f];
        for (Index e = 0; e < D_ * D_; ++e) Sigma.between[e] = Sigma.one[e];
        double* free = Sigma.last;
        Sigma.last = Sigma.next;
        Sigma.next = Sigma.here;
        Sigma.here = free;
    }
}

// Set Sigma.here to V^T V, G_N to V^T N and G_W to V^T V diag(tied), of frame f.
void Banded::find_gains(const SequenceData& data, Index f, Covariances& Sigma) const {
    const Index D = D_;
    multiply_out(V(f), Sigma.here, D, D);
    mirror(Sigma.here, D, D);
    find_motion_diagonal(data, f, 2, tied_);
    scale_columns(Sigma.here, tied_, D, Sigma.GW);
    clear(Sigma.GN, D * D);
    if (f + 1 < t_)
        add_product(1, transposed(V(f), D), N(f), Sigma.GN, D, D, D, D, every(D));
}

// Set the covariances of a frame with itself and the next two, from those of the next
// two.
void Banded::find_covariances(Covariances& Sigma) const {
    const Index D = D_;
    const Factor GN = plain(Sigma.GN, D), GW = plain(Sigma.GW, D);
    clear(Sigma.one, D * D);
    clear(Sigma.two, D * D);
    transpose(Sigma.between, D, turned_);
    subtract(GN, Sigma.next, Sigma.one, D);
    subtract(GW, turned_, Sigma.one, D);
    subtract(GN, Sigma.between, Sigma.two, D);
    subtract(GW, Sigma.last, Sigma.two, D);
    transpose(Sigma.GN, D, turned_);
    subtract_upper(plain(Sigma.one, D), turned_, Sigma.here, D);
    transpose(Sigma.GW, D, turned_);
    subtract_upper(plain(Sigma.two, D), turned_, Sigma.here, D);
    mirror(Sigma.here, D, D);
}

}  // namespace shapefit
