#include "search.hpp"

namespace shapefit {

namespace {

constexpr double GOLDEN = 1.61803398874989484820;

// The even permutations of four places.
constexpr int EVEN[12][4] = {{0, 1, 2, 3}, {0, 2, 3, 1}, {0, 3, 1, 2}, {1, 0, 3, 2},
                             {1, 2, 0, 3}, {1, 3, 2, 0}, {2, 0, 1, 3}, {2, 1, 3, 0},
                             {2, 3, 0, 1}, {3, 0, 2, 1}, {3, 1, 0, 2}, {3, 2, 1, 0}};

// Write the vertices of the 600-cell modulo sign, and return their number: the units,
// (1, +-1, +-1, +-1) / 2 and the even permutations of (golden, +-1, +-1/golden, 0) / 2.
int place_vertices(double (*vertex)[4]) {
    int count = 0;
    for (int e = 0; e < 4; ++e, ++count)
        for (int f = 0; f < 4; ++f) vertex[count][f] = e == f;
    for (int signs = 0; signs < 8; ++signs, ++count) {
        vertex[count][0] = 0.5;
        for (int f = 0; f < 3; ++f) vertex[count][f + 1] = signs >> f & 1 ? -0.5 : 0.5;
    }
    for (const int* places : EVEN)
        for (int signs = 0; signs < 4; ++signs, ++count) {
            vertex[count][places[0]] = GOLDEN / 2;
            vertex[count][places[1]] = signs & 1 ? -0.5 : 0.5;
            vertex[count][places[2]] = (signs & 2 ? -0.5 : 0.5) / GOLDEN;
            vertex[count][places[3]] = 0;
        }
    return count;
}

}  // namespace

RootCells::RootCells() {
    place_vertices(vertex);
    double sign[ROOT_VERTICES]
               [ROOT_VERTICES];  // of the inner product of neighbours, else 0
    for (int a = 0; a < ROOT_VERTICES; ++a)
        for (int b = 0; b < ROOT_VERTICES; ++b) {
            const double inner = inner4(vertex[a], vertex[b]);
            sign[a][b] = a != b && magnitude(inner) > 0.8 ? sign_of(inner) : 0;
        }
    // Four are a cell where, with the signs of the first one's hemisphere, all are
    // neighbours.
    const auto join = [&](int a, int b, int c) {
        return sign[b][c] != 0 && sign[a][b] * sign[a][c] * sign[b][c] > 0;
    };
    int count = 0;
    for (int a = 0; a < ROOT_VERTICES; ++a)
        for (int b = a + 1; b < ROOT_VERTICES; ++b)
            for (int c = b + 1; sign[a][b] != 0 && c < ROOT_VERTICES; ++c)
                for (int d = c + 1; join(a, b, c) && d < ROOT_VERTICES; ++d)
                    if (join(a, b, d) && join(a, c, d))
                        cell[count++] = {{a, b, c, d}, 0};
}

namespace {

constexpr Index FIRST_TABLE = 4096;

}  // namespace

Vertices::Vertices(Workspace& workspace, RotationObjective& objective, Index most)
    : workspace_(workspace),
      objective_(objective),
      most_(most),
      all_(workspace.zeros<Vertex*>(most)) {}

void Vertices::begin(const RootCells& roots) {
    count_ = 0;
    if (table_ == 0) grow_table();
    for (Index e = 0; e < table_; ++e) keys_[e] = 0;
    for (const double* q : roots.vertex) {
        // the best start is that of the nearest vertex so far
        int near = -1;
        for (int b = 0; b < count_; ++b)
            if (near < 0 ||
                magnitude(inner4(q, all_[b]->q)) > magnitude(inner4(q, all_[near]->q)))
                near = b;
        add(q, near < 0 ? nullptr : all_[near]);
    }
}

bool Vertices::find_middle(int a, int b, int& number) {
    const uint64_t low = a < b ? a : b, high = a < b ? b : a;
    const uint64_t key = (high << 32 | low) + 1;
    if (2 * count_ >= table_) grow_table();
    Index* place = place_of_edge(key);
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
bool Vertices::reaches_cut(Vertex& vertex) const {
    if (vertex.scaled_for != number_of_cut_) {
        const double goal = cut_ + ROUNDING * objective_.square, a = vertex.square,
                     b = vertex.along;
        const double under = b * b - 2 * a * goal;
        // goal <= 0: 0 reaches it. The other form of the root has no difference of
        // large numbers.
        vertex.scale = goal <= 0             ? 0
                       : under >= 0 && b > 0 ? 2 * goal / (b + root(under))
                                             : NOT_A_NUMBER;
        vertex.scaled_for = number_of_cut_;
    }
    return vertex.scale >= 0;
}

Vertex& Vertices::add(const double* q, const Vertex* like) {
    if (count_ == allocated_) {
        all_[allocated_] = workspace_.zeros<Vertex>(1);
        allocate(*all_[allocated_++]);
    }
    Vertex& vertex = *all_[count_++];
    ActiveSet& set = objective_.coefficients();
    set.clear();
    if (like)
        for (Index e = 0; e < like->count; ++e)
            set.use(like->index[e], like->x[e], sign_of(like->x[e]));
    for (int e = 0; e < 4; ++e) vertex.q[e] = q[e];
    vertex.objective = objective_.value(rotation_of(q));
    vertex.count = set.count;
    for (Index e = 0; e < set.count; ++e) {
        vertex.index[e] = set.index[e];
        vertex.x[e] = set.x[e];
    }
    const Index size = 2 * objective_.atoms.row;
    for (Index j = 0; j < size; ++j) vertex.Y[j] = objective_.residual()[j];
    vertex.square = dot_padded(vertex.Y, vertex.Y, size);
    vertex.along = dot_padded(vertex.Y, objective_.image.w, size);
    vertex.scaled_for = -1;
    find_products(vertex);
    return vertex;
}

// Allocate the arrays of a vertex.
void Vertices::allocate(Vertex& vertex) {
    const Index k = objective_.atoms.k;
    const Index row = padded(objective_.problem.atoms.size[2]);
    vertex.products =
        workspace_.zeros<double>(6 * objective_.atoms.planes.padded_atoms);
    vertex.Y = workspace_.zeros<double>(2 * row);
    vertex.index = workspace_.zeros<Index>(k);
    vertex.x = workspace_.zeros<double>(k);
}

// Set the products of a vertex's Y with all atoms, and the largest norm of these.
void Vertices::find_products(Vertex& vertex) {
    const ReducedAtoms& atoms = objective_.atoms;
    correlate(atoms.planes, vertex.Y, vertex.Y + atoms.row, vertex.products);
    Doubles most = {};
    for (Index i = 0; i < atoms.planes.padded_atoms; i += WIDTH) {
        Doubles squares = {};
        for (int e = 0; e < 6; ++e)
            squares +=
                square(load(vertex.products + e * atoms.planes.padded_atoms + i));
        most = larger(squares, most);
    }
    vertex.largest = root(largest(most));
}

// Double the hash table of the middles of edges, and insert all known ones anew.
void Vertices::grow_table() {
    const Index before = table_;
    const uint64_t* keys = keys_;
    const Index* middles = middles_;
    table_ = before == 0 ? FIRST_TABLE : 2 * before;
    keys_ = workspace_.zeros<uint64_t>(table_);
    middles_ = workspace_.zeros<Index>(table_);
    for (Index e = 0; e < before; ++e)
        if (keys[e] != 0) *place_of_edge(keys[e]) = middles[e];
}

// The entry of the hash table for the edge of this key: the number of the vertex at its
// middle, or -1 where the edge is new.
Index* Vertices::place_of_edge(uint64_t key) {
    const uint64_t mask = table_ - 1;
    uint64_t at = key * 0x9E3779B97F4A7C15u >> 20 & mask;
    while (keys_[at] != 0 && keys_[at] != key) at = (at + 1) & mask;
    if (keys_[at] == 0) {
        keys_[at] = key;
        middles_[at] = -1;
    }
    return middles_ + at;
}

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

// Rounding of a coefficient is at most this share of max_i ||s_a G_a||; see
// docs/global.md.
constexpr double OF_COEFFICIENTS = 128 * 0x1p-53;
// By which midpoints may lie off their edges, in all generations of cells together.
constexpr double OFF_THE_EDGE = 1e-12;

// rows[a][pair] (6,) = s_a Q(q_b, q_c), as often as a, b, c stands on the left side of
// its triple.
struct Forms {
    double rows[4][PAIRS][6];
    double inner[PAIRS];
};

// The index in TRIPLE of the corner a with the corners of a pair.
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
    while (TRIPLE[t][0] != sorted[0] || TRIPLE[t][1] != sorted[1] ||
           TRIPLE[t][2] != sorted[2])
        ++t;
    return t;
}

// triple[a][pair] is triple_of(a, pair).
struct Targets {
    constexpr Targets() : triple() {
        for (int a = 0; a < 4; ++a)
            for (int pair = 0; pair < PAIRS; ++pair)
                triple[a][pair] = triple_of(a, pair);
    }
    int triple[4][PAIRS];
};
constexpr Targets TARGETS;

// Set the factors s_a Q(q_b, q_c) and the products q_b.q_c of a cell, whose corners
// take the signs of the hemisphere about the first.
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
            for (int e = 0; e < 6; ++e)
                forms.rows[a][pair][e] = often * corner[a]->scale * Q[e];
        }
    }
}

