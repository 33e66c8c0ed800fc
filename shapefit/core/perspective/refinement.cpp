#include "refinement.hpp"

#include "../base/registry.hpp"
#include "../shared/data.hpp"
#include "step.hpp"

namespace shapefit {
namespace {

constexpr double FIRST_DAMPING = 1e-3, LEAST_DAMPING = 1e-9, MOST_DAMPING = 1e8;
constexpr double EASE = 0.2, HARDEN = 5;  // of the damping after a step that was kept, or was not
constexpr double SETTLED = 1e-10;  // relative fall of the objective that ends the last softness,
constexpr double FLEETING = 1e-2;  // and the softer ones before it

// Where the refinement of an image is.
struct Position {
    Unknowns at;
    Projection seen;
};

struct Refinement {
    Refinement(Workspace& workspace, const PerspectiveData& data)
        : shapes(arrange(workspace, data)),
          sight(room_for_sight(workspace, data.atoms.size[2])),
          equations(room_for_equations(workspace, shapes.filled(), data.atoms.size[2])),
          space(workspace, shapes.filled()) {
        for (Position& position : positions)
            position = {{{}, {}, workspace.zeros<double>(shapes.filled())},
                        room_for_projection(workspace, data.atoms.size[2])};
    }

    Position& here() { return positions[current]; }
    Position& there() { return positions[1 - current]; }
    double evaluate_at(const Position& position, double soft) const {
        return evaluate(shapes, sight, position.at, position.seen, soft);
    }

    Shapes shapes;
    Sight sight;
    NormalEquations equations;
    StepSpace space;
    Position positions[2];
    int current = 0;
};

struct Refined {
    double objective;
    long rounds;
    int64_t status;
};

// Take the first damped step that lowers the objective F; by what share it fell, 0 for none.
double improve(Refinement& refinement, double soft, double& damping, double& F) {
    const Position& here = refinement.here();
    Position& there = refinement.there();
    linearise(refinement.shapes, refinement.sight, here.at, here.seen, soft, refinement.equations);
    for (; damping <= MOST_DAMPING; damping *= HARDEN) {
        take_step(refinement.shapes, refinement.equations, damping, here.at, there.at,
                  refinement.space);
        project(refinement.shapes, refinement.sight, there.at, there.seen);
        const double trial = refinement.evaluate_at(there, soft);
        if (!(trial < F)) continue;
        const double fall = (F - trial) / F;
        F = trial;
        refinement.current = 1 - refinement.current;
        damping = larger(damping * EASE, LEAST_DAMPING);
        return fall;
    }
    return 0;
}

// Refine from where `here` is.
Refined refine(Refinement& refinement, double softness, long most_rounds) {
    double soft = larger(1, softness), damping = FIRST_DAMPING;
    project(refinement.shapes, refinement.sight, refinement.here().at, refinement.here().seen);
    double F = refinement.evaluate_at(refinement.here(), soft);
    if (!refinement.here().seen.in_front) return {NOT_A_NUMBER, 0, LocalStatus::DEGENERATE};
    if (!is_finite(F)) return {NOT_A_NUMBER, 0, LocalStatus::FAILED};
    for (long round = 1; round <= most_rounds; ++round) {
        const double fall = improve(refinement, soft, damping, F);
        if (soft <= softness && fall <= SETTLED) return {F, round, LocalStatus::CONVERGED};
        if (soft > softness && fall <= FLEETING) {
            soft = larger(0.5 * soft, softness);
            damping = FIRST_DAMPING;
            F = refinement.evaluate_at(refinement.here(), soft);
        }
    }
    return {refinement.evaluate_at(refinement.here(), softness), most_rounds, LocalStatus::ITERATION_LIMIT};
}

void start(const PerspectiveData& data, long image, Unknowns& at) {
    for (int e = 0; e < 9; ++e) at.R[e] = data.rotation[image].data[e];
    for (int a = 0; a < 3; ++a) at.t[a] = data.translation[image][a];
    for (long i = 0; i < data.atoms.size[0]; ++i) at.c[i] = data.coefficients[image][i];
}

void finish(const Unknowns& at, long image, const PerspectiveData& data) {
    for (int e = 0; e < 9; ++e) data.rotation[image].data[e] = at.R[e];
    for (int a = 0; a < 3; ++a) data.translation[image][a] = at.t[a];
    for (long i = 0; i < data.atoms.size[0]; ++i) data.coefficients[image][i] = at.c[i];
}

}  // namespace

void refine_perspective(const PerspectiveData& data, Range range) {
    Workspace workspace;
    Refinement refinement(workspace, data);
    for (long image = range.first; image < range.last; ++image) {
        look(data, image, refinement.sight);
        start(data, image, refinement.here().at);
        const Refined refined = refine(refinement, data.softness, data.most_rounds);
        finish(refinement.here().at, image, data);
        data.objective[image] = refined.objective;
        data.rounds[image] = refined.rounds;
        data.status[image] = refined.status;
    }
}

const Exported<refine_perspective> refine_perspective_exported{"refine_perspective"};

}  // namespace shapefit
