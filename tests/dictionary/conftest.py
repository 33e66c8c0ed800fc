"""The certificate of a coding, by other means than the coding itself."""

import numpy as np

from shapefit.arrays import Floats
from shapefit.dictionary.coding import flat, objectives


def duality_gaps(shapes: Floats, atoms: Floats, beta: float, coefficients: Floats) -> Floats:
    """objective - D(t R) >= objective - optimum for each shape; (n,), for beta > 0.

    The dual is max D(Y) = <Y, S> - 1/2 ||Y||^2 subject to <B_i, Y> <= beta. Y = t R with the
    residual R and the best t >= 0 that is feasible.
    """
    X, B = flat(shapes), flat(atoms)
    R = X - coefficients @ B
    correlation, energy, highest = (R * X).sum(axis=1), (R**2).sum(axis=1), (R @ B.T).max(axis=1)
    free = np.divide(correlation, energy, out=np.zeros_like(energy), where=energy > 0)
    feasible = np.divide(beta, highest, out=np.full_like(energy, np.inf), where=highest > 0)
    t = np.clip(free, 0.0, feasible)
    dual = t * correlation - 0.5 * t**2 * energy
    return objectives(shapes, atoms, beta, coefficients) - dual
