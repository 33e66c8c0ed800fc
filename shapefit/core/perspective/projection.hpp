// One shape seen by a camera, and how far that is from the landmarks.
//
//     X = R sum_i c_i B_i + t,    r_j = omega_j (centre + focal X_xy / (sign X_z) - w_j)
#pragma once

#include "../base/workspace.hpp"
#include "data.hpp"

namespace shapefit {

// The atoms of all images, landmark after landmark, and atoms of zeros that fill up vectors: their
// coefficients stay 0.
struct Shapes {
    Tensor<const double> atoms;   // (k, 3, p)
    Tensor<double> by_landmark;   // (p, 3, k') with k' >= k a multiple of 8
    Vector<double> prior, gauge;  // (k',): the size of c is fixed by gauge^T c = 1
    double ridge;

    long filled() const { return by_landmark.size[2]; }
};

Shapes arrange(Workspace& workspace, const PerspectiveData& data);

// The visible landmarks of one image. The first one again, with weight 0, fills up vectors.
struct Sight {
    long count, filled;
    double focal[2], centre[2], sign;
    double *w[2], *omega;  // (filled,)
    int64_t* index;        // (filled,)
};

Sight room_for_sight(Workspace& workspace, long p);
void look(const PerspectiveData& data, long image, Sight& sight);

struct Unknowns {
    double R[9], t[3];
    double* c;  // (k',)
};

struct Projection {
    double* S;          // sum_i c_i B_i (3, p)
    double* turned[3];  // R S of visible landmarks
    double* X[3];
    double* r[2];    // infinite for a landmark that is not in front of the camera
    bool in_front;   // all are
};

Projection room_for_projection(Workspace& workspace, long p);
void project(const Shapes& shapes, const Sight& sight, const Unknowns& at, Projection& seen);

// 1/2 sum_j s^2 log(1 + |r_j|^2 / s^2) + ridge/2 |c - prior|^2; infinite unless all are in front.
double evaluate(const Shapes& shapes, const Sight& sight, const Unknowns& at,
                const Projection& seen, double softness);

// Project one image: X (3, p) and r (2, p) of the landmarks, all of them visible.
void project_alone(const ProjectionData& one);

}  // namespace shapefit
