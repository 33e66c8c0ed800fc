// The certificate from scratch: original data in, objective and gap out.
#pragma once

#include "../atoms/reduced_atoms.hpp"
#include "data.hpp"

namespace shapefit {

// Room for one image, and the atoms of the program turned.
struct Certifier {
    const ConvexProgram& program;
    Planes planes;                // B (3, p, padded)
    Matrix<double> centred;       // W less its mean
    Matrix<double> left;          // what M leaves of it
    Matrix<double> weighted;      // Omega o Y
    double* N;                    // (6, padded)

    Certifier(const ConvexProgram& program, Workspace& workspace);

    // P = f(Omega o (W - sum M_i B_i - T 1^T)) + lambda sum ||M_i||_2, its gap to
    // D = <Y, Omega o W> - delta/2 ||Y||^2, and the residual, for one image.
    //
    // On entry E holds the sparse errors from which the translation follows: the mean of what M and E
    // leave, weighted by omega^2 where the loss has a quadratic. On return it holds those that
    // minimise the objective, T is written, and Y has been made orthogonal to omega and scaled until
    // it is dual feasible, so P - D bounds the distance to the optimum whatever the solver did.
    void certify(long image, const ImageTransforms& M, const ConvexPoint& point,
                 const ConvexProof& proof);
};

void certify_images(const CertificateTask& task, Range range);

}  // namespace shapefit
