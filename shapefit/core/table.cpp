// The kernels of one instruction set, gathered in its table.
#include "kernels.hpp"
#include "dictionary/coding.hpp"
#include "lifting/scaled_coefficients.hpp"
#include "lifting/synchronisation.hpp"

// The two steps by which a name becomes a string.
#define SHAPEFIT_QUOTE(name) #name
#define SHAPEFIT_NAME(name) SHAPEFIT_QUOTE(name)

namespace shapefit::SHAPEFIT_LEVEL {

extern const Level table;

const Level table = {
    .name = SHAPEFIT_NAME(SHAPEFIT_LEVEL),
    .kernels =
        {
            .code = code,
            .synchronise = synchronise,
        },
    .parts =
        {
            .climb = climb,
            .polar_rotation = polar_rotation,
            .scaled_coefficients = solve_scaled,
        },
};

}  // namespace shapefit::SHAPEFIT_LEVEL