// Raise most (TRIPLES,) to the left side of each inequality at WIDTH atoms from i on.
// Not inlined: out of its loop the compiler would copy each number of the forms into a
// vector.
[[gnu::noinline]] void raise_largest(const Vertex* const* corner, Index k, Index i,
                                     const Forms& forms, Doubles* most) {
    Doubles left[TRIPLES] = {};
#pragma GCC unroll 4
    for (int a = 0; a < 4; ++a) {
        Doubles G[6];
        for (int e = 0; e < 6; ++e) G[e] = load(corner[a]->products + e * k + i);
#pragma GCC unroll 10
        for (int pair = 0; pair < PAIRS; ++pair) {
            const double* Q = forms.rows[a][pair];
            Doubles& sum = left[TARGETS.triple[a][pair]];
#pragma GCC unroll 6
            for (int e = 0; e < 6; ++e) sum += Q[e] * G[e];
        }
    }
    for (int t = 0; t < TRIPLES; ++t) most[t] = larger(left[t], most[t]);
}

// out (TRIPLES,) = the largest left side over the atoms of the inequality of each
// triple.
void find_largest(const Vertex* const* corner, Index k, const Forms& forms,
                  double* out) {
    Doubles most[TRIPLES];
    for (int t = 0; t < TRIPLES; ++t) most[t] = all(-INFINITE);
    for (Index i = 0; i < k; i += WIDTH) raise_largest(corner, k, i, forms, most);
    for (int t = 0; t < TRIPLES; ++t) out[t] = largest(most[t]);
}

