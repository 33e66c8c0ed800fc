// What kernels take from outside the code of any instruction set.
#pragma once

namespace shapefit {

[[noreturn]] void raise_out_of_memory(long bytes);

// Of a clock that is never set.
double steady_seconds();

}  // namespace shapefit
