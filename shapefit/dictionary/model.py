"""The dictionary: the rotatable basis shapes and what is known about them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Indices, Integers
from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.normalisation import normalise

LEARNED_FROM = "learned_from"
"""Of the provenance: what a dictionary was learned from where it was no 3D shapes."""

VERDICT = "verdict"
"""Provenance: how sure depth is that was learned from 2D landmarks, by `judgement`."""

DEPTH_AMBIGUITY = "near_and_far"
"""Provenance: what told near from far in shapes of 2D landmarks, or `OPEN`."""

OPEN = "open"
"""Value of DEPTH_AMBIGUITY where nothing has told near from far."""

SUITS = "suits"
"""Provenance: names of the configs of `fit` that suit the dictionary, with spaces."""

WHERE_MARKED = "where_marked"
"""Provenance: groups of landmarks that a fit has only where its files mark one of them,
after the landmark that they depend on, as `rankle:rheel,rball,rtoe`, with spaces
between the groups.
"""


@dataclass(frozen=True, eq=False, repr=False)
class Dictionary:
    """k atoms B_i, each a centred (3, p) shape on the scale of normalised shapes.

    atoms (k, 3, p); mean_shape (3, p); edges (e, 2) pairs of landmark indices for
    drawing; mirror_index (p,) the landmark that a reflection makes of each;
    mesh_vertices (k, 3, q) and mesh_faces (f, 3) travel with the atoms where the
    training shapes had a mesh; atom_scale (k,): atom i measures atom_scale[i] * B_i in
    `unit`; atom_origin (k, 3): where the origin of the frame of its training shape is
    beside B_i, so that meshes leave the package where they were; atom_items (k,): the
    training shape that each atom is, where the atoms are exemplars; prior is that over
    shapes, residual_variance (1,) the variance of a normalised coordinate that it
    cannot place, and p_value_table (t, 4) what p-values under it are found by, see
    `draw_table`; acceleration (p,): how much the training shapes move, see
    `find_acceleration`, and their frame_rate in Hz; bone_tolerance (e,), how far edges
    are from rigid, see `find_bone_tolerance`; edge_length (e,), the mean lengths of the
    edges in `unit`, and edge_covariance (e, e), how their logarithms differ between
    bodies, see `find_edge_covariance`; each where it is known; objective_trace is the
    training objective after every half-step; provenance holds text (version, resolved
    config, input digests).
    """

    atoms: Floats
    landmark_names: tuple[str, ...]
    mean_shape: Floats
    edges: NDArray[np.int64] | None = None
    mirror_index: NDArray[np.int64] | None = None
    mesh_vertices: Floats | None = None
    mesh_faces: NDArray[np.int64] | None = None
    atom_scale: Floats | None = None
    atom_origin: Floats | None = None
    unit: str = "unknown"
    atom_items: tuple[str, ...] | None = None
    prior: Mixture | None = None
    residual_variance: Floats | None = None
    p_value_table: Floats | None = None
    acceleration: Floats | None = None
    bone_tolerance: Floats | None = None
    edge_length: Floats | None = None
    edge_covariance: Floats | None = None
    frame_rate: float | None = None
    objective_trace: Floats = field(default_factory=lambda: np.empty(0))
    provenance: Mapping[str, str] = field(default_factory=dict)

    @property
    def prior_weights(self) -> Floats | None:
        """Return the weights pi (K,) of the prior, None without one."""
        return None if self.prior is None else self.prior.weights

    @property
    def prior_means(self) -> Floats | None:
        """Return the means mu (K, 3, p) of the prior, None without one."""
        return None if self.prior is None else self.prior.means

    @property
    def prior_covariances(self) -> Floats | None:
        """Return the covariances C (K, p, 3, p, 3) of the prior, None without one."""
        return None if self.prior is None else self.prior.by_landmark

    @property
    def k(self) -> int:
        """Return the number of atoms."""
        return len(self.atoms)

    def without(self, item: str) -> Dictionary:
        """Return the dictionary of the atoms that are not the training shape `item`.

        Its mean shape is the normalised mean of the atoms that are left. Raises
        ValueError where the atoms have no items, and where none is left.
        """
        retained = self.atoms_without(item)
        if not retained.any():
            raise ValueError(f"every atom is the item {item!r}")
        atoms = self.atoms[retained]
        vertices = self.mesh_vertices
        scale = self.atom_scale
        origin = self.atom_origin
        return replace(
            self,
            atoms=atoms,
            mean_shape=normalise(atoms.mean(axis=0)).points,
            mesh_vertices=None if vertices is None else vertices[retained],
            atom_scale=None if scale is None else scale[retained],
            atom_origin=None if origin is None else origin[retained],
            atom_items=tuple(name for name in self.atom_items or () if name != item),
        )

    def atoms_without(self, item: str) -> Flags:
        """Return the mask (k,) of the atoms that are not the training shape `item`.

        Raises ValueError where the atoms have no items.
        """
        if self.atom_items is None:
            raise ValueError("the atoms have no items: they are not exemplars")
        return np.array([name != item for name in self.atom_items], dtype=bool)

    @property
    def depth_ambiguity(self) -> bool:
        """Whether the sign of depth is unknown: shapes may be mirrored in depth."""
        return (
            LEARNED_FROM in self.provenance
            and self.provenance.get(DEPTH_AMBIGUITY, OPEN) == OPEN
        )

    @property
    def groups(self) -> dict[str, tuple[str, tuple[str, ...]]]:
        """Return groups of optional landmarks: what each depends on, and its members.

        By the text of the group in `WHERE_MARKED`, such as `rankle:rheel,rball,rtoe`.
        """
        groups = {}
        for text in self.provenance.get(WHERE_MARKED, "").split():
            depends_on, _, landmarks = text.partition(":")
            groups[text] = (depends_on, tuple(landmarks.split(",")))
        return groups

    @property
    def depends_on(self) -> NDArray[np.int64]:
        """Return the index of the landmark on which each one (p,) depends, else -1.

        Those of `groups` depend on one.
        """
        index_of = self.landmark_names.index
        indices = np.full(len(self.landmark_names), -1)
        for depends_on, landmarks in self.groups.values():
            for name in landmarks:
                indices[index_of(name)] = index_of(depends_on)
        return indices

    def drop_unmarked(self, landmarks: Collection[str]) -> Dictionary:
        """Return the dictionary without optional joints (toes) not among `landmarks`.

        landmarks: the names in a file. A group of `WHERE_MARKED` stays whole where one
        of its joints is among them.
        """
        retained: list[str] = []
        dropped: set[str] = set()
        for text, (_, members) in self.groups.items():
            if set(members) & set(landmarks):
                retained.append(text)
            else:
                dropped.update(members)
        if not dropped:
            return self
        names = [name for name in self.landmark_names if name not in dropped]
        provenance = {**self.provenance, WHERE_MARKED: " ".join(retained)}
        return replace(self.of_landmarks(names), provenance=provenance)

    def of_landmarks(self, names: Sequence[str]) -> Dictionary:
        """Return the dictionary of the landmarks with these names, in their order.

        It has the marginal of the prior and the edges between them; `mirror_index`
        stays where the partners of all are among them.
        """
        columns = np.array(
            [self.landmark_names.index(name) for name in names], dtype=np.int64
        )
        changed = replace(
            self,
            atoms=np.take(self.atoms, columns, axis=2),
            landmark_names=tuple(names),
            mean_shape=np.take(self.mean_shape, columns, axis=1),
        )
        place = np.full(len(self.landmark_names), -1)
        place[columns] = np.arange(len(columns))
        if self.edges is not None:
            inside = np.flatnonzero((place[self.edges] >= 0).all(axis=1))
            changed = changed._with_edges(place[self.edges[inside]], inside)
        if self.mirror_index is not None:
            partners = place[self.mirror_index[columns]]
            has_all_partners = (partners >= 0).all()
            changed = replace(
                changed, mirror_index=partners if has_all_partners else None
            )
        if self.prior is not None:
            changed = replace(changed, prior=self.prior.marginal(columns))
        if self.acceleration is not None:
            changed = replace(changed, acceleration=self.acceleration[columns])
        return changed

    def _with_edges(self, edges: Integers, retained: Indices) -> Dictionary:
        """Return the dictionary with its edges `retained` (e,) only, as `edges` (e, 2).

        Their tolerance, lengths and covariance stay. retained: indices of old edges.
        """
        tolerance = self.bone_tolerance
        length = self.edge_length
        covariance = self.edge_covariance
        if covariance is not None:
            covariance = covariance[np.ix_(retained, retained)]
        return replace(
            self,
            edges=edges,
            bone_tolerance=None if tolerance is None else tolerance[retained],
            edge_length=None if length is None else length[retained],
            edge_covariance=covariance,
        )


def map_landmarks(dictionary: Dictionary, A: Floats, residual: Floats) -> Dictionary:
    """Turn a dictionary of joints x into one of landmarks y = A x + e of a detector.

    The noise e ~ N(0, V) widens its prior, if it has one:

        p(y) = sum_k pi_k N(y; A mu_k, A C_k A^T + V),  atoms A B_i

    A (p, p), rows of weights that each add up to 1; e has the deviations `residual`
    (p,), whose squares are V. Landmark j stands for joint j: edges, motion and names
    stay as they are; edges get longer as their root mean square lengths do.
    """
    prior = dictionary.prior
    length = dictionary.edge_length
    if prior is not None:
        every = np.kron(np.eye(3), A)
        noise = np.diag(np.tile(residual**2, 3))
        covariances = every @ prior.covariances @ every.T + noise
        moved = Mixture(prior.weights, prior.means @ A.T, covariances)
        if length is not None and dictionary.edges is not None:
            before = edge_squares(prior, dictionary.edges)
            longer = edge_squares(moved, dictionary.edges) / before
            length = length * np.sqrt(longer)
        prior = moved
    return replace(
        dictionary,
        atoms=np.ascontiguousarray(dictionary.atoms @ A.T),
        mean_shape=dictionary.mean_shape @ A.T,
        prior=prior,
        edge_length=length,
    )


def edge_squares(prior: Mixture, edges: NDArray[np.integer]) -> Floats:
    """Return the mean squared length (e,) of edges (e, 2) under the prior."""
    i, j = edges.T
    squared_means = np.einsum("kap,kbq->kpaqb", prior.means, prior.means)
    second = prior.by_landmark + squared_means
    moments = np.einsum("k,kpaqa->pq", prior.weights, second)
    squares: Floats = moments[i, i] + moments[j, j] - moments[i, j] - moments[j, i]
    return squares


def describe_learning(dictionary: Dictionary) -> tuple[str, ...]:
    """Describe in one line how well a dictionary learned depth from 2D landmarks.

    No line for a dictionary learned from 3D shapes.
    """
    provenance = dictionary.provenance
    if LEARNED_FROM not in provenance:
        return ()
    verdict = provenance.get(VERDICT, "of an earlier version, which stored no verdict")
    if dictionary.depth_ambiguity:
        near_and_far = (
            f"{OPEN}, so that no image is trusted: learn it again with "
            "`flip=true` or `flip=false`, as results show it"
        )
    else:
        near_and_far = provenance[DEPTH_AMBIGUITY]
    return (
        f"the class was learned from 2D {provenance[LEARNED_FROM]}: {verdict}; near and"
        f" far {near_and_far}",
    )
