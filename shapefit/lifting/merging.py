"""Groups of images that were lifted apart, with fewer atoms or all, become one lifting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.convex.transforms import Transforms
from shapefit.lifting.estimate import join_images
from shapefit.lifting.lift import Lifting


@dataclass(frozen=True)
class Group:
    """The lifting of some of the images with some of the atoms.

    images (m,) and atoms (j,): which of all images and of all atoms its axes run over.
    """

    lifting: Lifting
    images: Integers
    atoms: Integers


def merge(groups: Sequence[Group], atoms: Floats) -> Lifting:
    """Join the liftings of groups of images, each image in one group, in the order of the images.

    atoms (k, 3, p) are those that the groups took theirs from; they become those of the problem,
    and coefficients and transforms get k columns.
    """
    order = np.argsort(np.concatenate([group.images for group in groups]))
    failures = {
        int(group.images[image]): reason
        for group in groups
        for image, reason in group.lifting.failures.items()
    }
    padded = [_pad(group, len(atoms)) for group in groups]
    joined: Lifting = join_images(padded, order)
    problem = replace(joined.problem, atoms=atoms)
    return replace(joined, problem=problem, failures=dict(sorted(failures.items())))


def _pad(group: Group, k: int) -> Lifting:
    """Return the lifting with coefficients and transforms of k atoms; the others have no part."""
    estimate = group.lifting.estimate
    c, M, proof = estimate.coefficients, estimate.transforms, estimate.convex_proof

    def among_all(transforms: Transforms) -> Transforms:
        return replace(transforms, atom=group.atoms[transforms.atom], k=k)

    if c is not None:
        full = np.zeros((len(c), k))
        full[:, group.atoms] = c
        estimate = replace(estimate, coefficients=full)
    if M is not None:
        estimate = replace(estimate, transforms=among_all(M))
    if proof is not None:
        whole = replace(proof, transforms=among_all(proof.transforms))
        estimate = replace(estimate, convex_proof=whole)
    return replace(group.lifting, estimate=estimate, failures={})
