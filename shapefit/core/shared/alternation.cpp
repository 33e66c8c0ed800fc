#include "../atoms/coefficient_step.hpp"
#include "../base/registry.hpp"
#include "data.hpp"
#include "rotation_step.hpp"

namespace shapefit {

// Alternation of the model with one rotation shared by all atoms, from one start or several.

// Alternate on the images of the range, keeping the best of the starts of each image.
void alternate(const AlternationData& data, Range range);

// Room for the alternation on one image after another.
struct AlternationRoom {
    AlternationRoom(Workspace& workspace, Tensor<const double> all, long most_rounds);

    ReducedAtoms atoms;
    CoefficientStep coefficients;
    double* w;      // (2, row)
    double* shape;  // (3, row)
    double* trace;  // (2 most_rounds,) the objective after each step
};

// Alternate from R (3, 3) until a round lowers the objective by a share <= tolerance.
//
// A round is a step of the coefficients, which starts from 0, and one of the rotation. R, the
// coefficients and the trace of the room are written; its w and atoms are those of the image.
AlternationEnd alternate_image(AlternationRoom& room, double lam, bool is_signed, double tolerance,
                      long most_rounds, double* R);

// Single steps on reduced landmarks w (2, q) and atoms (k, 3, q), in room of their own.
double solve_lasso(Matrix<const double> w, Tensor<const double> atoms, Matrix<const double> R,
                   double lam, bool is_signed, Vector<double> c);
AlternationEnd alternate_once(Matrix<const double> w, Tensor<const double> atoms, double lam, bool is_signed,
                     double tolerance, Matrix<double> R, Vector<double> c, Vector<double> trace);

namespace {

// P = S S^T and D = w S^T, from rows of `row` numbers.
void find_moments(const double* w, const double* S, long row, double* P, double* D) {
    find_gram(S, row, P);
    for (int a = 0; a < 3; ++a)
        for (int b = 0; b < 2; ++b) D[3 * b + a] = dot_padded(w + b * row, S + a * row, row);
}

void lay_rows(Matrix<const double> w, long row, double* out) {
    for (int a = 0; a < 2; ++a)
        for (long j = 0; j < row; ++j) out[a * row + j] = j < w.size[1] ? w[a][j] : 0;
}

void alternate_starts(const AlternationData& data, long image, AlternationRoom& room) {
    double least = INFINITE;
    data.status[image] = Status::NUMERICAL_FAILURE;
    for (long start = 0; start < data.starts.size[1]; ++start) {
        double R[9];
        for (int e = 0; e < 9; ++e) R[e] = data.starts[image][start].data[e];
        const AlternationEnd ended = alternate_image(room, data.lam[image], data.is_signed, data.tolerance,
                                            data.most_rounds, R);
        data.rounds[image] += ended.steps / 2;
        if (!(room.trace[ended.steps - 1] < least)) continue;
        least = room.trace[ended.steps - 1];
        room.coefficients.set.write(data.coefficients[image]);
        for (int e = 0; e < 9; ++e) data.rotation[image].data[e] = R[e];
        data.status[image] = ended.converged ? Status::CONVERGED : Status::ITERATION_LIMIT;
    }
}

}  // namespace

AlternationRoom::AlternationRoom(Workspace& workspace, Tensor<const double> all, long most_rounds)
    : atoms(workspace, find_planes(all, workspace), all.size[0]),
      coefficients(workspace, atoms, all.size[2]),
      w(workspace.zeros<double>(2 * padded(all.size[2]))),
      shape(workspace.zeros<double>(3 * padded(all.size[2]))),
      trace(workspace.zeros<double>(2 * most_rounds)) {}

void alternate(const AlternationData& data, Range range) {
    const long p = data.atoms.size[2];
    Workspace workspace;
    Reduction reduction(workspace, p);
    AlternationRoom room(workspace, data.atoms, data.most_rounds);
    for (long image = range.first; image < range.last; ++image) {
        const Vector<const double> omega = data.weights[image];
        if (image == range.first || !are_equal(omega.data, data.weights[image - 1].data, p)) {
            reduction.find(omega);
            room.atoms.reduce(omega.data, reduction);
            for (long j = 0; j < 2 * room.atoms.row; ++j) room.w[j] = 0;
        }
        if (reduction.seen < 2) {
            data.status[image] = Status::DEGENERATE;
            continue;
        }
        reduction.reduce_landmarks(data.landmarks[image], omega.data, room.w, room.atoms.row);
        alternate_starts(data, image, room);
    }
}

AlternationEnd alternate_image(AlternationRoom& room, double lam, bool is_signed, double tolerance,
                      long most_rounds, double* R) {
    const long row = room.atoms.row;
    ActiveSet& set = room.coefficients.set;
    const double energy = 0.5 * dot_padded(room.w, room.w, 2 * row);
    double P[9], D[6], before = INFINITE;
    set.clear();
    room.coefficients.aim(room.w, lam, is_signed);
    for (long step = 0; step < 2 * most_rounds; step += 2) {
        double now = room.coefficients.minimise_at(R);
        room.trace[step] = now;
        const double penalty = room.coefficients.mix(room.shape);
        if (penalty > 0) {
            find_moments(room.w, room.shape, row, P, D);
            now = energy + rotation_step({P, D, false}, R).value + lam * penalty;
        }
        room.trace[step + 1] = now;
        if (step > 0 && before - now <= tolerance * before) return {step + 2, true};
        before = now;
    }
    return {2 * most_rounds, false};
}

double solve_lasso(Matrix<const double> w, Tensor<const double> atoms, Matrix<const double> R,
                   double lam, bool is_signed, Vector<double> c) {
    Workspace workspace;
    AlternationRoom room(workspace, atoms, 0);
    room.atoms.copy();
    lay_rows(w, room.atoms.row, room.w);
    ActiveSet& set = room.coefficients.set;
    for (long i = 0; i < c.size[0]; ++i)
        if (c[i] != 0) set.use(i, c[i], sign_of(c[i]));
    room.coefficients.aim(room.w, lam, is_signed);
    const double least = room.coefficients.minimise_at(R.data);
    set.write(c);
    return least;
}

AlternationEnd alternate_once(Matrix<const double> w, Tensor<const double> atoms, double lam, bool is_signed,
                     double tolerance, Matrix<double> R, Vector<double> c, Vector<double> trace) {
    const long rounds = trace.size[0] / 2;
    Workspace workspace;
    AlternationRoom room(workspace, atoms, rounds);
    room.atoms.copy();
    lay_rows(w, room.atoms.row, room.w);
    const AlternationEnd ended = alternate_image(room, lam, is_signed, tolerance, rounds, R.data);
    for (long step = 0; step < ended.steps; ++step) trace[step] = room.trace[step];
    room.coefficients.set.write(c);
    return ended;
}

const Exported<alternate> alternate_exported{"alternate"};
const Exported<solve_lasso> sparse_coefficients_exported{"sparse_coefficients", PART};
const Exported<alternate_once> alternate_image_exported{"alternate_image", PART};

}  // namespace shapefit
