"""The certificate of the convex program, recomputed from a result without the solver."""