// excess (TRIPLES,) = by how much the left side of each inequality exceeds the right
// one at most, rounding included.
void find_excess(const RotationObjective& objective, const Vertex* const* corner,
                 double* excess) {
    const ReducedAtoms& atoms = objective.atoms;
    Forms forms;
    double left[TRIPLES];
    find_forms(corner, forms);
    find_largest(corner, atoms.planes.padded_atoms, forms, left);
    double size = 0, length = 0;
    for (int a = 0; a < 4; ++a) {
        size = larger(corner[a]->scale * corner[a]->largest, size);
        length = larger(corner[a]->scale * root(corner[a]->square), length);
    }
    const double margin =
        3 * ((OF_COEFFICIENTS + OFF_THE_EDGE) * size +
             (atoms.q() + 64) * 0x1p-52 * length * objective.image.largest_norm);
    for (int t = 0; t < TRIPLES; ++t) {
        const int a = TRIPLE[t][0], b = TRIPLE[t][1], c = TRIPLE[t][2];
        const double right =
            objective.lam * (forms.inner[NUMBER[b][c]] + forms.inner[NUMBER[a][c]] +
                             forms.inner[NUMBER[a][b]]);
        excess[t] = left[t] + margin - right;
    }
}

}  // namespace

Verdict judge_cell(const RotationObjective& objective, const Vertex* const* corner) {
    double excess[TRIPLES];
    find_excess(objective, corner, excess);
    Verdict verdict{true, {}};
    for (double over : excess) verdict.dropped &= over <= 0;
    for (int edge = 0; edge < EDGES; ++edge)
        verdict.excess[edge] =
            larger(excess[ON_EDGE + 2 * edge], excess[ON_EDGE + 2 * edge + 1]);
    return verdict;
}

namespace {

constexpr Index MAX_WAITING_CELLS = 700;  // beside those of the 600-cell
// Share of the longest edge's 1 - q_a.q_b below which an edge is not split.
constexpr double MIN_EDGE_SHARE = 0.25;
constexpr int MAX_PASSED = 6;  // splits in a row that may spare the longest edge
constexpr int HALVINGS = 40;

}  // namespace

