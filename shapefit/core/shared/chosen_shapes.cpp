#include "chosen_shapes.hpp"

#include "../base/vectors.hpp"

namespace shapefit {
namespace {

constexpr double INDEPENDENT = 1e-8;  // share of squared limb lengths that the chosen ones lack

// out (r, 3) = A B^T for A (r, q) and B (3, q).
void multiply(const double* A, long r, const double* B, long q, double* out) {
    for (long a = 0; a < r; ++a)
        for (long b = 0; b < 3; ++b) out[3 * a + b] = dot(A + a * q, B + b * q, q);
}

}  // namespace

ChosenShapes room_for_shapes(Workspace& workspace, long most, long shapes, long q, long limbs) {
    ChosenShapes chosen;
    chosen.most = most;
    chosen.count = 0;
    chosen.Q = workspace.tensor<double>(most, 3, q);
    chosen.U = workspace.matrix<double>(most, limbs);
    chosen.T = workspace.matrix<double>(most, shapes);
    chosen.N = {workspace.zeros<double>(most * most * 9), {most, most, 3, 3}};
    chosen.Z = workspace.tensor<double>(most, 2, 3);
    chosen.free = workspace.zeros<bool>(shapes);
    return chosen;
}

bool choose_shape(long added, const ReducedImage& image, ChosenShapes& chosen) {
    const long m = chosen.count, q = image.w.size[1], l = image.limbs.size[1];
    const long shapes = image.shapes.size[0];
    double *Q = chosen.Q[m].data, *U = chosen.U[m].data, *T = chosen.T[m].data;
    const double* limbs = image.limbs[added].data;
    chosen.free[added] = false;
    for (long e = 0; e < l; ++e) U[e] = limbs[e];
    for (long e = 0; e < 3 * q; ++e) Q[e] = image.shapes[added].data[e];
    for (long i = 0; i < shapes; ++i) T[i] = i == added;
    for (int time = 0; time < 2; ++time)  // twice is enough for orthogonality to rounding
        for (long i = 0; i < m; ++i) {
            const double along = dot(chosen.U[i].data, U, l);
            add_to(U, -along, chosen.U[i].data, l);
            add_to(T, -along, chosen.T[i].data, shapes);
            add_to(Q, -along, chosen.Q[i].data, 3 * q);
        }
    const double rest = dot(U, U, l);
    if (!(rest > INDEPENDENT * dot(limbs, limbs, l))) return false;
    const double scale = 1 / root(rest);
    for (long e = 0; e < l; ++e) U[e] *= scale;
    for (long i = 0; i < shapes; ++i) T[i] *= scale;
    for (long e = 0; e < 3 * q; ++e) Q[e] *= scale;
    multiply(image.w.data, 2, Q, q, chosen.Z[m].data);
    for (long i = 0; i <= m; ++i) {
        multiply(Q, 3, chosen.Q[i].data, q, chosen.N[m][i].data);
        multiply(chosen.Q[i].data, 3, Q, q, chosen.N[i][m].data);
    }
    chosen.count = m + 1;
    return true;
}

}  // namespace shapefit
