#include "reduced.hpp"

namespace shapefit {

Room::Room(Workspace& workspace, long padded_atoms, long q, long further_rows)
    : active(workspace, padded_atoms),
      gram(workspace, 6 * padded_atoms + further_rows, 2 * q),
      N(workspace.zeros<double>(6 * padded_atoms)),
      change(workspace.zeros<double>(6 * padded_atoms)),
      total(workspace.zeros<double>(padded_atoms)),
      gradient(workspace.zeros<double>(2 * q)),
      direction(workspace.zeros<double>(2 * q)),
      moved(workspace.zeros<double>(6 * padded_atoms)),
      weighted(workspace.zeros<double>(6 * padded_atoms)),
      start_M(workspace.zeros<double>(6 * padded_atoms)),
      start_y(workspace.zeros<double>(2 * q)),
      matrix(further_rows > 0 ? workspace.zeros<double>(4 * q * q) : nullptr) {}

}  // namespace shapefit
