#include "record.hpp"

#include "../base/registry.hpp"
#include "search.hpp"

namespace shapefit {

TreeSize record_tree(const TreeData& data) {
    Workspace workspace;
    const RootCells roots;
    RotationObjective objective(workspace, data.problem);
    if (!objective.aim(0)) return {0, 0, false};
    CellSearch cells(workspace, objective, roots, data.most_cells);
    Cell cell;
    int edge = 0, middle = 0;
    bool complete = true;
    cells.begin_image();
    cells.vertices.set_cut(data.cut);
    cells.begin();
    while (complete && cells.take(cell)) {
        const long at = cells.tested;
        complete = at < data.most_cells;
        if (!complete) break;
        const bool dropped = cells.is_dropped(cell, edge);
        if (at < data.splits.size[0]) data.splits[at] = dropped ? -1 : edge;
        if (!dropped) complete = cells.split(cell, edge, middle);
    }
    const long p = data.problem.weights.size[1];
    for (int v = 0; v < smaller(cells.vertices.count(), data.vertices.size[0]); ++v) {
        Vertex& vertex = cells.vertices[v];
        const double scale = cells.vertices.reaches(vertex) ? vertex.scale : 0;
        for (int e = 0; e < 4; ++e) data.vertices[v][e] = vertex.q[e];
        for (int a = 0; a < 2; ++a) {
            double* Y = data.multipliers[v][a].data;
            objective.reduction.expand(vertex.Y + a * objective.atoms.row, Y, p);
            for (long j = 0; j < p; ++j) Y[j] *= scale;
        }
    }
    return {cells.tested, cells.vertices.count(), complete};
}

const Exported<record_tree> record_tree_exported{"record_tree"};

}  // namespace shapefit
