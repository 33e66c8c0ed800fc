#include "bound.hpp"

namespace shapefit::SHAPEFIT_LEVEL {
namespace {

// The coefficients: a three times, a twice and b, three different ones. `form` numbers the products
// <G_a, Q(q_b, q_c)>: 10 pairs b <= c for each a.
constexpr int PAIRS = 10;
constexpr int PAIR[PAIRS][2] = {{0, 0}, {1, 1}, {2, 2}, {3, 3}, {0, 1},
                                {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};
constexpr int NUMBER[4][4] = {{0, 4, 5, 6}, {4, 1, 7, 8}, {5, 7, 2, 9}, {6, 8, 9, 3}};
constexpr int TRIPLE[TRIPLES][3] = {
    {0, 0, 0}, {1, 1, 1}, {2, 2, 2}, {3, 3, 3}, {0, 0, 1}, {0, 1, 1}, {0, 0, 2},
    {0, 2, 2}, {0, 0, 3}, {0, 3, 3}, {1, 1, 2}, {1, 2, 2}, {1, 1, 3}, {1, 3, 3},
    {2, 2, 3}, {2, 3, 3}, {0, 1, 2}, {0, 1, 3}, {0, 2, 3}, {1, 2, 3}};
constexpr int ON_EDGE = 4;  // from this one on two triples of each edge

// Rounding of a coefficient is at most this share of max_i ||s_a G_a||; see docs/global.md.
constexpr double ROUNDING = 128 * 0x1p-53;
// By which midpoints may lie off their edges, in all generations of cells together.
constexpr double OFF_THE_EDGE = 1e-12;

// forms[a][pair] (6,) = s_a Q(q_b, q_c).
struct Forms {
    double rows[4][PAIRS][6];
    double inner[PAIRS];
};

void find_forms(const Vertex* const* corner, Forms& forms) {
    double q[4][4];
    for (int a = 0; a < 4; ++a) {
        const double sign = inner4(corner[0]->q, corner[a]->q) < 0 ? -1 : 1;
        for (int e = 0; e < 4; ++e) q[a][e] = sign * corner[a]->q[e];
    }
    for (int pair = 0; pair < PAIRS; ++pair) {
        const double *one = q[PAIR[pair][0]], *other = q[PAIR[pair][1]];
        double Q[6];
        bilinear_rows(one, other, Q);
        forms.inner[pair] = inner4(one, other);
        for (int a = 0; a < 4; ++a)
            for (int e = 0; e < 6; ++e) forms.rows[a][pair][e] = corner[a]->scale * Q[e];
    }
}

[[gnu::always_inline]] inline Lanes product(const Lanes* G, const double* Q) {
    return Q[0] * G[0] + Q[1] * G[1] + Q[2] * G[2] + Q[3] * G[3] + Q[4] * G[4] + Q[5] * G[5];
}

// The left side of every inequality at WIDTH atoms from i on; the largest so far goes to `most`.
template <bool is_signed>
[[gnu::always_inline]] inline void raise(const Vertex* const* corner, long k, long i,
                                         const Forms& forms, Lanes* most) {
    Lanes left[TRIPLES] = {};
    for (int a = 0; a < 4; ++a) {
        Lanes G[6];
        for (int e = 0; e < 6; ++e) G[e] = load(corner[a]->products + e * k + i);
#pragma GCC unroll 20
        for (int t = 0; t < TRIPLES; ++t) {
            const int *abc = TRIPLE[t];
            // how often a is among the three; the others are a pair
            if (abc[0] == a && abc[2] == a)
                left[t] += 3.0 * product(G, forms.rows[a][NUMBER[a][a]]);
            else if (abc[0] == a && abc[1] == a)
                left[t] += 2.0 * product(G, forms.rows[a][NUMBER[a][abc[2]]]);
            else if (abc[1] == a && abc[2] == a)
                left[t] += 2.0 * product(G, forms.rows[a][NUMBER[abc[0]][a]]);
            else if (abc[0] == a)
                left[t] += product(G, forms.rows[a][NUMBER[abc[1]][abc[2]]]);
            else if (abc[1] == a)
                left[t] += product(G, forms.rows[a][NUMBER[abc[0]][abc[2]]]);
            else if (abc[2] == a)
                left[t] += product(G, forms.rows[a][NUMBER[abc[0]][abc[1]]]);
        }
    }
    for (int t = 0; t < TRIPLES; ++t)
        most[t] = larger(is_signed ? magnitude(left[t]) : left[t], most[t]);
}

template <bool is_signed>
void find_largest(const Vertex* const* corner, long k, const Forms& forms, double* out) {
    Lanes most[TRIPLES];
    for (int t = 0; t < TRIPLES; ++t) most[t] = all(-INFINITE);
    for (long i = 0; i < k; i += WIDTH) raise<is_signed>(corner, k, i, forms, most);
    for (int t = 0; t < TRIPLES; ++t) out[t] = largest(most[t]);
}

}  // namespace

void CellTest::find_excess(const Vertex* const* corner, double* excess) const {
    const ReducedAtoms& atoms = objective_.atoms;
    Forms forms;
    double left[TRIPLES];
    find_forms(corner, forms);
    if (objective_.problem.is_signed)
        find_largest<true>(corner, atoms.padded_atoms, forms, left);
    else
        find_largest<false>(corner, atoms.padded_atoms, forms, left);
    double size = 0, length = 0;
    for (int a = 0; a < 4; ++a) {
        size = larger(corner[a]->scale * corner[a]->largest, size);
        length = larger(corner[a]->scale * root(corner[a]->square), length);
    }
    const double margin = 3 * ((ROUNDING + OFF_THE_EDGE) * size +
                               (atoms.q + 64) * 0x1p-52 * length * objective_.largest);
    for (int t = 0; t < TRIPLES; ++t) {
        const int a = TRIPLE[t][0], b = TRIPLE[t][1], c = TRIPLE[t][2];
        const double right = objective_.lam * (forms.inner[NUMBER[b][c]] + forms.inner[NUMBER[a][c]] +
                                               forms.inner[NUMBER[a][b]]);
        excess[t] = left[t] + margin - right;
    }
}

Verdict CellTest::judge(const Vertex* const* corner) const {
    double excess[TRIPLES];
    find_excess(corner, excess);
    Verdict verdict{true, {}};
    for (double over : excess) verdict.dropped &= over <= 0;
    for (int edge = 0; edge < EDGES; ++edge)
        verdict.excess[edge] = larger(excess[ON_EDGE + 2 * edge], excess[ON_EDGE + 2 * edge + 1]);
    return verdict;
}

}  // namespace shapefit::SHAPEFIT_LEVEL
