// Branch and bound over all rotations: cells of unit quaternions, depth first, with one
// cut. A cell is dropped where the dual proves
//
//     v(R(q)) >= cut   for all q = sum_a mu_a q_a / |sum_a mu_a q_a|, mu >= 0,
//
// over its vertices q_1 .. q_4; another one is split at the middle of an edge. What is
// proven by a multiplier Y at a rotation R: for every s with s <Y, Rbar B_i> <= lambda
//
//     v(R) >= D(s Y) = s <Y, w> - s^2/2 ||Y||^2.
#pragma once

#include "objective.hpp"

namespace shapefit {

// Cells of rotations: cones over four unit quaternions, of which q and -q are one
// rotation.
//
// The 600-cell has 120 vertices and 600 tetrahedra; modulo sign 60 and 300, which cover
// all rotations. Neighbouring vertices are 72 degrees of rotation apart.

// Four vertices, by number. Their signs are those of the hemisphere about the first.
struct Cell {
    int vertex[4];
    int passed = 0;  // splits in a row that spared its longest edge
};

constexpr int ROOT_VERTICES = 60, ROOT_CELLS = 300;
constexpr int EDGES = 6;
constexpr int EDGE[EDGES][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};

// The 600-cell modulo sign.
struct RootCells {
    RootCells();

    double vertex[ROOT_VERTICES][4];
    Cell cell[ROOT_CELLS];
};

// The vertices of an image's cells: at each rotation the best coefficients, and their
// multiplier Y = w - Rbar sum_i c_i B_i, which is feasible there. s is the least factor
// at which D(s Y) reaches the cut.

struct Vertex {
    double q[4];
    double objective;  // v
    double square;     // ||Y||^2
    double along;      // <Y, w>
    double largest;    // max_i ||Y B_i^T||_F
    double scale;      // s; nan where no scaled Y reaches the cut
    Index scaled_for;  // number of the cut
    double* products;  // Y B_i^T (6, padded k), atoms innermost
    double* Y;         // (2, row)
    Index count;       // coefficients that are not 0
    Index* index;      // (capacity,) their atoms
    double* x;         // (capacity,)
};

// All vertices of an image's cells, by number.
class Vertices {
  public:
    Vertices(Workspace& workspace, RotationObjective& objective, Index most);

    // Forget all vertices, and add those of the 600-cell.
    void begin(const RootCells& roots);

    // Add a vertex at q; the minimisation of its coefficients starts from those of the
    // vertex `like`, if any.
    Vertex& add(const double* q, const Vertex* like);

    // Set `number` to that of the vertex half-way between vertices a and b, which is
    // added where it is new; false where there is no memory for it.
    bool find_middle(int a, int b, int& number);

    // Set the cut, which D(s Y) of a vertex has to reach.
    void set_cut(double value);

    // Whether D(s Y) of a vertex reaches the cut for any s; `scale` is set to the
    // least.
    bool reaches_cut(Vertex& vertex) const;

    Vertex& operator[](int number) { return *all_[number]; }
    int count() const { return count_; }
    double cut() const { return cut_; }

  private:
    void allocate(Vertex& vertex);
    void find_products(Vertex& vertex);
    void grow_table();
    Index* place_of_edge(uint64_t key);

    Workspace& workspace_;
    RotationObjective& objective_;
    const Index most_;
    Vertex** all_;
    int allocated_ = 0, count_ = 0;  // of all_: with memory, and in use
    double cut_ = 0;
    Index number_of_cut_ = 0;
    uint64_t* keys_ = nullptr;  // of the edges whose middle is known: open addressing
    Index* middles_ = nullptr;
    Index table_ = 0;
};

// The test of a cell: whether no rotation in it has an objective below the cut.
//
// At q = sum_a mu_a q_a, mu >= 0, sum_a mu_a = 1, the multiplier Y(mu) = sum_a mu_a s_a
// Y_a has a value D >= cut, for D is concave and reaches the cut at the vertices. It is
// feasible where for every atom <Y(mu), Q(q, q) B_i> <= lambda |q|^2. Both sides are
// cubic in mu; in Bernstein form the inequality holds on the whole cell if it holds for
// the coefficients of all a <= b <= c:
//
//   s_a <G_a, Q(q_b, q_c)> + s_b <G_b, Q(q_a, q_c)> + s_c <G_c, Q(q_a, q_b)>
//       <= lambda (q_b.q_c + q_a.q_c + q_a.q_b),          G_a = Y_a B_i^T.
//
// Rounding is on the safe side: lambda is lowered by what it may add to the left.

// Whether all coefficients hold, and if not by how much they fail at most: of the two
// on each edge.
struct Verdict {
    bool dropped;
    double excess[EDGES];
};

constexpr int TRIPLES = 20;

// Test the cell of four vertices that reach the cut, whose quaternions may have either
// sign.
Verdict judge_cell(const RotationObjective& objective, const Vertex* const* corner);

// The cells of an image that are still to be tested, and the test and split of each.
class CellSearch {
  public:
    CellSearch(Workspace& workspace, RotationObjective& objective,
               const RootCells& roots, Index max_cells);

    // Start a search with the cells of the 600-cell; vertices that were added before
    // stay.
    void begin();

    // Begin with the image of the objective, and the vertices of the 600-cell.
    void begin_image();

    // Take the next cell to test; false where none is left.
    bool take(Cell& cell);

    // Whether it is proven that the cell holds no rotation with an objective below the
    // cut. If not, `edge` is set to the one to split.
    bool is_dropped(const Cell& cell, int& edge);

    // Let the two halves of a cell, split at the middle of an edge, wait for their
    // tests; `middle` is set to the number of the vertex there. False where there is no
    // memory for them.
    bool split(const Cell& cell, int edge, int& middle);

    // Let a cell wait for its test again.
    void put_back(const Cell& cell) { stack_[waiting_++] = cell; }

    // Find the largest cut, at most the present one, at which all cells that wait can
    // be dropped; returns it.
    double prove_rest();

    // The edge of a cell whose ends are rotations farthest apart.
    int longest_edge(const Cell& cell);

    Vertices vertices;
    Index tested = 0;  // cells of the image

  private:
    Verdict evaluate(const Cell& cell);
    int choose_edge(const Cell& cell, const Verdict& verdict);
    double inner_along(const Cell& cell, int edge);

    const RootCells& roots_;
    const RotationObjective& objective_;
    Cell* stack_;
    Index waiting_ = 0, capacity_;
};

}  // namespace shapefit
