// The global optimum min v(R) of each image (objective.hpp), by branch and bound.
#include "../base/registry.hpp"
#include "objective.hpp"
#include "search.hpp"

namespace shapefit {

namespace {

// Descents from the best of the root vertices.
constexpr int DESCENTS = 8;
// Share of v that each step must promise to take off while descents compete.
constexpr double FIRST_PROMISED_FALL = 1e-5;
// Factor from one gap to the next, where the limit of cells is reached.
constexpr double GAP_GROWTH = 3;

// The best rotation so far.
struct Best {
    double q[4];
    double objective = INFINITE;

    // Replace the best rotation by another one where its objective `value` is smaller.
    void offer(const double* other, double value) {
        if (!(value < objective)) return;
        objective = value;
        for (int e = 0; e < 4; ++e) q[e] = other[e];
    }
};

// Set `best` by descents from the given starts and from the best root vertices.
void find_upper_bound(const GlobalData& data, Index image, RotationObjective& objective,
                      Vertices& vertices, Best& best) {
    const Index given = data.starts.size[1];
    double q[DESCENTS + 1][4], value[DESCENTS + 1];
    bool used[ROOT_VERTICES] = {};
    const auto start_from = [&](const Vertex& vertex) {
        ActiveSet& set = objective.coefficients();
        set.clear();
        for (Index e = 0; e < vertex.count; ++e)
            set.use(vertex.index[e], vertex.x[e], sign_of(vertex.x[e]));
    };
    for (int d = 0; d < DESCENTS; ++d) {
        int least = -1;
        for (int v = 0; v < ROOT_VERTICES; ++v)
            if (!used[v] &&
                (least < 0 || vertices[v].objective < vertices[least].objective))
                least = v;
        used[least] = true;
        for (int e = 0; e < 4; ++e) q[d][e] = vertices[least].q[e];
        start_from(vertices[least]);
        value[d] = descend(objective, q[d], FIRST_PROMISED_FALL);
        best.offer(q[d], value[d]);
    }
    for (Index s = 0; s < given; ++s) {
        const double* R = data.starts[image][s].data;
        bool known = true;
        for (int e = 0; e < 9; ++e) known &= is_finite(R[e]);
        if (!known) continue;
        double start[4];
        quaternion_of(R, start);
        best.offer(start, descend(objective, start, FIRST_PROMISED_FALL));
    }
    best.offer(best.q, descend(objective, best.q, LAST_PROMISED_FALL));
}

// Where a search ended: the bound, and whether all cells were dropped.
struct SearchEnd {
    double bound;
    bool complete;
};

// The cells that a search drops, as the caller is given them.
class DroppedCells {
  public:
    DroppedCells(const GlobalData& data, Index image)
        : count_(data.dropped[image]),
          corners_(data.corners[image]),
          cuts_(data.cuts[image]) {}

    // Forget all cells.
    void clear() { count_ = 0; }

    // Write the corners of a cell and the cut it was dropped at, if there is room.
    void add(const Cell& cell, Vertices& vertices) {
        if (count_ == cuts_.size[0]) return;
        for (int a = 0; a < 4; ++a)
            for (int e = 0; e < 4; ++e)
                corners_[count_][a][e] = vertices[cell.vertex[a]].q[e];
        cuts_[count_++] = vertices.cut();
    }

  private:
    int64_t& count_;
    Tensor<double> corners_;
    Vector<double> cuts_;
};

// Search all rotations with the cut (1 - gap) U until all cells are dropped, or so many
// were tested; `best` is replaced by any better rotation on the way.
SearchEnd search(double gap, Index max_cells, RotationObjective& objective,
                 CellSearch& cells, Best& best, DroppedCells& dropped) {
    const auto lower = [&] { cells.vertices.set_cut((1 - gap) * best.objective); };
    Cell cell;
    int edge = 0, middle = 0;
    lower();
    cells.begin();
    dropped.clear();
    while (cells.take(cell)) {
        const bool may_go_on = cells.tested < max_cells;
        const int before = cells.vertices.count();
        if (may_go_on && cells.is_dropped(cell, edge)) {
            dropped.add(cell, cells.vertices);
            continue;
        }
        if (!may_go_on || !cells.split(cell, edge, middle)) {
            cells.put_back(cell);
            return {cells.prove_rest(), false};
        }
        if (middle < before) continue;
        const Vertex& added = cells.vertices[middle];
        if (added.objective < best.objective) {
            best.offer(added.q, added.objective);
            best.offer(best.q, descend(objective, best.q, LAST_PROMISED_FALL));
            lower();
        }
    }
    return {cells.vertices.cut(), true};
}

// Search with the gap asked for and, where the limit of cells is reached, again with
// wider gaps, on as many cells again at most: a search that was cut short proves
// little.
SearchEnd search_within_limits(const GlobalData& data, RotationObjective& objective,
                               CellSearch& cells, Best& best, DroppedCells& dropped) {
    const SearchEnd first =
        search(data.tolerance, data.max_cells, objective, cells, best, dropped);
    if (first.complete) return first;
    double bound = first.bound;
    Index remaining = data.max_cells;
    for (double gap = GAP_GROWTH * data.tolerance; gap < 1; gap *= GAP_GROWTH) {
        const Index before = cells.tested;
        const SearchEnd end =
            search(gap, before + remaining / 2, objective, cells, best, dropped);
        bound = larger(end.bound, bound);
        if (end.complete) break;
        remaining -= cells.tested - before;
    }
    return {smaller(bound, best.objective), false};
}

}  // namespace

// Write the optimum over all rotations, and a bound below it, for each image of the
// range; see docs/global.md.
void find_optimum(const GlobalData& data, Range range) {
    Workspace workspace;
    const RootCells roots;
    RotationObjective objective(workspace, data.problem);
    CellSearch cells(workspace, objective, roots, 2 * data.max_cells);
    for (Index image = range.first; image < range.last; ++image) {
        if (!objective.set_image(image)) {
            data.status[image] = Status::DEGENERATE;
            continue;
        }
        Best best;
        const bool is_solvable = data.problem.lam[image] >= MIN_LAMBDA;
        if (is_solvable) {
            cells.begin_image();
            find_upper_bound(data, image, objective, cells.vertices, best);
        }
        if (!is_finite(best.objective)) {
            data.status[image] = Status::NUMERICAL_FAILURE;
            continue;
        }
        DroppedCells dropped(data, image);
        const SearchEnd end =
            search_within_limits(data, objective, cells, best, dropped);
        const Rotation R = rotation_of(best.q);
        data.objective[image] = objective.value(R);
        objective.coefficients().write(data.coefficients[image]);
        R.write(data.rotation[image].data);
        data.bound[image] = larger(0, end.bound - ROUNDING * objective.square);
        data.cells[image] = cells.tested;
        data.vertices[image] = cells.vertices.count();
        data.status[image] = end.complete ? Status::OPTIMAL : Status::ITERATION_LIMIT;
    }
}

const Exported<find_optimum> find_optimum_exported{"find_optimum"};

}  // namespace shapefit
