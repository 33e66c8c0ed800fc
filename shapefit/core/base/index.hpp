// The type of sizes and places in arrays.
#pragma once

#include <stddef.h>

namespace shapefit {

// As wide as a pointer on every system; `long` has 32 bits on Windows.
using Index = ptrdiff_t;

}  // namespace shapefit
