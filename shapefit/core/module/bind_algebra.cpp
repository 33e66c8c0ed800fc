// The algebra of the kernels as Python functions, for tests.
#include "../kernels.hpp"
#include "arrays.hpp"
#include "module.hpp"

namespace shapefit {

void bind_algebra(nb::module_& parts) {
    parts.def("log_of_one_plus", [](In<1> x, Out<1> logarithm) {
        level().parts.log_of_one_plus(view(x), view(logarithm));
    });
    parts.def("symmetric_eigen", [](Out<2> A, Out<1> values, Out<2> V) {
        level().parts.symmetric_eigen(view(A), view(values), view(V));
    });
}

}  // namespace shapefit
