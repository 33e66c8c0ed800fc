// The few functions of numbers that the kernels need.
//
// std::sqrt and its like are inline functions of the library, of which the linker keeps one copy,
// perhaps compiled for a newer processor; these live in the namespace of their instruction set.
// The compiler knows them without <math.h>, which takes longer to read than most kernels.
#pragma once

namespace shapefit {

constexpr double INFINITE = __builtin_huge_val();
constexpr double NOT_A_NUMBER = __builtin_nan("");
constexpr double TINY = 1e-300;  // in place of a zero divisor

inline double root(double x) { return __builtin_sqrt(x); }
inline double magnitude(double x) { return __builtin_fabs(x); }
inline double exp(double x) { return __builtin_exp(x); }
inline double log(double x) { return __builtin_log(x); }
inline double log1p(double x) { return __builtin_log1p(x); }
inline double sin(double x) { return __builtin_sin(x); }
inline double cos(double x) { return __builtin_cos(x); }
inline double copysign(double size, double sign) {
    return __builtin_copysign(size, sign);
}
inline double square(double x) { return x * x; }
inline double larger(double a, double b) { return a > b ? a : b; }
inline double smaller(double a, double b) { return a < b ? a : b; }
inline double sign_of(double x) { return x > 0 ? 1.0 : x < 0 ? -1.0 : 0.0; }
inline bool is_finite(double x) { return magnitude(x) < INFINITE; }

}  // namespace shapefit
