// The climbs of an image side by side, as many in a block as lanes; those that go on close ranks.
#pragma once

#include "climb.hpp"

namespace shapefit {

// The components as the lanes take them: mu (K, p, 3), and C_jk (3, 3) for k <= j.
struct Components {
    Components(Workspace& workspace, const PosteriorData& data);

    long count;
    Matrix<double> means, covariances;
};

template <class Lanes>
struct Climbs {
    Climbs(Workspace& workspace, long most, long p);

    Climb<Lanes>& block(long b) const { return *reinterpret_cast<Climb<Lanes>*>(lanes + b * size); }
    Climb<Lanes>& operator[](long i) const { return block(i / width<Lanes>); }
    long blocks() const { return (count + width<Lanes> - 1) / width<Lanes>; }
    // Copy climb i of some climbs, or of these, where i is not before the end.
    template <class Others>
    void append(const Climbs<Others>& from, long i);
    // Fill the last block with copies of its last climb.
    void pad();

    long count = 0;
    long* pair;  // of start and component: K start + component
    long size;   // of a block in Lanes
    Lanes* lanes;
};

// What the lanes of one precision work with.
template <class Lanes>
struct Side {
    Side(Workspace& workspace, const PosteriorData& data);

    Observed<Number<Lanes>> seen;
    Pack<Lanes> pack;
    ClimbSpace<Lanes> space;
    Climbs<Lanes> climbs;
};

// A short way up in single precision; the end, and a long way, in double: also where single precision
// loses its way.
struct Search {
    Search(Workspace& workspace, const PosteriorData& data);

    Components components;
    Side<Singles> going;
    Side<Doubles> late;
    Climbs<Doubles> arrived;
};

// Climb from all starts of an image under every component. What has `arrived` is not further than
// `margin` below the best, in log likelihood and weight, and finished; what is still moving there ran
// out of rounds. Returns the steps taken.
long climb_all(const PosteriorData& data, long image, double margin, Search& search);

}  // namespace shapefit
