#include "bound.hpp"

namespace shapefit {
namespace {

// The coefficients a <= b <= c, and the pairs b <= c.
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
constexpr double OF_COEFFICIENTS = 128 * 0x1p-53;
// By which midpoints may lie off their edges, in all generations of cells together.
constexpr double OFF_THE_EDGE = 1e-12;

// rows[a][pair] (6,) = s_a Q(q_b, q_c), as often as a, b, c stands on the left side of its triple.
struct Forms {
    double rows[4][PAIRS][6];
    double inner[PAIRS];
};

// The triple of a and a pair.
constexpr int triple_of(int a, int pair) {
    int sorted[3] = {a, PAIR[pair][0], PAIR[pair][1]};
    for (int pass = 0; pass < 2; ++pass)
        for (int e = 0; e < 2; ++e)
            if (sorted[e] > sorted[e + 1]) {
                const int low = sorted[e + 1];
                sorted[e + 1] = sorted[e];
                sorted[e] = low;
            }
    int t = 0;
    while (TRIPLE[t][0] != sorted[0] || TRIPLE[t][1] != sorted[1] || TRIPLE[t][2] != sorted[2]) ++t;
    return t;
}

struct Targets {
    constexpr Targets() : triple() {
        for (int a = 0; a < 4; ++a)
            for (int pair = 0; pair < PAIRS; ++pair) triple[a][pair] = triple_of(a, pair);
    }
    int triple[4][PAIRS];
};
constexpr Targets TARGETS;

// The signs of the corners are those of the hemisphere about the first.
void find_forms(const Vertex* const* corner, Forms& forms) {
    double q[4][4];
    for (int a = 0; a < 4; ++a) {
        const double sign = inner4(corner[0]->q, corner[a]->q) < 0 ? -1 : 1;
        for (int e = 0; e < 4; ++e) q[a][e] = sign * corner[a]->q[e];
    }
    for (int pair = 0; pair < PAIRS; ++pair) {
        const int b = PAIR[pair][0], c = PAIR[pair][1];
        double Q[6];
        bilinear_rows(q[b], q[c], Q);
        forms.inner[pair] = inner4(q[b], q[c]);
        for (int a = 0; a < 4; ++a) {
            const int often = 1 + (a == b) + (a == c);
            for (int e = 0; e < 6; ++e) forms.rows[a][pair][e] = often * corner[a]->scale * Q[e];
        }
    }
}

// The left side of every inequality at WIDTH atoms from i on; the largest so far goes to `most`.
// Not inlined: out of its loop the compiler would copy each number of the forms into a vector.
template <bool is_signed>
[[gnu::noinline]] void raise(const Vertex* const* corner, long k, long i, const Forms& forms,
                             Lanes* most) {
    Lanes left[TRIPLES] = {};
#pragma GCC unroll 4
    for (int a = 0; a < 4; ++a) {
        Lanes G[6];
        for (int e = 0; e < 6; ++e) G[e] = load(corner[a]->products + e * k + i);
#pragma GCC unroll 10
        for (int pair = 0; pair < PAIRS; ++pair) {
            const double* Q = forms.rows[a][pair];
            Lanes& sum = left[TARGETS.triple[a][pair]];
#pragma GCC unroll 6
            for (int e = 0; e < 6; ++e) sum += Q[e] * G[e];
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
    const double margin = 3 * ((OF_COEFFICIENTS + OFF_THE_EDGE) * size +
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

}  // namespace shapefit
