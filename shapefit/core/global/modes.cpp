#include "../base/registry.hpp"
#include "objective.hpp"
#include "search.hpp"

namespace shapefit {

// All readings of each image, and the proof that there is none besides.

// List the modes of the images of the range.
//
// Every rotation whose objective is at most (1 + within) times the least lies within `apart` of a
// minimum that was found, or of a rotation from which the descent ends at one: its valley. Of
// minima that are not `apart` the best one is listed.
void find_modes(const ModesData& data, Range range);

namespace {

constexpr double BEYOND = 1.25;    // of `within`: up to here a rotation outside all balls gets its own
constexpr double INNER = 0.9;      // share of a ball's radius from which on a rotation gets its own:
                                   // what is left between balls would need very small cells
constexpr double SAFE = 1 + 1e-12; // balls are smaller by what rounding may add to a cell
constexpr double ALIKE = 1e-9;     // share of v by which minima that are one reading may differ
constexpr long MOST_BALLS = 512;

struct Minimum {
    double q[4];
    double value;
};

// What was found for an image: minima, and the rotations whose neighbourhoods are left out.
class Findings {
  public:
    Findings(Workspace& workspace, double apart)
        : minima_(workspace.zeros<Minimum>(MOST_BALLS)),
          balls_(workspace.zeros<double>(4 * MOST_BALLS)),
          near_(SAFE * cos(apart / 2)),
          inner_(cos(INNER * apart / 2)) {}

    void clear() { minima = balls = 0; }

    bool is_near(const double* q, const double* other) const {
        return magnitude(inner4(q, other)) >= near_;
    }
    bool is_in_a_ball(const double* q) const {
        for (long b = 0; b < balls; ++b)
            if (is_near(q, balls_ + 4 * b)) return true;
        return false;
    }
    bool is_well_in_a_ball(const double* q) const {
        for (long b = 0; b < balls; ++b)
            if (magnitude(inner4(q, balls_ + 4 * b)) >= inner_) return true;
        return false;
    }
    // A ball about a quaternion is a convex cone: it holds a cell if it holds the corners.
    bool cover(Vertices& vertices, const Cell& cell) const {
        for (long b = 0; b < balls; ++b) {
            int held = 0;
            for (int number : cell.vertex) held += is_near(vertices[number].q, balls_ + 4 * b);
            if (held == 4) return true;
        }
        return false;
    }
    void add_ball(const double* q) {
        for (int e = 0; e < 4; ++e) balls_[4 * balls + e] = q[e];
        ++balls;
    }
    void add_minimum(const double* q, double value) {
        for (int e = 0; e < 4; ++e) minima_[minima].q[e] = q[e];
        minima_[minima++].value = value;
        add_ball(q);
    }
    bool is_full() const { return balls + 2 > MOST_BALLS; }
    const Minimum& operator[](long at) const { return minima_[at]; }

    // The next best minimum that is apart from all that were taken; -1 for none. The first one found
    // is the global optimum, and comes before others that are as good to within rounding.
    long take_best(bool* done) const {
        long best = -1;
        for (long m = 0; m < minima; ++m)
            if (!done[m] && (best < 0 || minima_[m].value < minima_[best].value)) best = m;
        if (best < 0) return -1;
        if (!done[0] && minima_[0].value <= minima_[best].value * (1 + ALIKE)) best = 0;
        for (long m = 0; m < minima; ++m) done[m] |= is_near(minima_[m].q, minima_[best].q);
        return best;
    }

    long minima = 0, balls = 0;

  private:
    Minimum* minima_;
    double* balls_;
    double near_, inner_;
};

// What the descent from a rotation finds that is well in none of the balls; then it is in one.
void explore(RotationObjective& objective, const Vertex& vertex, Findings& found) {
    double q[4];
    for (int e = 0; e < 4; ++e) q[e] = vertex.q[e];
    objective.coefficients().clear();
    const double value = descend(objective, q, FINE);
    if (!found.is_in_a_ball(q)) found.add_minimum(q, value);
    if (!found.is_well_in_a_ball(vertex.q)) found.add_ball(vertex.q);
}

// Search until every cell is dropped or lies in a ball; whether it was.
bool search(const ModesData& data, RotationObjective& objective, CellSearch& cells, double least,
            Findings& found) {
    const Clock clock(data.limits.seconds);
    const double low = (1 + BEYOND * data.within) * least;
    Cell cell;
    int edge = 0, middle = 0;
    cells.vertices.set_cut((1 + data.within) * least);
    cells.begin();
    while (cells.take(cell)) {
        for (int number : cell.vertex) {
            const Vertex& vertex = cells.vertices[number];
            if (vertex.objective < low && !found.is_full() && !found.is_well_in_a_ball(vertex.q))
                explore(objective, vertex, found);
        }
        if (found.cover(cells.vertices, cell)) continue;
        if (found.is_full() || cells.tested >= data.limits.cells ||
            (cells.tested % CELLS_BETWEEN_LOOKS == 0 && clock.is_over()))
            return false;
        if (cells.is_dropped(cell, edge)) continue;
        if (!cells.split(cell, edge, middle)) return false;
    }
    return true;
}

void list(const ModesData& data, long image, const Findings& found, bool* done) {
    double least = INFINITE;
    for (long m = 0; m < found.minima; ++m) {
        done[m] = false;
        least = smaller(found[m].value, least);
    }
    long count = 0;
    for (long m = found.take_best(done); m >= 0; m = found.take_best(done)) {
        if (found[m].value > (1 + data.within) * least) break;
        if (count == data.rotation.size[1]) {
            data.status[image] = Status::ITERATION_LIMIT;
            break;
        }
        rotation_of(found[m].q, data.rotation[image][count].data);
        data.objective[image][count++] = found[m].value;
    }
    data.count[image] = count;
    data.valleys[image] = found.balls - found.minima;
}

}  // namespace

void find_modes(const ModesData& data, Range range) {
    Workspace workspace;
    const RootCells roots;
    RotationObjective objective(workspace, data.problem);
    CellSearch cells(workspace, objective, roots, data.limits.cells);
    Findings found(workspace, data.apart);
    bool* done = workspace.zeros<bool>(MOST_BALLS);
    for (long image = range.first; image < range.last; ++image) {
        if (!objective.aim(image)) {
            data.status[image] = Status::DEGENERATE;
            continue;
        }
        double best[4];
        quaternion_of(data.best[image].data, best);
        const double least = descend(objective, best, FINE);
        found.clear();
        found.add_minimum(best, least);
        cells.begin_image();
        const bool complete = search(data, objective, cells, least, found);
        data.status[image] = complete ? Status::OPTIMAL : Status::ITERATION_LIMIT;
        data.cells[image] = cells.tested;
        list(data, image, found, done);
    }
}

const Exported<find_modes> find_modes_exported{"find_modes"};

}  // namespace shapefit
