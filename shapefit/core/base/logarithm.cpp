#include "lane_functions.hpp"

#include "registry.hpp"
namespace shapefit {

void log_of_each(Vector<const double> x, Vector<double> logarithm) {
    for (long i = 0; i < x.size[0]; ++i) logarithm[i] = log_of_one_plus(x[i]);
}

const Exported<log_of_each> log_of_one_plus_exported{"log_of_one_plus", PART};

}  // namespace shapefit
