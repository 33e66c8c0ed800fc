// The model with one rotation as a function of that rotation, and descents on it.
//
//     v(R) = min_{c >= 0, T} 1/2 ||Omega o (W - Rbar sum_i c_i B_i - T 1^T)||_F^2
//                            + lambda ||c||_1
//
// With the residual Y, S = sum_i c_i B_i and the turn R <- exp([theta]_x) R, T and c
// are the best at each R, so that dv/dtheta_a = -<Y, rows 1 and 2 of G_a R S>, G_a the
// generator of turns about axis a.
#pragma once

#include "../atoms/coefficient_step.hpp"
#include "../base/registry.hpp"
#include "../pose/rotation.hpp"

namespace shapefit {

// The problems min v(R) over all rotations R, of n images.
struct SearchProblem {
    Arguments& from;
    Tensor<const double> landmarks = from("landmarks", "n 2 p");  // W
    Matrix<const double> weights = from("weights", "n p");        // Omega
    Tensor<const double> atoms = from("atoms", "k 3 p");          // B
    Vector<const double> lam = from("lam", "n");
};

// The global optimum of each image and what is proven of it.
struct GlobalData {
    Arguments& from;
    SearchProblem problem{from};
    // proper rotations; nan where there is none
    Blocks<const double> starts = from("starts", "n s 3 3");
    double tolerance = from("tolerance");  // relative gap at which the search ends
    Index max_cells = from("max_cells");   // tests after which a search gives up
    Matrix<double> coefficients = from("coefficients", "n k");
    Tensor<double> rotation = from("rotation", "n 3 3");
    Vector<double> objective = from("objective", "n");  // U
    // L: no rotation has an objective below it
    Vector<double> bound = from("bound", "n");
    Vector<int64_t> cells = from("cells", "n");  // tests
    // rotations whose coefficients were found
    Vector<int64_t> vertices = from("vertices", "n");
    Vector<int64_t> status = from("status", "n");  // a Status
    // The first d cells that the last search has dropped: their corners, unit
    // quaternions, and the cut that no rotation within is below; for those who check
    // them.
    Vector<int64_t> dropped = from("dropped", "n");
    Blocks<double> corners = from("corners", "n d 4 4");
    Matrix<double> cuts = from("cuts", "n d");
};

// Quaternions (w, x, y, z) and the two rows of a rotation that the camera sees.

// p.q of two quaternions.
inline double inner4(const double* p, const double* q) {
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3];
}

// q <- q / |q| for a quaternion q.
inline void make_unit(double* q) {
    const double length = 1 / root(inner4(q, q));
    for (int e = 0; e < 4; ++e) q[e] *= length;
}

// out (6,) = Q(p, q), symmetric and bilinear, rows one after another: Q(q, q) = |q|^2
// Rbar.
inline void bilinear_rows(const double* p, const double* q, double* out) {
    const double ww = p[0] * q[0], xx = p[1] * q[1], yy = p[2] * q[2], zz = p[3] * q[3];
    const double wx = p[0] * q[1] + p[1] * q[0], wy = p[0] * q[2] + p[2] * q[0];
    const double wz = p[0] * q[3] + p[3] * q[0], xy = p[1] * q[2] + p[2] * q[1];
    const double xz = p[1] * q[3] + p[3] * q[1], yz = p[2] * q[3] + p[3] * q[2];
    out[0] = ww + xx - yy - zz;
    out[1] = xy - wz;
    out[2] = xz + wy;
    out[3] = xy + wz;
    out[4] = ww - xx + yy - zz;
    out[5] = yz - wx;
}

// The rotation R of a unit quaternion q.
Rotation rotation_of(const double* q);

// Set q to one of the two unit quaternions of R (3, 3).
void quaternion_of(const double* R, double* q);

// What rounding may add to an objective or take off D(s Y), beside ||w||^2.
constexpr double ROUNDING = 64 * 0x1p-52;

// v(R) at one rotation of one image after another.
class RotationObjective {
  public:
    RotationObjective(Workspace& workspace, const SearchProblem& problem);

    // Set the image; false where it has fewer than two visible landmarks.
    bool set_image(Index image);

    // v at R; `coefficients()` are the start of the minimisation over c, and then its
    // minimum.
    double value(const Rotation& R);

    // Set the gradient (3,) of v at the last R in turns of the camera frame, and the
    // curvature (3, 3) of Gauss and Newton, with the coefficients fixed.
    void derivatives(double* gradient, double* curvature);

    ActiveSet& coefficients() { return step_.set; }
    // The residual Y = w - Rbar sum_i c_i B_i (2, row) at the last R, 0 from q on.
    const double* residual() const { return step_.residual(); }

    const SearchProblem& problem;
    ReducedImage image;
    const ReducedAtoms& atoms = image.atoms;
    double lam = 0;
    double square = 0;  // ||w||^2

  private:
    CoefficientStep step_;
    double* shape_;  // sum_i c_i B_i (3, row)
    Rotation R_;
};

// Descent of v(R) from a rotation to a local minimum: BFGS in the turns of the camera
// frame.

// Share of v that each step of the last descent must promise to take off.
constexpr double LAST_PROMISED_FALL = 1e-13;

// Move the unit quaternion q to a local minimum of v, until a step promises a fall of
// at most `share` of v, or none is found; returns v there. The coefficients of the
// objective are the start, and then those of the minimum.
double descend(RotationObjective& objective, double* q, double share);

}  // namespace shapefit
