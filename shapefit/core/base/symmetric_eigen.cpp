#include "symmetric_eigen.hpp"

#include "registry.hpp"
#include "scalar.hpp"

namespace shapefit {
namespace {

constexpr int MOST_SWEEPS = 30;
constexpr double ROUNDING = 0x1p-56;  // of an entry beside the norm of the matrix

double norm(Matrix<const double> A) {
    double total = 0;
    for (long e = 0; e < A.size[0] * A.size[1]; ++e) total += square(A.data[e]);
    return root(total);
}

// (x, y) <- (c x - s y, s x + c y)
void turn(double c, double s, double* __restrict x, double* __restrict y, long count) {
    for (long e = 0; e < count; ++e) {
        const double before = x[e];
        x[e] = c * before - s * y[e];
        y[e] = s * before + c * y[e];
    }
}

// Turn axes p and q so that A_pq becomes 0.
void rotate(Matrix<double> A, Matrix<double> V, long p, long q) {
    const long m = A.size[0];
    const double pp = A[p][p], qq = A[q][q], pq = A[p][q];
    const double ratio = (qq - pp) / (2 * pq);
    const double tangent = copysign(1.0, ratio) / (magnitude(ratio) + root(1 + square(ratio)));
    const double c = 1 / root(1 + square(tangent)), s = c * tangent;
    turn(c, s, A[p].data, A[q].data, m);
    turn(c, s, V[p].data, V[q].data, m);
    for (long j = 0; j < m; ++j) {
        A[j][p] = A[p][j];
        A[j][q] = A[q][j];
    }
    A[p][p] = pp - tangent * pq;
    A[q][q] = qq + tangent * pq;
    A[p][q] = A[q][p] = 0;
}

// Exchange rows so that the values ascend.
void sort(Vector<double> values, Matrix<double> V) {
    const long m = values.size[0];
    for (long i = 0; i < m; ++i) {
        long least = i;
        for (long j = i + 1; j < m; ++j)
            if (values[j] < values[least]) least = j;
        if (least == i) continue;
        const double value = values[i];
        values[i] = values[least];
        values[least] = value;
        for (long e = 0; e < m; ++e) {
            const double entry = V[i][e];
            V[i][e] = V[least][e];
            V[least][e] = entry;
        }
    }
}

}  // namespace

void symmetric_eigen(Matrix<double> A, Vector<double> values, Matrix<double> V) {
    const long m = A.size[0];
    for (long i = 0; i < m; ++i)
        for (long j = 0; j < m; ++j) V[i][j] = i == j;
    const double negligible = ROUNDING * norm({A.data, {m, m}});
    for (int sweep = 0; sweep < MOST_SWEEPS; ++sweep) {
        bool still = true;
        for (long p = 0; p < m; ++p)
            for (long q = p + 1; q < m; ++q)
                if (magnitude(A[p][q]) > negligible) {
                    rotate(A, V, p, q);
                    still = false;
                }
        if (still) break;
    }
    for (long i = 0; i < m; ++i) values[i] = A[i][i];
    sort(values, V);
}

const Exported<symmetric_eigen> symmetric_eigen_exported{"symmetric_eigen", PART};

}  // namespace shapefit
