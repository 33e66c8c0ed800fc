// The test of a cell: whether no rotation in it has an objective below the cut.
//
// At q = sum_a mu_a q_a, mu >= 0, sum_a mu_a = 1, the multiplier Y(mu) = sum_a mu_a s_a Y_a has a value
// D >= cut, for D is concave and reaches the cut at the vertices. It is feasible where for every
// atom <Y(mu), Q(q, q) B_i> <= lambda |q|^2. Both sides are cubic in mu; in Bernstein form the
// inequality holds on the whole cell if it holds for the coefficients of all a <= b <= c:
//
//   s_a <G_a, Q(q_b, q_c)> + s_b <G_b, Q(q_a, q_c)> + s_c <G_c, Q(q_a, q_b)>
//       <= lambda (q_b.q_c + q_a.q_c + q_a.q_b),          G_a = Y_a B_i^T.
//
// Rounding is on the safe side: lambda is lowered by what it may add to the left.
#pragma once

#include "vertices.hpp"

namespace shapefit {

// Whether all coefficients hold, and if not by how much they fail at most: of the two on each edge.
struct Verdict {
    bool dropped;
    double excess[EDGES];
};

constexpr int TRIPLES = 20;

class CellTest {
  public:
    CellTest(const RotationObjective& objective) : objective_(objective) {}

    // Four vertices that reach the cut, in any signs.
    Verdict judge(const Vertex* const* corner) const;

    // By how much the left side of each inequality exceeds the right one, rounding included.
    void find_excess(const Vertex* const* corner, double* excess) const;

  private:
    const RotationObjective& objective_;
};

}  // namespace shapefit
