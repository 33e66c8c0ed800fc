// Alternation of the model with one rotation shared by all atoms, from one start or
// several.
//
//     min 1/2 ||Omega o (W - Rbar sum_i c_i B_i - T 1^T)||_F^2 + lambda ||c||_1
//     over Rbar Rbar^T = I,
//
// in turn over c and over R, until a round lowers the objective by little.
#include "../atoms/coefficient_step.hpp"
#include "../base/registry.hpp"
#include "../pose/rotation_step.hpp"

namespace shapefit {

// The program of n images, and its local minima.
struct AlternationData {
    Arguments& from;
    Tensor<const double> landmarks = from("landmarks", "n 2 p");  // W
    Matrix<const double> weights = from("weights", "n p");        // Omega
    Tensor<const double> atoms = from("atoms", "k 3 p");          // B
    Vector<const double> lam = from("lam", "n");
    Blocks<const double> starts = from("starts", "n s 3 3");
    bool is_signed = from("is_signed");  // c of either sign, or c >= 0
    // relative fall of the objective in a round at which it ends
    double tolerance = from("tolerance");
    Index max_rounds = from("max_rounds");
    // of the best start; so are rotation and status
    Matrix<double> coefficients = from("coefficients", "n k");
    Tensor<double> rotation = from("rotation", "n 3 3");
    Vector<int64_t> rounds = from("rounds", "n");  // of all starts together
    Vector<int64_t> status = from("status", "n");  // a Status
};

namespace {

// The image and the memory that its alternation works with.
struct Alternation {
    Alternation(Workspace& workspace, Tensor<const double> all)
        : image(workspace, all),
          step(workspace, image.atoms, all.size[2]),
          shape(workspace.zeros<double>(3 * padded(all.size[2]))) {}

    ReducedImage image;
    CoefficientStep step;
    double* shape;  // (3, row)
};

// The local minimum that an alternation ended at.
struct AlternationEnd {
    double objective;
    Index rounds;
    bool converged;
};

// Alternate the steps over c and R, from R and c = 0, until the objective hardly falls;
// R becomes the rotation of the local minimum, `work.step.set` its coefficients.
AlternationEnd alternate_image(const AlternationData& data, double lam,
                               Alternation& work, Rotation& R) {
    const Index row = work.image.atoms.row;
    const double *w = work.image.w, *S = work.shape;
    const double energy = 0.5 * dot_padded(w, w, 2 * row);
    double P[9], D[6], before = INFINITE, now = INFINITE;
    work.step.set.clear();
    work.step.set_program(w, lam, data.is_signed);
    for (Index round = 0; round < data.max_rounds; ++round) {
        check_interrupt();
        now = work.step.minimise_at(R);
        const double penalty = work.step.mix(work.shape);
        if (penalty > 0) {
            find_gram(S, row, P);
            for (int a = 0; a < 6; ++a)
                D[a] = dot_padded(w + a / 3 * row, S + a % 3 * row, row);
            now = energy + rotation_step({P, D, false}, R).value + lam * penalty;
        }
        if (round > 0 && before - now <= data.tolerance * before)
            return {now, round + 1, true};
        before = now;
    }
    return {now, data.max_rounds, false};
}

// Alternate from each start of an image, and write the local minimum of the least
// objective.
void alternate_starts(const AlternationData& data, Index image, Alternation& work) {
    double least = INFINITE;
    data.status[image] = Status::NUMERICAL_FAILURE;
    if (data.lam[image] < MIN_LAMBDA) return;
    for (Index start = 0; start < data.starts.size[1]; ++start) {
        Rotation R = Rotation::from(data.starts[image][start].data);
        const AlternationEnd end = alternate_image(data, data.lam[image], work, R);
        data.rounds[image] += end.rounds;
        if (!(end.objective < least)) continue;
        least = end.objective;
        work.step.set.write(data.coefficients[image]);
        R.write(data.rotation[image].data);
        data.status[image] =
            end.converged ? Status::CONVERGED : Status::ITERATION_LIMIT;
    }
}

}  // namespace

// Fit coefficients and one rotation to each image of the range, in turn over either.
void alternate(const AlternationData& data, Range range) {
    Workspace workspace;
    Alternation work(workspace, data.atoms);
    for (Index image = range.first; image < range.last; ++image) {
        if (work.image.reduce(data.landmarks[image], data.weights[image]))
            alternate_starts(data, image, work);
        else data.status[image] = Status::DEGENERATE;
    }
}

const Exported<alternate> alternate_exported{"alternate"};

}  // namespace shapefit
