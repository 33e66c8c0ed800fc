// The visible landmarks of one image beside those of the shape, without the hidden ones.
#pragma once

#include "../base/workspace.hpp"

namespace shapefit {

struct SeenLandmarks {
    long count = 0;
    double *x, *y;   // w
    double* h;       // omega^2
    double* S[3];    // the shape
    int64_t* index;  // among all landmarks
};

inline SeenLandmarks room_for_landmarks(Workspace& workspace, long p) {
    SeenLandmarks seen;
    seen.x = workspace.zeros<double>(p);
    seen.y = workspace.zeros<double>(p);
    seen.h = workspace.zeros<double>(p);
    for (double*& row : seen.S) row = workspace.zeros<double>(p);
    seen.index = workspace.zeros<int64_t>(p);
    return seen;
}

// Gather the landmarks of w (2, p) and S (3, p) with omega^2 > 0.
inline void see(Matrix<const double> w, Vector<const double> squares, Matrix<const double> S,
                SeenLandmarks& seen) {
    seen.count = 0;
    for (long j = 0; j < squares.size[0]; ++j) {
        if (!(squares[j] > 0)) continue;
        const long at = seen.count++;
        seen.x[at] = w[0][j];
        seen.y[at] = w[1][j];
        seen.h[at] = squares[j];
        for (int b = 0; b < 3; ++b) seen.S[b][at] = S[b][j];
        seen.index[at] = j;
    }
}

}  // namespace shapefit
