#include "parts.hpp"

#include "../base/registry.hpp"
#include "bound.hpp"
#include "descent.hpp"

namespace shapefit {

void root_cells(Matrix<double> vertices, Matrix<int64_t> cells) {
    const RootCells roots;
    for (int v = 0; v < ROOT_VERTICES; ++v)
        for (int e = 0; e < 4; ++e) vertices[v][e] = roots.vertex[v][e];
    for (int c = 0; c < ROOT_CELLS; ++c)
        for (int a = 0; a < 4; ++a) cells[c][a] = roots.cell[c].vertex[a];
}

bool judge_alone(const CellData& cell) {
    const Vector<double> excess = cell.excess;
    Workspace workspace;
    RotationObjective objective(workspace, cell.problem);
    objective.aim(0);
    Vertices vertices(workspace, objective, 4);
    vertices.set_cut(cell.cut);
    const Vertex* corner[4];
    for (long t = 0; t < excess.size[0]; ++t) excess[t] = NOT_A_NUMBER;
    bool reached = true;
    for (int a = 0; a < 4; ++a) {
        Vertex& vertex = vertices.add(cell.corners[a].data, nullptr);
        reached &= vertices.reaches(vertex);
        corner[a] = &vertex;
    }
    if (!reached) return false;
    const CellTest test(objective);
    test.find_excess(corner, excess.data);
    return test.judge(corner).dropped;
}

double descend_alone(const DescentData& data) {
    Workspace workspace;
    RotationObjective objective(workspace, data.problem);
    objective.aim(0);
    return descend(objective, data.q.data, data.share);
}

const Exported<root_cells> root_cells_exported{"root_cells", PART};
const Exported<judge_alone> judge_cell_exported{"judge_cell", PART};
const Exported<descend_alone> descend_exported{"descend", PART};

}  // namespace shapefit
