// The objective of a sequence, see smoothing.hpp, and its derivatives frame by frame.
#pragma once

#include "../base/vectors.hpp"
#include "../base/memory.hpp"
#include "data.hpp"

namespace shapefit {

// Where the minimisation stands; rows of frames are padded to a multiple of PADDING.
struct Place {
    Place(Workspace& workspace, const SequenceData& data);

    Matrix<double> y;        // (t, D)
    Vector<double> lengths;  // (e,)
    Matrix<double> pull;     // gradient of the energy of the mixtures (t, D)
    Matrix<double> share;    // of the modes at y (t, K)
    Vector<double> too_long;  // sum over the frames of how much longer than l a bone is (e,)
    double energy = 0;
};

// Energy, pull and shares at y and lengths.
void measure(const SequenceData& data, Place& at, double* scratch);

// What stands for the second derivatives of the bones: those of their squares with the directions
// held (Gauss and Newton's, never negative), or all of them.
enum class Bones { HELD, WHOLE };

// Of frame f: the upper triangle of S (D, D) = its block of the Hessian without the motion,
// D = at.y.size[1], the shares of the modes held, ones on the diagonal of the padding; and R (D, E),
// the gradient and then the second derivatives with the lengths, one per column.
void derive(const SequenceData& data, const Place& at, long f, Bones bones, double* S, double* R,
            long E);

// S (D, D) += sign sum_k share_k P_k of frame f, its upper triangle: how the mixture bends at y.
void add_precision(const SequenceData& data, const Place& at, long f, double sign, double* S);

// Element b of H (l - known): how lengths are held to those that are known.
double held_back(const SequenceData& data, const Place& at, long b);

// out = P x of a symmetric P (d, d), read above the diagonal; returns <x, P x>.
double multiply_symmetric(const double* P, const double* x, long d, double* __restrict out);

// How frame f is tied to frame f + apart by D^T D of the second difference D.
double tie(long f, long apart, long frames);

}  // namespace shapefit
