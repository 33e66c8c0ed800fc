// What a kernel raises; defined once, outside the code of any instruction set.
#pragma once

namespace shapefit {

[[noreturn]] void raise_out_of_memory(long bytes);

}  // namespace shapefit