// With room for a vertex of each cell, as it adds one at most.
CellSearch::CellSearch(Workspace& workspace, RotationObjective& objective,
                       const RootCells& roots, Index max_cells)
    : vertices(workspace, objective, ROOT_VERTICES + max_cells),
      roots_(roots),
      objective_(objective),
      stack_(workspace.zeros<Cell>(ROOT_CELLS + MAX_WAITING_CELLS)),
      capacity_(ROOT_CELLS + MAX_WAITING_CELLS) {}

void CellSearch::begin_image() {
    vertices.begin(roots_);
    tested = 0;
}

void CellSearch::begin() {
    waiting_ = 0;
    for (int e = ROOT_CELLS; e-- > 0;) stack_[waiting_++] = roots_.cell[e];
}

bool CellSearch::take(Cell& cell) {
    if (waiting_ == 0) return false;
    cell = stack_[--waiting_];
    return true;
}

bool CellSearch::is_dropped(const Cell& cell, int& edge) {
    ++tested;
    for (int number : cell.vertex)
        if (!vertices.reaches_cut(vertices[number])) {
            edge = longest_edge(cell);
            return false;
        }
    const Verdict verdict = evaluate(cell);
    if (verdict.dropped) return true;
    edge = choose_edge(cell, verdict);
    return false;
}

// The edge to split: that with the most violation times length, among those that are
// not much shorter than others: without this cells flatten. Where no edge is violated
// the longest, and after some splits too, so that every cell gets small in the end.
int CellSearch::choose_edge(const Cell& cell, const Verdict& verdict) {
    double length[EDGES], longest = 0, most = 0;
    int chosen = longest_edge(cell);
    if (cell.passed >= MAX_PASSED) return chosen;
    for (int edge = 0; edge < EDGES; ++edge) {
        length[edge] = 1 - inner_along(cell, edge);
        longest = larger(length[edge], longest);
    }
    for (int edge = 0; edge < EDGES; ++edge) {
        const double gain = verdict.excess[edge] * length[edge];
        if (length[edge] < MIN_EDGE_SHARE * longest || !(gain > most)) continue;
        most = gain;
        chosen = edge;
    }
    return chosen;
}

bool CellSearch::split(const Cell& cell, int edge, int& middle) {
    if (waiting_ + 2 > capacity_) return false;
    const int a = EDGE[edge][0], b = EDGE[edge][1];
    if (!vertices.find_middle(cell.vertex[a], cell.vertex[b], middle)) return false;
    const int passed = edge == longest_edge(cell) ? 0 : cell.passed + 1;
    for (int end : EDGE[edge]) {
        Cell& half = stack_[waiting_++];
        half = cell;
        half.vertex[end] = middle;
        half.passed = passed;
    }
    return true;
}

double CellSearch::prove_rest() {
    const auto holds = [&](const Cell& cell, double cut) {
        vertices.set_cut(cut);
        for (int number : cell.vertex)
            if (!vertices.reaches_cut(vertices[number])) return false;
        return evaluate(cell).dropped;
    };
    double proven = vertices.cut();
    for (Index e = 0; e < waiting_; ++e) {
        if (holds(stack_[e], proven)) continue;
        double low = 0, high = proven;
        for (int count = 0; count < HALVINGS; ++count) {
            const double middle = (low + high) / 2;
            (holds(stack_[e], middle) ? low : high) = middle;
        }
        proven = low;
    }
    return proven;
}

int CellSearch::longest_edge(const Cell& cell) {
    int longest = 0;
    for (int edge = 1; edge < EDGES; ++edge)
        if (inner_along(cell, edge) < inner_along(cell, longest)) longest = edge;
    return longest;
}

// |q_a . q_b| of the ends of an edge.
double CellSearch::inner_along(const Cell& cell, int edge) {
    const Vertex &one = vertices[cell.vertex[EDGE[edge][0]]],
                 &other = vertices[cell.vertex[EDGE[edge][1]]];
    return magnitude(inner4(one.q, other.q));
}

// Test a cell all of whose vertices reach the cut.
Verdict CellSearch::evaluate(const Cell& cell) {
    check_interrupt();
    const Vertex* corner[4];
    for (int a = 0; a < 4; ++a) corner[a] = &vertices[cell.vertex[a]];
    return judge_cell(objective_, corner);
}

}  // namespace shapefit
