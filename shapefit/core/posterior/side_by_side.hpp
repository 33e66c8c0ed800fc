// The climbs of an image side by side, WIDTH in a block; those that go on close ranks.
#pragma once

#include "climb.hpp"

namespace shapefit::SHAPEFIT_LEVEL {

// The components as the lanes take them: mu (K, p, 3), and C_jk (3, 3) for k <= j.
struct Components {
    Components(Workspace& workspace, const PosteriorData& data);

    long count;
    Matrix<double> means, covariances;
};

struct Climbs {
    Climbs(Workspace& workspace, long most, long p);

    Climb& block(long b) const { return *reinterpret_cast<Climb*>(lanes_ + b * size_); }
    Climb& operator[](long i) const { return block(i / WIDTH); }
    long blocks() const { return (count + WIDTH - 1) / WIDTH; }
    // Copy climb i of some climbs, or of these, where i is not before the end.
    void append(const Climbs& from, long i);
    // Fill the last block with copies of its last climb.
    void pad();

    long count = 0;
    long* pair;  // of start and component: K start + component

  private:
    void copy(const Climbs& from, long i, long to);

    long size_;  // of a block in Lanes
    Lanes* lanes_;
};

struct Search {
    Search(Workspace& workspace, const PosteriorData& data);

    Components components;
    Observed seen;
    Pack pack;
    ClimbSpace space;
    Climbs going, arrived;
};

// Climb from all starts of an image under every component. What `arrived` is not further than
// `margin` below the best, in log likelihood and weight, and finished. Returns the steps taken.
long climb_all(const PosteriorData& data, long image, double margin, Search& search);

}  // namespace shapefit::SHAPEFIT_LEVEL
