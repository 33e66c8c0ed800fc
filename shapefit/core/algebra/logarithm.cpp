#include "logarithm.hpp"

namespace shapefit::SHAPEFIT_LEVEL {

void log_of_one_plus(Vector<const double> x, Vector<double> logarithm) {
    for (long i = 0; i < x.size[0]; ++i) logarithm[i] = log_of_one_plus(x[i]);
}

}  // namespace shapefit::SHAPEFIT_LEVEL
