#include "atom_products.hpp"

#include "../base/lanes.hpp"

namespace shapefit {
namespace {

constexpr Index MAX_PLACES = 256;  // of 19 KB each

// out = B C^T for B and C (3, row), whose rows end in zeros.
void multiply(const double* B, const double* C, Index row, double (&out)[3][3]) {
    Doubles sums[3][3] = {};
    for (Index j = 0; j < row; j += WIDTH)
        for (int b = 0; b < 3; ++b)
            for (int c = 0; c < 3; ++c)
                sums[b][c] += load(B + b * row + j) * load(C + c * row + j);
    for (int b = 0; b < 3; ++b)
        for (int c = 0; c < 3; ++c) out[b][c] = sum(sums[b][c]);
}

}  // namespace

AtomProducts::AtomProducts(Workspace& workspace, Index k)
    : places_(k < MAX_PLACES ? padded(k) : MAX_PLACES),
      place_(workspace.zeros<Index>(k)),
      made_for_(workspace.zeros<Index>(k)),
      atom_(workspace.zeros<Index>(places_)),
      products_(workspace.zeros<double>(9 * places_ * places_)) {}

bool AtomProducts::make(ReducedAtoms& atoms, const Index* used, Index count) {
    if (count > places_) return false;
    Index lacking = 0;
    for (Index e = 0; e < count; ++e) lacking += !has(used[e]);
    if (taken_ + lacking > places_) clear();
    for (Index e = 0; e < count; ++e) {
        check_interrupt();
        if (!has(used[e])) add(atoms, used[e]);
    }
    return true;
}

void AtomProducts::add(ReducedAtoms& atoms, Index i) {
    const Index place = taken_++;
    atom_[place] = i;
    place_[i] = place;
    made_for_[i] = generation_;
    double* own = products_ + 9 * place * places_;
    for (Index other = 0; other < taken_; ++other) {
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
