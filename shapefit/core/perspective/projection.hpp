// Shapes in front of a camera: their projections, and how far these are from landmarks.
//
//     X_j = R sum_i c_i B_ij + t
//     r_j = omega_j (centre + focal X_xy / (sign X_z) - w_j)
//     F = 1/2 sum_j s^2 log(1 + |r_j|^2 / s^2) + ridge/2 |c - prior|^2
//
// A refinement is min F over R, t and c >= 0 with gauge^T c = 1.
#pragma once

#include "../base/registry.hpp"
#include "../base/vectors.hpp"
#include "../pose/rotation.hpp"

namespace shapefit {

// The refinements of n images: their data, starts and results.
struct PerspectiveData {
    Arguments& from;
    Tensor<const double> landmarks = from("landmarks", "n 2 p");  // w
    Matrix<const double> weights = from("weights", "n p");        // Omega, 0 = hidden
    Tensor<const double> atoms = from("atoms", "k 3 p");          // B
    Vector<const double> prior = from("prior", "k");
    Matrix<const double> focal = from("focal", "n 2");
    Matrix<const double> centre = from("centre", "n 2");
    // of the depth: 1 where z points away from the camera, else -1
    double sign = from("sign");
    double ridge = from("ridge");
    double softness = from("softness");  // s at the end
    Index max_rounds = from("max_rounds");
    Tensor<double> rotation = from("rotation", "n 3 3");  // R, the start, overwritten
    Matrix<double> translation = from("translation", "n 3");    // t, likewise
    Matrix<double> coefficients = from("coefficients", "n k");  // c, likewise
    Vector<double> objective = from("objective", "n");
    Vector<int64_t> rounds = from("rounds", "n");
    Vector<int64_t> status = from("status", "n");
};

// The atoms of all images; atoms of zeros fill up vectors, and their coefficients stay
// 0.
struct Shapes {
    Shapes(Workspace& workspace, const PerspectiveData& data)
        : k(data.atoms.size[0]),
          p(data.atoms.size[2]),
          filled(padded(k)),
          ridge(data.ridge),
          rows(workspace.matrix<double>(filled, padded(3 * p))),
          by_landmark(workspace.tensor<double>(p, 3, filled)),
          prior(workspace.vector<double>(filled)),
          gauge(workspace.vector<double>(filled)) {
        const double square = dot(data.prior.data, data.prior.data, k);
        for (Index i = 0; i < k; ++i) {
            prior[i] = data.prior[i];
            gauge[i] = data.prior[i] / square;
            for (int b = 0; b < 3; ++b)
                for (Index j = 0; j < p; ++j)
                    by_landmark[j][b][i] = rows[i][b * p + j] = data.atoms[i][b][j];
        }
    }

    const Index k, p, filled;  // filled: k', a multiple of 8
    const double ridge;
    Matrix<double> rows;          // (k', 3 p)
    Tensor<double> by_landmark;   // (p, 3, k')
    Vector<double> prior, gauge;  // (k',): the size of c is fixed by gauge^T c = 1
};

// The visible landmarks of one image. The first one again, with weight 0, fills up
// vectors.
struct Observations {
    Observations(Workspace& workspace, Index p)
        : w{workspace.zeros<double>(padded(p)), workspace.zeros<double>(padded(p))},
          omega(workspace.zeros<double>(padded(p))),
          index(workspace.zeros<int64_t>(padded(p))) {}

    // Copy the visible landmarks, weights and camera of an image.
    void gather(const PerspectiveData& data, Index image) {
        const Vector<const double> weight = data.weights[image];
        count = 0;
        for (Index j = 0; j < weight.size[0]; ++j)
            if (weight[j] > 0) index[count++] = j;
        filled = padded(count);
        for (Index e = 0; e < filled; ++e) {
            if (e >= count) index[e] = index[0];
            omega[e] = e < count ? weight[index[e]] : 0;
            for (int a = 0; a < 2; ++a) w[a][e] = data.landmarks[image][a][index[e]];
        }
        for (int a = 0; a < 2; ++a) {
            focal[a] = data.focal[image][a];
            centre[a] = data.centre[image][a];
        }
        sign = data.sign;
    }

    Index count = 0, filled = 0;
    double focal[2] = {}, centre[2] = {}, sign = 1;
    double *w[2], *omega;  // (filled,)
    int64_t* index;        // (filled,)
};

// The pose and the coefficients of an image.
struct Unknowns {
    Rotation R;
    double t[3];
    double* c;  // (k',)
};

// Where the refinement of an image is: the unknowns, and what the camera sees there.
struct Position {
    Position(Workspace& workspace, const Shapes& shapes)
        : at{{}, {}, workspace.zeros<double>(shapes.filled)},
          S(workspace.zeros<double>(padded(3 * shapes.p))) {
        for (double*& row : turned) row = workspace.zeros<double>(padded(shapes.p));
        for (double*& row : X) row = workspace.zeros<double>(padded(shapes.p));
        for (double*& row : r) row = workspace.zeros<double>(padded(shapes.p));
    }

    Unknowns at;
    double* S;                 // sum_i c_i B_i (3, p)
    double *turned[3], *X[3];  // R S and X of visible landmarks
    double* r[2];  // infinite for a landmark that is not in front of the camera
    bool in_front = false;  // all are
};

// Set S, X and r of a position from its unknowns; r is infinite behind the camera.
void project(const Shapes& shapes, const Observations& observations, Position& here);

// F at a position for s = softness; infinite unless all landmarks are before the
// camera.
double evaluate(const Shapes& shapes, const Observations& observations,
                const Position& here, double softness);

}  // namespace shapefit
