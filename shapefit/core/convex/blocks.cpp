#include "blocks.hpp"

#include "../base/shared_loop.hpp"

namespace shapefit {

double moreau(const double* M, const double* N, double step, const double* dN,
              double sigma, double t, double* total, Index k) {
    Doubles value = {};
    for (Index i = 0; i < k; i += WIDTH) {
        const BlockLanes m = load_blocks(M, k, i), n = load_blocks(N, k, i);
        const BlockLanes d = load_blocks(dN, k, i);
        Doubles q[6];
        for (int e = 0; e < 6; ++e) q[e] = m.q[e] + sigma * (n.q[e] + step * d.q[e]);
        const Invariants<Doubles> block = invariants(q);
        const Doubles plus = nuclear_norm(block);
        const Doubles minus = block.discriminant / larger(plus, all(TINY));
        store(total + i, plus);
        // both singular values become (plus - t) / 2, or the first alone falls by t
        const Doubles excess = larger(plus - t, Doubles{}),
                      first = 0.5 * (plus + minus) - t;
        const Doubles second = 0.5 * (plus - minus);
        value += minus <= t ? 0.5 * excess * excess : first * first + second * second;
    }
    return sum(value);
}

void sum_singular_values(const double* M, const double* N, double sigma, double* total,
                         Index k) {
    for (Index i = 0; i < k; i += WIDTH) {
        const BlockLanes m = load_blocks(M, k, i), n = load_blocks(N, k, i);
        Doubles q[6];
        for (int e = 0; e < 6; ++e) q[e] = m.q[e] + sigma * n.q[e];
        store(total + i, nuclear_norm(invariants(q)));
    }
}

double largest_nuclear_norm(const double* N, Index k) {
    Doubles found = {};
    for (Index i = 0; i < k; i += WIDTH) {
        const Invariants<Doubles> block = invariants(load_blocks(N, k, i).q);
        found = larger(found, block.trace + 2.0 * block.product);
    }
    return root(largest(found));
}

namespace {

// s2 / s1, below which any direction orthogonal to v serves.
constexpr double RANK_ONE = 1e-14;
constexpr double HALF_ROOT = 0.70710678118654752440;
// Blocks whose rows a thread writes at a time where several do.
constexpr Index BLOCKS_PER_PART = 32;

// WIDTH vectors of three, one a lane.
struct Vector3 {
    Doubles x[3];
};

// Load WIDTH vectors of three, the columns c, c + 1, ... of three rows.
[[gnu::always_inline]] inline Vector3 load3(const double* rows, Index stride, Index c) {
    return {{load(rows + c), load(rows + stride + c), load(rows + 2 * stride + c)}};
}
// Store WIDTH vectors of three as the columns c, c + 1, ... of three rows.
[[gnu::always_inline]] inline void store3(double* rows, Index stride, Index c,
                                          const Vector3& v) {
    for (int b = 0; b < 3; ++b) store(rows + b * stride + c, v.x[b]);
}
// u.v, lane by lane.
[[gnu::always_inline]] inline Doubles dot(const Vector3& u, const Vector3& v) {
    return u.x[0] * v.x[0] + u.x[1] * v.x[1] + u.x[2] * v.x[2];
}
// a u + b v, lane by lane.
[[gnu::always_inline]] inline Vector3 combine(Doubles a, const Vector3& u, Doubles b,
                                              const Vector3& v) {
    return {
        {a * u.x[0] + b * v.x[0], a * u.x[1] + b * v.x[1], a * u.x[2] + b * v.x[2]}};
}
// u x v, lane by lane.
[[gnu::always_inline]] inline Vector3 cross(const Vector3& u, const Vector3& v) {
    return {{u.x[1] * v.x[2] - u.x[2] * v.x[1], u.x[2] * v.x[0] - u.x[0] * v.x[2],
             u.x[0] * v.x[1] - u.x[1] * v.x[0]}};
}

// X = U^T G V: rows X1, X2.
struct Turned {
    Vector3 first, second;
};
// X = U^T G V of WIDTH blocks of G (6, capacity) from c on, U and V of the active
// blocks.
[[gnu::always_inline]] inline Turned to_frame(const ActiveBlocks& a, const double* G,
                                              Index c) {
    const Index n = a.capacity;
    const Vector3 top = load3(G, n, c), low = load3(G + 3 * n, n, c);
    const Doubles cosine = load(a.cosine + c), sine = load(a.sine + c);
    const Vector3 along = combine(cosine, top, sine, low),
                  across = combine(cosine, low, -sine, top);
    const Vector3 v = load3(a.v, n, c), w = load3(a.w, n, c), z = load3(a.z, n, c);
    return {{{dot(along, v), dot(along, w), dot(along, z)}},
            {{dot(across, v), dot(across, w), dot(across, z)}}};
}

}  // namespace

ActiveBlocks::ActiveBlocks(Workspace& workspace, Index padded_atoms)
    : capacity(padded_atoms) {
    index = workspace.zeros<Index>(capacity);
    const auto rows = [&](Index count) {
        return workspace.zeros<double>(count * capacity);
    };
    argument = rows(6), prox = rows(6), weight = rows(6);
    v = rows(3), w = rows(3), z = rows(3);
    cosine = rows(1), sine = rows(1), norm = rows(1);
    first = rows(1), second = rows(1), difference = rows(1);
    row_ = rows(42);
}

void ActiveBlocks::find(const double* M, const double* N, double sigma, double t,
                        const double* total, Index k) {
    count = 0;
    for (Index i = 0; i < k; ++i) {
        index[count < capacity ? count : capacity - 1] = i;
        count += total[i] > t;
    }
    for (Index c = 0; c < count; ++c)
        for (int e = 0; e < 6; ++e)
            argument[e * capacity + c] =
                M[e * k + index[c]] + sigma * N[e * k + index[c]];
    for (Index c = 0; c < count; c += WIDTH) svd_and_prox(c, t);
    norms = 0;
    for (Index c = 0; c < count; ++c) norms += norm[c];
}

// Find the singular vectors and the prox of blocks c, c + 1, ... c + WIDTH - 1.
void ActiveBlocks::svd_and_prox(Index c, double t) {
    const Index n = capacity;
    const Vector3 x = load3(argument, n, c), y = load3(argument + 3 * n, n, c),
                  normal = cross(x, y);
    const Doubles A = dot(x, x), C = dot(y, y), D = dot(x, y),
                  product = root(dot(normal, normal));
    const Doubles plus = root(A + C + 2.0 * product);
    const Doubles half = 0.5 * (A - C), radius = root(half * half + D * D);
    const Doubles minus = 2.0 * radius / plus, s1 = 0.5 * (plus + minus),
                  s2 = product / s1;

    // u1 = (cosine, sine) is the eigenvector of [[A, D], [D, C]] for s1^2.
    const Doubles a = half >= 0.0 ? half + radius : D,
                  b = half >= 0.0 ? D : radius - half;
    const Doubles span = root(a * a + b * b);
    const Doubles u = span > 0.0 ? a / span : all(1),
                  s = span > 0.0 ? b / span : Doubles{};

    const Doubles none = {};
    Vector3 right = combine(u, x, s, y), other = combine(u, y, -s, x);
    right = combine(1.0 / root(dot(right, right)), right, none, right);
    other = combine(all(1), other, -dot(other, right), right);
    const auto thin = root(dot(other, other)) <= RANK_ONE * s1;
    const auto flat = magnitude(right.x[0]) < 0.7;
    const Vector3 any = {{flat ? none : -right.x[1], flat ? -right.x[2] : right.x[0],
                          flat ? right.x[1] : none}};
    for (int e = 0; e < 3; ++e) other.x[e] = thin ? any.x[e] : other.x[e];
    other = combine(1.0 / root(dot(other, other)), other, none, other);

    const auto equal = minus <= t;
    const Doubles both = larger(0.5 * (plus - t), none);
    const Doubles f1 = equal ? both : s1 - t, f2 = equal ? both : s2;
    store(cosine + c, u), store(sine + c, s);
    store(first + c, s1), store(second + c, s2), store(difference + c, minus);
    store(norm + c, f1);
    store3(v, n, c, right), store3(w, n, c, other),
        store3(z, n, c, cross(right, other));
    store3(prox, n, c, combine(f1 * u, right, -f2 * s, other));
    store3(prox + 3 * n, n, c, combine(f1 * s, right, f2 * u, other));
}

void ActiveBlocks::weigh(double t, Weighing weighing) {
    const Index n = capacity;
    const bool resolvent = weighing == Weighing::resolvent;
    const double whole = resolvent ? MAX_WEIGHT : 1;
    const Doubles none = {}, most = all(whole);
    // The eigenvalue is part / (part + rest).
    const auto weigh_one = [&](Doubles part, Doubles rest) {
        const Doubles base = resolvent ? rest : part + rest;
        return base > 0.0 ? smaller(part / base, most) : part > 0.0 ? most : none;
    };
    for (Index c = 0; c < count; c += WIDTH) {
        const Doubles s1 = load(first + c), s2 = load(second + c), f1 = load(norm + c);
        const Doubles plus = s1 + s2, minus = load(difference + c), level = all(t);
        const auto equal = minus <= t;
        store(weight + c, most);
        store(weight + n + c, weigh_one(larger(plus - t, none), level));
        store(weight + 2 * n + c, weigh_one(f1, equal ? 0.5 * (minus + t) : level));
        const Doubles rest = larger(0.5 * (t - minus), none);
        const Doubles third = s2 > 0.0 ? weigh_one(f1, rest) : none;
        store(weight + 3 * n + c, equal ? third : most);
        store(weight + 4 * n + c, equal ? none : most);
        store(weight + 5 * n + c, equal ? none : weigh_one(minus - t, level));
    }
}

// The rows of direction r are `top` and `low`, three numbers each, so that its row of F
// is (top . B, low . B).
void ActiveBlocks::find_directions(double sigma, const double* moved) {
    const Index n = capacity;
    const Doubles none = {};
    for (Index c = 0; c < count; c += WIDTH) {
        const Vector3 v1 = load3(v, n, c), w1 = load3(w, n, c), z1 = load3(z, n, c);
        const Doubles u = load(cosine + c), s = load(sine + c);
        Turned X = {};
        if (moved) X = to_frame(*this, moved, c);
        const Doubles along[6] = {X.first.x[0] + X.second.x[1],
                                  X.first.x[1] - X.second.x[0],
                                  X.first.x[2],
                                  X.second.x[2],
                                  X.first.x[0] - X.second.x[1],
                                  X.first.x[1] + X.second.x[0]};
        const Vector3 top[6] = {combine(u, v1, -s, w1),   combine(s, v1, u, w1),
                                combine(u, z1, none, z1), combine(-s, z1, none, z1),
                                combine(u, v1, s, w1),    combine(-s, v1, u, w1)};
        const Vector3 low[6] = {combine(s, v1, u, w1),    combine(-u, v1, s, w1),
                                combine(s, z1, none, z1), combine(u, z1, none, z1),
                                combine(s, v1, -u, w1),   combine(u, v1, s, w1)};
        for (int r = 0; r < 6; ++r) {
            const double unit = r == 2 || r == 3 ? 1 : HALF_ROOT;
            const Doubles scale = unit * root(sigma * load(weight + r * n + c));
            store3(row_ + 7 * r * n, n, c, combine(scale, top[r], none, top[r]));
            store3(row_ + (7 * r + 3) * n, n, c, combine(scale, low[r], none, low[r]));
            store(row_ + (7 * r + 6) * n + c, -scale / sigma * along[r]);
        }
    }
}

// Write the rows (top . B, low . B) of one block for so many directions, the numbers of
// each `capacity` apart, to rows `stride` apart.
template <int directions>
[[gnu::always_inline]] inline void write_block(const double* number, Index capacity,
                                               const double* B, Index atom_stride,
                                               Index q, double* row, Index stride) {
    for (int half = 0; half < 2; ++half)  // the second writes over what pads the first
        for (Index j = 0; j < atom_stride; j += WIDTH) {
            const Doubles b0 = load(B + j), b1 = load(B + atom_stride + j);
            const Doubles b2 = load(B + 2 * atom_stride + j);
            for (int r = 0; r < directions; ++r) {
                const double* t = number + (7 * r + 3 * half) * capacity;
                store(row + r * stride + half * q + j,
                      t[0] * b0 + t[capacity] * b1 + t[2 * capacity] * b2);
            }
        }
}

// Write the rows of block c, of the atom B, from row `first` of F on.
void ActiveBlocks::write_rows_of(Index c, const double* B, Index atom_stride,
                                 Index first, ShiftedGram& gram) const {
    const Index unknowns = gram.unknowns(), q = unknowns / 2, right = gram.right_side();
    const double* number = row_ + c;
    const int count = directions(c);
    double* row = gram.row(first);
    if (count == 4)
        write_block<4>(number, capacity, B, atom_stride, q, row, gram.stride());
    else write_block<6>(number, capacity, B, atom_stride, q, row, gram.stride());
    for (int r = 0; r < count; ++r, row += gram.stride()) {
        for (Index j = unknowns; j < right; ++j) row[j] = 0;
        row[right] = number[(7 * r + 6) * capacity];
    }
}

// The number of rows of the blocks before block c.
Index ActiveBlocks::rows_before(Index c) const {
    Index rows = 0;
    for (Index d = 0; d < c; ++d) rows += directions(d);
    return rows;
}

Index ActiveBlocks::write_rows(ReducedAtoms& atoms, ShiftedGram& gram) const {
    const Index rows = rows_before(count);
    const double multiplications = 3.0 * rows * gram.unknowns();
    const auto write_some = [&](Index first, Index end) {
        Index row = rows_before(first);
        for (Index c = first; c < end; ++c) {
            write_rows_of(c, atoms[index[c]], atoms.row, row, gram);
            row += directions(c);
        }
    };
    share_out(0, count, BLOCKS_PER_PART, multiplications, write_some);
    return rows;
}

void ActiveBlocks::apply_weights(const double* X, double* out) const {
    const Index n = capacity;
    for (Index c = 0; c < count; c += WIDTH) {
        const Turned G = to_frame(*this, X, c);
        const auto scaled = [&](int r, Doubles value) {
            return load(weight + r * n + c) * value;
        };
        const Doubles same = scaled(0, 0.5 * (G.first.x[0] + G.second.x[1]));
        const Doubles skew = scaled(1, 0.5 * (G.first.x[1] - G.second.x[0]));
        const Doubles differ = scaled(4, 0.5 * (G.first.x[0] - G.second.x[1]));
        const Doubles symmetric = scaled(5, 0.5 * (G.first.x[1] + G.second.x[0]));
        const Vector3 v1 = load3(v, n, c), w1 = load3(w, n, c), z1 = load3(z, n, c);
        const Doubles one = all(1);
        const Vector3 along =
            combine(one, combine(same + differ, v1, symmetric + skew, w1),
                    scaled(2, G.first.x[2]), z1);
        const Vector3 across =
            combine(one, combine(symmetric - skew, v1, same - differ, w1),
                    scaled(3, G.second.x[2]), z1);
        const Doubles u = load(cosine + c), s = load(sine + c);
        store3(out, n, c, combine(u, along, -s, across));
        store3(out + 3 * n, n, c, combine(s, along, u, across));
    }
}

void ActiveBlocks::subtract_fit(ReducedAtoms& atoms, double* y0, double* y1,
                                Index q) const {
    const Index stride = atoms.row, n = capacity;
    for (Index j = 0; j < q; j += WIDTH) {
        Doubles top = {}, low = {};
        for (Index c = 0; c < count; ++c) {
            const double *B = atoms[index[c]] + j, *m = prox + c;
            const Doubles b0 = load(B), b1 = load(B + stride),
                          b2 = load(B + 2 * stride);
            top += m[0] * b0 + m[n] * b1 + m[2 * n] * b2;
            low += m[3 * n] * b0 + m[4 * n] * b1 + m[5 * n] * b2;
        }
        for (int lane = 0; lane < WIDTH && j + lane < q; ++lane) {
            y0[j + lane] -= top[lane];
            y1[j + lane] -= low[lane];
        }
    }
}

}  // namespace shapefit
