// Refinement of camera and shape under the full perspective projection, image after
// image: the method of Levenberg and Marquardt on F of projection.hpp, with the steps
// of normal_equations.hpp.
#include "normal_equations.hpp"

namespace shapefit {
namespace {

constexpr double FIRST_DAMPING = 1e-3, MIN_DAMPING = 1e-9, MAX_DAMPING = 1e8;
// Factors on the damping after a step that was kept, and after one that was not.
constexpr double DAMPING_DECREASE = 0.2, DAMPING_INCREASE = 5;
// Relative fall of the objective in a round that ends the last softness.
constexpr double MIN_LAST_FALL = 1e-10;
// And the softer ones before it.
constexpr double MIN_EARLY_FALL = 1e-2;

// The end of a refinement: F, how many rounds it took, and a Status.
struct Refined {
    double objective;
    Index rounds;
    int64_t status;
};

// The refinement of one image after another, with the same atoms.
class Refinement {
  public:
    Refinement(Workspace& workspace, const PerspectiveData& data)
        : data_(data),
          shapes_(workspace, data),
          observations_(workspace, shapes_.p),
          equations_(workspace, shapes_),
          positions_{{workspace, shapes_}, {workspace, shapes_}} {}

    // Refine an image, and write its result. The softness halves from 1 to its last
    // value, so that many landmarks pull while the pose is still coarse. DEGENERATE
    // where a landmark begins behind the camera: no step is taken from there.
    void refine(Index image) {
        observations_.gather(data_, image);
        Unknowns& start = here().at;
        start.R = Rotation::from(data_.rotation[image].data);
        for (int a = 0; a < 3; ++a) start.t[a] = data_.translation[image][a];
        for (Index i = 0; i < shapes_.k; ++i) start.c[i] = data_.coefficients[image][i];
        const Refined refined = descend();
        const Unknowns& at = here().at;
        at.R.write(data_.rotation[image].data);
        for (int a = 0; a < 3; ++a) data_.translation[image][a] = at.t[a];
        for (Index i = 0; i < shapes_.k; ++i) data_.coefficients[image][i] = at.c[i];
        data_.objective[image] = refined.objective;
        data_.rounds[image] = refined.rounds;
        data_.status[image] = refined.status;
    }

  private:
    // The position that was accepted last.
    Position& here() { return positions_[current_]; }
    // F at that position, for a softness s.
    double value(double soft) { return evaluate(shapes_, observations_, here(), soft); }

    // Take Levenberg-Marquardt steps from the start until F hardly falls; see `refine`.
    Refined descend() {
        double soft = larger(1, data_.softness), damping = FIRST_DAMPING;
        project(shapes_, observations_, here());
        double F = value(soft);
        if (!here().in_front) return {NOT_A_NUMBER, 0, Status::DEGENERATE};
        if (!is_finite(F)) return {NOT_A_NUMBER, 0, Status::NUMERICAL_FAILURE};
        for (Index round = 1; round <= data_.max_rounds; ++round) {
            const double fall = improve(soft, damping, F);
            if (soft <= data_.softness && fall <= MIN_LAST_FALL)
                return {F, round, Status::CONVERGED};
            if (soft > data_.softness && fall <= MIN_EARLY_FALL) {
                soft = larger(0.5 * soft, data_.softness);
                damping = FIRST_DAMPING;
                F = value(soft);
            }
        }
        return {value(data_.softness), data_.max_rounds, Status::ITERATION_LIMIT};
    }

    // Take the first step that lowers F, with more damping after each that does not;
    // returns the share by which F fell, 0 where no step lowers it.
    double improve(double soft, double& damping, double& F) {
        Position& there = positions_[1 - current_];
        equations_.linearise(observations_, here(), soft);
        for (; damping <= MAX_DAMPING; damping *= DAMPING_INCREASE) {
            check_interrupt();
            equations_.step(damping, here().at, there.at);
            project(shapes_, observations_, there);
            const double trial = evaluate(shapes_, observations_, there, soft);
            if (!(trial < F)) continue;
            const double fall = (F - trial) / F;
            F = trial;
            current_ = 1 - current_;
            damping = larger(damping * DAMPING_DECREASE, MIN_DAMPING);
            return fall;
        }
        return 0;
    }

    const PerspectiveData& data_;
    Shapes shapes_;
    Observations observations_;
    NormalEquations equations_;
    Position positions_[2];
    int current_ = 0;
};

}  // namespace

// Refine the rotation, translation and coefficients of each image of the range.
void refine_perspective(const PerspectiveData& data, Range range) {
    Workspace workspace;
    Refinement refinement(workspace, data);
    for (Index image = range.first; image < range.last; ++image)
        refinement.refine(image);
}

const Exported<refine_perspective> refine_perspective_exported{"refine_perspective"};

}  // namespace shapefit
