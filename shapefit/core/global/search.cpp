#include "search.hpp"

#include "../base/errors.hpp"

namespace shapefit {
namespace {

constexpr long DEEPEST = 700;            // cells that wait, beside those of the 600-cell
constexpr double SHORTEST_SHARE = 0.25;  // of the longest edge's 1 - q_a.q_b; shorter ones stay whole
constexpr int MOST_PASSED = 6;           // splits in a row that may spare the longest edge
constexpr int HALVINGS = 40;

}  // namespace

Clock::Clock(double seconds) : begin_(steady_seconds()), seconds_(seconds) {}

bool Clock::is_over(double share) const { return steady_seconds() - begin_ > share * seconds_; }

// A cell adds a vertex at most.
CellSearch::CellSearch(Workspace& workspace, RotationObjective& objective, const RootCells& roots,
                       long most_cells)
    : vertices(workspace, objective, ROOT_VERTICES + most_cells),
      roots_(roots),
      test_(objective),
      stack_(workspace.zeros<Cell>(ROOT_CELLS + DEEPEST)),
      room_(ROOT_CELLS + DEEPEST) {}

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
        if (!vertices.reaches(vertices[number])) {
            edge = longest_edge(cell);
            return false;
        }
    const Verdict verdict = judge(cell);
    if (verdict.dropped) return true;
    edge = choose_edge(cell, verdict);
    return false;
}

// The edge with the most violation times length, among those that are not much shorter than
// others: without this cells flatten. Where no edge is violated the longest, and after some splits
// too, so that every cell gets small in the end.
int CellSearch::choose_edge(const Cell& cell, const Verdict& verdict) {
    double length[EDGES], longest = 0, most = 0;
    int chosen = longest_edge(cell);
    if (cell.passed >= MOST_PASSED) return chosen;
    for (int edge = 0; edge < EDGES; ++edge) {
        length[edge] = 1 - inner_along(cell, edge);
        longest = larger(length[edge], longest);
    }
    for (int edge = 0; edge < EDGES; ++edge) {
        const double gain = verdict.excess[edge] * length[edge];
        if (length[edge] < SHORTEST_SHARE * longest || !(gain > most)) continue;
        most = gain;
        chosen = edge;
    }
    return chosen;
}

bool CellSearch::split(const Cell& cell, int edge, int& middle) {
    if (waiting_ + 2 > room_) return false;
    const int a = EDGE[edge][0], b = EDGE[edge][1];
    if (!vertices.middle(cell.vertex[a], cell.vertex[b], middle)) return false;
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
            if (!vertices.reaches(vertices[number])) return false;
        return judge(cell).dropped;
    };
    double proven = vertices.cut();
    for (long e = 0; e < waiting_; ++e) {
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
    const Vertex &one = vertices[cell.vertex[EDGE[edge][0]]], &other = vertices[cell.vertex[EDGE[edge][1]]];
    return magnitude(inner4(one.q, other.q));
}

Verdict CellSearch::judge(const Cell& cell) {
    const Vertex* corner[4];
    for (int a = 0; a < 4; ++a) corner[a] = &vertices[cell.vertex[a]];
    return test_.judge(corner);
}

}  // namespace shapefit
