// The kernels of one instruction set, gathered in its table.
#include "convex/certificate.hpp"
#include "convex/stretch.hpp"
#include "kernels.hpp"
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
            .solve_convex = solve_convex,
            .certify = certify_images,
            .synchronise = synchronise,
        },
    .parts =
        {
            .climb = climb,
            .polar_rotation = polar_rotation,
        },
};

}  // namespace shapefit::SHAPEFIT_LEVEL
