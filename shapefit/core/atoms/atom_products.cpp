#include "atom_products.hpp"

#include "../base/lanes.hpp"

namespace shapefit {
namespace {

constexpr long MOST_PLACES = 256;  // of 19 KB each

// B C^T (3, 3) of rows with a stride of `row`, which zeros fill up.
void multiply(const double* B, const double* C, long row, double (&out)[3][3]) {
    Doubles sums[3][3] = {};
    for (long j = 0; j < row; j += WIDTH)
        for (int b = 0; b < 3; ++b)
            for (int c = 0; c < 3; ++c)
                sums[b][c] += load(B + b * row + j) * load(C + c * row + j);
    for (int b = 0; b < 3; ++b)
        for (int c = 0; c < 3; ++c) out[b][c] = sum(sums[b][c]);
}

}  // namespace

AtomProducts::AtomProducts(Workspace& workspace, long k)
    : places_(k < MOST_PLACES ? padded(k) : MOST_PLACES),
      place_(workspace.zeros<long>(k)),
      made_for_(workspace.zeros<long>(k)),
      atom_(workspace.zeros<long>(places_)),
      products_(workspace.zeros<double>(9 * places_ * places_)) {}

bool AtomProducts::make(ReducedAtoms& atoms, const long* used, long count) {
    if (count > places_) return false;
    long lacking = 0;
    for (long e = 0; e < count; ++e) lacking += !has(used[e]);
    if (taken_ + lacking > places_) clear();
    for (long e = 0; e < count; ++e)
        if (!has(used[e])) add(atoms, used[e]);
    return true;
}

void AtomProducts::add(ReducedAtoms& atoms, long i) {
    const long place = taken_++;
    atom_[place] = i;
    place_[i] = place;
    made_for_[i] = generation_;
    double* own = products_ + 9 * place * places_;
    for (long other = 0; other < taken_; ++other) {
        double* its = products_ + 9 * other * places_;
        double product[3][3];
        multiply(atoms[i], atoms[atom_[other]], atoms.row, product);
        for (int b = 0; b < 3; ++b)
            for (int c = 0; c < 3; ++c) {
                own[(3 * b + c) * places_ + other] = product[b][c];
                its[(3 * c + b) * places_ + place] = product[b][c];
            }
    }
}

}  // namespace shapefit
