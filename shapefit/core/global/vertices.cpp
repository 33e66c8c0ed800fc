#include "vertices.hpp"

namespace shapefit {
namespace {

constexpr long FIRST_TABLE = 4096;

}  // namespace

Vertices::Vertices(Workspace& workspace, RotationObjective& objective, long most)
    : workspace_(workspace),
      objective_(objective),
      most_(most),
      all_(workspace.zeros<Vertex*>(most)) {}

void Vertices::begin(const RootCells& roots) {
    count_ = 0;
    if (table_ == 0) grow_table();
    for (long e = 0; e < table_; ++e) keys_[e] = 0;
    for (const double* q : roots.vertex) {
        // the best start is that of the nearest vertex so far
        int near = -1;
        for (int b = 0; b < count_; ++b)
            if (near < 0 || magnitude(inner4(q, all_[b]->q)) > magnitude(inner4(q, all_[near]->q))) near = b;
        add(q, near < 0 ? nullptr : all_[near]);
    }
}

bool Vertices::middle(int a, int b, int& number) {
    const uint64_t low = a < b ? a : b, high = a < b ? b : a;
    const uint64_t key = (high << 32 | low) + 1;
    if (2 * count_ >= table_) grow_table();
    long* place = place_of_edge(key);
    if (*place >= 0) {
        number = static_cast<int>(*place);
        return true;
    }
    if (count_ == most_) return false;
    const Vertex &one = *all_[a], &other = *all_[b];
    const double sign = inner4(one.q, other.q) < 0 ? -1 : 1;
    double q[4];
    for (int e = 0; e < 4; ++e) q[e] = one.q[e] + sign * other.q[e];
    make_unit(q);
    number = count_;
    *place = number;
    add(q, one.objective < other.objective ? &one : &other);
    return true;
}

void Vertices::set_cut(double value) {
    cut_ = value;
    ++number_of_cut_;
}

// The smaller root of s <Y, w> - s^2 ||Y||^2 / 2 = cut.
bool Vertices::reaches(Vertex& vertex) const {
    if (vertex.scaled_for != number_of_cut_) {
        const double goal = cut_ + ROUNDING * objective_.square, a = vertex.square, b = vertex.along;
        const double under = b * b - 2 * a * goal;
        // goal <= 0: 0 reaches it. The other form of the root has no difference of large numbers.
        vertex.scale = goal <= 0                ? 0
                       : under >= 0 && b > 0 ? 2 * goal / (b + root(under))
                                                : NOT_A_NUMBER;
        vertex.scaled_for = number_of_cut_;
    }
    return vertex.scale >= 0;
}

Vertex& Vertices::add(const double* q, const Vertex* like) {
    if (count_ == laid_) {
        all_[laid_] = workspace_.zeros<Vertex>(1);
        lay(*all_[laid_++]);
    }
    Vertex& vertex = *all_[count_++];
    ActiveSet& set = objective_.coefficients();
    set.clear();
    if (like)
        for (long e = 0; e < like->count; ++e) set.use(like->index[e], like->x[e], sign_of(like->x[e]));
    double R[9];
    for (int e = 0; e < 4; ++e) vertex.q[e] = q[e];
    rotation_of(q, R);
    vertex.objective = objective_.value(R);
    vertex.count = set.count;
    for (long e = 0; e < set.count; ++e) {
        vertex.index[e] = set.index[e];
        vertex.x[e] = set.x[e];
    }
    const long size = 2 * objective_.atoms.row;
    for (long j = 0; j < size; ++j) vertex.Y[j] = objective_.residual()[j];
    vertex.square = dot_padded(vertex.Y, vertex.Y, size);
    vertex.along = dot_padded(vertex.Y, objective_.w, size);
    vertex.scaled_for = -1;
    find_products(vertex);
    return vertex;
}

void Vertices::lay(Vertex& vertex) {
    const long k = objective_.atoms.k;
    const long row = padded(objective_.problem.atoms.size[2]);
    vertex.products = workspace_.zeros<double>(6 * objective_.atoms.padded_atoms);
    vertex.Y = workspace_.zeros<double>(2 * row);
    vertex.index = workspace_.zeros<long>(k);
    vertex.x = workspace_.zeros<double>(k);
}

void Vertices::find_products(Vertex& vertex) {
    const ReducedAtoms& atoms = objective_.atoms;
    const long k = atoms.padded_atoms, q = atoms.q;
    Lanes most = {};
    for (long i = 0; i < k; i += WIDTH) {
        Lanes sums[6] = {};
        for (int b = 0; b < 3; ++b)
            for (long j = 0; j < q; ++j) {
                const Lanes B = load(atoms.planes + (b * q + j) * k + i);
                sums[b] += vertex.Y[j] * B;
                sums[3 + b] += vertex.Y[atoms.row + j] * B;
            }
        Lanes squares = {};
        for (int e = 0; e < 6; ++e) {
            store(vertex.products + e * k + i, sums[e]);
            squares += sums[e] * sums[e];
        }
        most = larger(squares, most);
    }
    vertex.largest = root(largest(most));
}

void Vertices::grow_table() {
    const long before = table_;
    const uint64_t* keys = keys_;
    const long* middles = middles_;
    table_ = before == 0 ? FIRST_TABLE : 2 * before;
    keys_ = workspace_.zeros<uint64_t>(table_);
    middles_ = workspace_.zeros<long>(table_);
    for (long e = 0; e < before; ++e)
        if (keys[e] != 0) *place_of_edge(keys[e]) = middles[e];
}

// Where the middle of an edge stands; -1 where it was not known.
long* Vertices::place_of_edge(uint64_t key) {
    const uint64_t mask = table_ - 1;
    uint64_t at = key * 0x9E3779B97F4A7C15u >> 20 & mask;
    while (keys_[at] != 0 && keys_[at] != key) at = (at + 1) & mask;
    if (keys_[at] == 0) {
        keys_[at] = key;
        middles_[at] = -1;
    }
    return middles_ + at;
}

}  // namespace shapefit
