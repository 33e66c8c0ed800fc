// The global optimum of each image by branch and bound.
#include "../base/registry.hpp"
#include "objective.hpp"
#include "search.hpp"

namespace shapefit {

namespace {

constexpr int DESCENTS = 8;  // from the best of the root vertices
constexpr double ROUGH =
    1e-5;  // share of v that a step must promise while descents compete
constexpr double CLOSE =
    1e-3;  // descents within this share of the best one go on to the end
constexpr double FIRST_SHARE =
    2.0 / 3;  // of the time, for the gap asked for; the rest for looser ones
constexpr double LOOSER = 3;  // each gap to the one before, where the limit is reached
constexpr long CELLS_BETWEEN_LOOKS = 256;  // at the clock

// The best rotation so far.
struct Best {
    double q[4];
    double objective = INFINITE;

    void offer(const double* other, double value) {
        if (!(value < objective)) return;
        objective = value;
        for (int e = 0; e < 4; ++e) q[e] = other[e];
    }
};

// Descents from the given starts and from the best root vertices.
void find_upper_bound(const GlobalData& data, long image, RotationObjective& objective,
                      Vertices& vertices, Best& best) {
    const long given = data.starts.size[1];
    double q[DESCENTS + 1][4], value[DESCENTS + 1];
    bool used[ROOT_VERTICES] = {};
    const auto start_from = [&](const Vertex& vertex) {
        ActiveSet& set = objective.coefficients();
        set.clear();
        for (long e = 0; e < vertex.count; ++e)
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
        value[d] = descend(objective, q[d], ROUGH);
        best.offer(q[d], value[d]);
    }
    for (long s = 0; s < given; ++s) {
        const double* R = data.starts[image][s].data;
        bool known = true;
        for (int e = 0; e < 9; ++e) known &= is_finite(R[e]);
        if (!known) continue;
        double start[4];
        quaternion_of(R, start);
        best.offer(start, descend(objective, start, ROUGH));
    }
    best.offer(best.q, descend(objective, best.q, FINE));
}

// Where a search ended: the bound, and whether all cells were dropped.
struct Ended {
    double bound;
    bool complete;
};

// Search with the cut (1 - gap) U until all cells are dropped, or so many were tested.
Ended search(double gap, long most_cells, double deadline, RotationObjective& objective,
             CellSearch& cells, Best& best) {
    const auto lower = [&] { cells.vertices.set_cut((1 - gap) * best.objective); };
    Cell cell;
    int edge = 0, middle = 0;
    lower();
    cells.begin();
    while (cells.take(cell)) {
        const bool may_go_on =
            cells.tested < most_cells &&
            (cells.tested % CELLS_BETWEEN_LOOKS != 0 || monotonic_seconds() < deadline);
        const int before = cells.vertices.count();
        if (may_go_on && cells.is_dropped(cell, edge)) continue;
        if (!may_go_on || !cells.split(cell, edge, middle)) {
            cells.put_back(cell);
            return {cells.prove_rest(), false};
        }
        if (middle < before) continue;
        const Vertex& added = cells.vertices[middle];
        if (added.objective < best.objective) {
            best.offer(added.q, added.objective);
            best.offer(best.q, descend(objective, best.q, FINE));
            lower();
        }
    }
    return {cells.vertices.cut(), true};
}

// Search with the gap asked for, and where the limit is reached with looser ones, on as
// many cells again at most: what a search that was cut short proves is little.
Ended search_within_limits(const GlobalData& data, double begin,
                           RotationObjective& objective, CellSearch& cells,
                           Best& best) {
    const double seconds = data.limits.seconds;
    const Ended first = search(data.tolerance, data.limits.cells,
                               begin + FIRST_SHARE * seconds, objective, cells, best);
    if (first.complete) return first;
    double bound = first.bound;
    long remaining = data.limits.cells;
    for (double gap = LOOSER * data.tolerance; gap < 1; gap *= LOOSER) {
        const long before = cells.tested;
        const Ended ended = search(gap, before + remaining / 2, begin + seconds,
                                   objective, cells, best);
        bound = larger(ended.bound, bound);
        if (ended.complete) break;
        remaining -= cells.tested - before;
    }
    return {smaller(bound, best.objective), false};
}

}  // namespace

// Search all rotations for the images of the range; see docs/global.md.
void find_optimum(const GlobalData& data, Range range) {
    Workspace workspace;
    const RootCells roots;
    RotationObjective objective(workspace, data.problem);
    CellSearch cells(workspace, objective, roots, 2 * data.limits.cells);
    for (long image = range.first; image < range.last; ++image) {
        if (!objective.aim(image)) {
            data.status[image] = Status::DEGENERATE;
            continue;
        }
        Best best;
        const double begin = monotonic_seconds();
        cells.begin_image();
        find_upper_bound(data, image, objective, cells.vertices, best);
        if (!is_finite(best.objective)) {
            data.status[image] = Status::NUMERICAL_FAILURE;
            continue;
        }
        const Ended ended = search_within_limits(data, begin, objective, cells, best);
        const Rotation R = rotation_of(best.q);
        data.objective[image] = objective.value(R);
        objective.coefficients().write(data.coefficients[image]);
        R.write(data.rotation[image].data);
        data.bound[image] = larger(0, ended.bound - ROUNDING * objective.square);
        data.cells[image] = cells.tested;
        data.vertices[image] = cells.vertices.count();
        data.status[image] = ended.complete ? Status::OPTIMAL : Status::ITERATION_LIMIT;
    }
}

const Exported<find_optimum> find_optimum_exported{"find_optimum"};

}  // namespace shapefit
