// What the kernels of lifting read and write, as Python lays it out.
#pragma once

#include "../algebra/views.hpp"

namespace shapefit {

// argmin sum_i ||M_i - c_i Rbar||_F^2 over c >= 0 and Rbar Rbar^T = I, for each image.
struct SynchronisationData {
    Blocks<const double> transforms;  // M (n, k, 2, 3)
    Tensor<double> rotation;          // R (n, 3, 3), left alone where all M_i are 0
};

}  // namespace shapefit
