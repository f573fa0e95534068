"""A thin rubber shell on a gel that flows: an energy,
minimised by Newton's method at every step of an object's motion.

The membrane is incompressible neo-Hookean rubber in plane stress, and bends. The gel holds each
point by springs and keeps the volume below the skin. Contact is a stiff penalty, and Coulomb's
friction a smooth potential of the slip in a step, with the pressure of the iteration before (as in
incremental potential contact).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.types import F64, I64
from tools.studies.strangers.motion import Pose, clearance_mm, moves

STEP_MM = 0.5
NEWTON_STEPS, TOLERANCE_MM = 8, 3e-3
HALVINGS, MOST_MM = 6, 0.6
"""Line search: greatest number of halvings, and the greatest motion of a point in a step
of Newton's.
"""
CONTACT = 500.0
"""Stiffness of contact per area over that of the gel."""
SLIP_MM = 0.015
"""Slip in a step at which friction is whole."""
VOLUME = 400.0
"""Stiffness against a change of the mean height over the gel's."""


@dataclass(frozen=True, slots=True)
class ShellMaterial:
    """Numbers of a skin; stresses are in units of the rubber's shear modulus."""

    thickness_mm: float
    gel_per_mm: float  # normal stiffness of the gel per area
    gel_along: float  # the stiffness along the skin as a part of that
    friction: float


class Shell:
    """A shell at rest, with the rim clamped."""

    def __init__(self, rest_mm: F64, triangles: I64, clamped: I64, material: ShellMaterial) -> None:
        self.rest_mm, self._triangles, self._material = rest_mm, triangles, material
        self._free = np.setdiff1d(
            np.arange(3 * len(rest_mm)), (3 * clamped[:, None] + np.arange(3)).ravel()
        )
        corners = rest_mm[triangles]
        edges = np.stack((corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=2)
        normal = np.cross(edges[..., 0], edges[..., 1])
        size = np.linalg.norm(normal, axis=1)
        if np.any(normal[:, 2] <= 0):
            raise ValueError("a triangle is folded")
        first = edges[..., 0] / np.linalg.norm(edges[..., 0], axis=1, keepdims=True)
        second = np.cross(normal / size[:, None], first)
        flat = np.einsum("mik,mij->mkj", np.stack((first, second), axis=2), edges)
        # F = x · slopes, with the corners' positions x (3, 3) in columns.
        self._slopes = np.einsum(
            "ck,mkj->mcj", np.array(((-1, -1), (1, 0), (0, 1.0))), np.linalg.inv(flat)
        )
        self._triangle_mm2 = size / 2
        self._areas = np.zeros(len(rest_mm))
        np.add.at(self._areas, triangles, (self._triangle_mm2 / 3)[:, None])
        self._supports = self._gel(normal) + self._bending()
        degrees = (3 * triangles[:, :, None] + np.arange(3)).reshape(len(triangles), 9)
        self._rows, self._cols = np.repeat(degrees, 9, axis=1).ravel(), np.tile(degrees, 9).ravel()
        self._volume_mm3 = self._volume(rest_mm)[0]

    def solved(self, radius_mm: float, stops: Sequence[Press]) -> list[F64]:
        """Move an object through its stops; returns the points (N, 3) at each."""
        at = self.rest_mm
        lifted = clearance_mm(self.rest_mm, radius_mm, stops[0])
        made = []
        for stop_moves in moves(radius_mm, stops, lifted, STEP_MM):
            for pose, by in stop_moves:
                at = self._stepped(at, pose, by)
            made.append(at)
        return made

    def _gel(self, normal: F64) -> sparse.csc_matrix:
        """Springs along and across the skin at every point."""
        out = np.zeros_like(self.rest_mm)
        np.add.at(out, self._triangles, normal[:, None])
        out /= np.linalg.norm(out, axis=1, keepdims=True)
        stiff, along = self._material.gel_per_mm * self._areas, self._material.gel_along
        blocks = np.einsum("ni,nj->nij", out, out) * (1 - along) + along * np.eye(3)
        blocks *= stiff[:, None, None]
        return _blocks(blocks)

    def _bending(self) -> sparse.csc_matrix:
        """D (Δu)² over the rest shape, with the cotangents' Laplacian."""
        stretch = np.einsum("m,mcj,mdj->mcd", self._triangle_mm2, self._slopes, self._slopes)
        rows = np.repeat(self._triangles, 3, axis=1).ravel()
        cols = np.tile(self._triangles, 3).ravel()
        count = len(self.rest_mm)
        laplacian = sparse.csc_matrix((stretch.ravel(), (rows, cols)), shape=(count, count))
        rigidity = self._material.thickness_mm**3 / 3  # E t³ / 12 (1 - ν²), E = 3, ν = 0.5
        plate = rigidity * laplacian.T @ sparse.diags(1 / self._areas) @ laplacian
        return sparse.csc_matrix(sparse.kron(plate, sparse.eye(3)))

    def _volume(self, at: F64) -> tuple[float, F64]:
        """Volume between O and the skin, and its gradient (3 N,)."""
        a, b, c = (at[self._triangles[:, k]] for k in range(3))
        gradient = np.zeros_like(at)
        for k, (one, other) in enumerate(((b, c), (c, a), (a, b))):
            np.add.at(gradient, self._triangles[:, k], np.cross(one, other) / 6)
        return float(np.sum(np.cross(a, b) * c) / 6), gradient.ravel()

    def _membrane(self, at: F64, stiffness: bool) -> tuple[float, F64, F64]:
        """Energy, its gradient (3 N,), and a stiffness (M, 9,
        9) of each triangle without negative eigenvalues.
        """
        f = np.einsum("mci,mcj->mij", at[self._triangles], self._slopes)
        right = np.einsum("mki,mkj->mij", f, f)
        square = np.linalg.det(right)
        if square.min() <= 1e-6:
            return math.inf, np.empty(0), np.empty(0)
        weight = self._material.thickness_mm * self._triangle_mm2
        energy = float(np.sum(weight * (np.trace(right, axis1=1, axis2=2) + 1 / square - 3)) / 2)
        inverse = np.linalg.inv(right)
        pulled = f @ inverse
        stress = f - pulled / square[:, None, None]
        gradient = np.zeros_like(at)
        np.add.at(
            gradient, self._triangles, np.einsum("m,mij,mcj->mci", weight, stress, self._slopes)
        )
        if not stiffness:
            return energy, gradient.ravel(), np.empty(0)
        units = np.eye(6).reshape(6, 3, 2)
        change = np.einsum("uki,mkj->muij", units, f) + np.einsum("mki,ukj->muij", f, units)
        turned = np.einsum("mij,mujk->muik", inverse, change)
        trace = np.trace(turned, axis1=2, axis2=3)
        softer = (
            pulled[:, None] * trace[..., None, None]
            - np.einsum("uij,mjk->muik", units, inverse)
            + np.einsum("mij,mujk,mkl->muil", pulled, change, inverse)
        )
        tangent = (units[None] + softer / square[:, None, None, None]).reshape(-1, 6, 6)
        values, vectors = np.linalg.eigh((tangent + np.swapaxes(tangent, 1, 2)) / 2)
        tangent = np.einsum("mik,mk,mjk->mij", vectors, np.maximum(values, 0), vectors)
        tangent = tangent.reshape(-1, 3, 2, 3, 2) * weight[:, None, None, None, None]
        blocks = np.einsum("miakb,mca,mdb->mcidk", tangent, self._slopes, self._slopes)
        return energy, gradient.ravel(), blocks.reshape(-1, 9, 9)

    def _stepped(self, before: F64, pose: Pose, by: F64) -> F64:
        """Minimise the energy after a motion of the object."""
        at = before
        for step in range(NEWTON_STEPS):
            touch = self._touch(at, before, pose, by)
            energy, change = self._newton(at, touch)
            size = float(np.abs(change).max())
            part = min(1.0, MOST_MM / max(size, 1e-12))
            for _ in range(HALVINGS):
                if self._energy(at + part * change, touch) < energy:
                    break
                part /= 2
            at = at + part * change
            if step and part * size < TOLERANCE_MM:
                break
        return at

    def _newton(self, at: F64, touch: Touch) -> tuple[float, F64]:
        """The energy, and the change (N, 3) after which its quadratic model is least."""
        _, gradient, blocks = self._membrane(at, stiffness=True)
        moved = (at - self.rest_mm).ravel()
        swollen, swelling = self._volume(at)
        swollen -= self._volume_mm3
        size = 3 * len(at)
        matrix = sparse.csc_matrix((blocks.ravel(), (self._rows, self._cols)), shape=(size, size))
        pushed, held = touch.derivatives(at)
        matrix = matrix + self._supports + _blocks(held)
        gradient = (
            gradient + self._supports @ moved + self._bulk * swollen * swelling + pushed.ravel()
        )
        free = self._free
        factor = splu(
            matrix[free][:, free].tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        # The volume couples all points, by a matrix of rank one.
        down, across = factor.solve(np.stack((gradient[free], swelling[free]), axis=1)).T
        both = self._bulk * float(swelling[free] @ down)
        down = down - across * both / (1 + self._bulk * float(swelling[free] @ across))
        change = np.zeros(size)
        change[free] = -down
        return self._energy(at, touch), change.reshape(-1, 3)

    def _touch(self, at: F64, before: F64, pose: Pose, by: F64) -> Touch:
        """Contact as it is now; normals and the pressure behind friction stay during a step
        of Newton's.
        """
        stiff = CONTACT * self._material.gel_per_mm * self._areas
        gap = pose.distance_mm(at)
        inside = np.flatnonzero(gap < 0)
        pressure = -self._material.friction * stiff[inside] * gap[inside]
        normal = pose.normals(at[inside])
        return Touch(pose, before + by, stiff, inside, normal, pressure)

    def _energy(self, at: F64, touch: Touch) -> float:
        membrane, _, _ = self._membrane(at, stiffness=False)
        if math.isinf(membrane):
            return membrane
        moved = (at - self.rest_mm).ravel()
        swollen = self._volume(at)[0] - self._volume_mm3
        springs = float(moved @ (self._supports @ moved)) + self._bulk * swollen**2
        return membrane + springs / 2 + touch.energy(at)

    @property
    def _bulk(self) -> float:
        return VOLUME * self._material.gel_per_mm / float(self._areas.sum())


def _blocks(each: F64) -> sparse.csc_matrix:
    """A matrix with blocks (N, 3, 3) on its diagonal."""
    count = len(each)
    return sparse.csc_matrix(sparse.bsr_matrix((each, np.arange(count), np.arange(count + 1))))


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """Contact in a step of Newton's method."""

    pose: Pose
    carried_mm: F64  # (N, 3) where points would be if all stuck to the object
    stiff: F64  # (N,)
    inside: I64  # (K,) points inside the object
    normal: F64  # (K, 3)
    limit: F64  # (K,) greatest friction

    def energy(self, at: F64) -> float:
        """Of penetration and friction."""
        gap = np.minimum(self.pose.distance_mm(at), 0)
        size = np.linalg.norm(self._slip(at), axis=1)
        sliding = np.where(size < SLIP_MM, size**2 / (2 * SLIP_MM), size - SLIP_MM / 2)
        return float(np.sum(self.stiff * gap**2)) / 2 + float(np.sum(self.limit * sliding))

    def derivatives(self, at: F64) -> tuple[F64, F64]:
        """The gradient (N, 3), and the stiffness (N, 3, 3) without negative eigenvalues."""
        gradient, held = np.zeros_like(at), np.zeros((len(at), 3, 3))
        slip, inside, normal = self._slip(at), self.inside, self.normal
        gap = np.minimum(self.pose.distance_mm(at[inside]), 0)
        rate = self.limit / np.maximum(np.linalg.norm(slip, axis=1), SLIP_MM)
        gradient[inside] = (self.stiff[inside] * gap)[:, None] * normal + rate[:, None] * slip
        along = np.einsum("ni,nj->nij", normal, normal)
        held[inside] = self.stiff[inside, None, None] * along
        held[inside] += rate[:, None, None] * (np.eye(3) - along)
        return gradient, held

    def _slip(self, at: F64) -> F64:
        slip = at[self.inside] - self.carried_mm[self.inside]
        return np.asarray(slip - np.sum(slip * self.normal, axis=1, keepdims=True) * self.normal)
