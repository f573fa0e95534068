#!/usr/bin/env python3
"""Trial of the learned inverse's rival: grey features to the surface's gradient, then a Poisson solve.

::

    PYTHONPATH=.:tools/train .venv-train/bin/python tools/trial_poisson.py --cache DIR --flow

Fitted on one sensor's own 8 references and 40 ball presses: a small network reads each cell's features and answers
the gradient of h and the log odds of contact. Inside the contact the ball's surface is the truth; outside it h is
unknown near the contact and 0 far away. The contact is taken as the ball's cap above half its depth (Hertz).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np
import torch
from evaluate import PRESSES, Row, Taken, _ball, cached, score, table

from tacshade_edge.core import discmap, pattern
from tacshade_edge.core.disc import disc_mask
from tacshade_edge.core.greyscale import binarise
from tacshade_edge.core.refit import ball_height, fit_refit, press_rows
from tacshade_edge.core.solvers.learned import Inverse
from tacshade_edge.simulator.model import SensorModel, random_model
from tacshade_edge.simulator.objects import PAPER_OBJECTS
from tacshade_edge.simulator.other_family import other_model
from tacshade_edge.types import F32, U8, Geometry

N = discmap.CELLS // 2
WINDOWS = (0.5, 1.0, 2.0, 4.0)
HIDDEN, NOISE, STEPS, BATCH, NETS = 96, 0.15, 120, 8, 3
# On the default sensor more steps made flat objects worse.
DECAY_RADII = 0.12  # the skirt's length for the weak hint next to the contact, in skin radii


def halve(maps: F32) -> F32:
    """Mean of 2 x 2 cells."""
    return np.asarray(maps.reshape(*maps.shape[:-2], N, 2, N, 2).mean(axis=(-3, -1)), np.float32)


def axes(n: int) -> tuple[F32, F32]:
    """X and y of n x n cells in disc radii."""
    axis = (np.arange(n) + 0.5 - n / 2) * (2 * discmap.REACH / n)
    x, y = np.meshgrid(axis, axis)
    return x.astype(np.float32), y.astype(np.float32)


X, Y = axes(N)
INSIDE = X**2 + Y**2 < 1
COS, SIN = X / np.hypot(X, Y), Y / np.hypot(X, Y)


def poisson_matrix() -> torch.Tensor:
    """(cells, 2 cells): gradients per cell in x, then y, to least-squares h with h = 0 outside the disc."""
    number = -np.ones((N + 2, N + 2), int)
    number[1:-1, 1:-1][INSIDE] = np.arange(INSIDE.sum())
    cells = int(INSIDE.sum())
    laplace, source = np.zeros((cells, cells), np.float32), np.zeros((cells, 2 * cells), np.float32)
    for part, (a, b) in enumerate(((number[:, :-1], number[:, 1:]), (number[:-1], number[1:]))):
        for i, j in zip(a[(a >= 0) | (b >= 0)], b[(a >= 0) | (b >= 0)], strict=True):
            ends = [(k, s) for k, s in ((i, -1.0), (j, 1.0)) if k >= 0]
            for k, s in ends:
                for m, t in ends:
                    laplace[k, m] += s * t
                    source[k, part * cells + m] += s / len(ends)
    return torch.from_numpy(np.linalg.solve(laplace, source))


class Features:
    """Features of a frame of one sensor."""

    def __init__(self, reference: F32, pitch_cells: float, flow: bool) -> None:
        self.flow, self.pitch, self.reference = flow, pitch_cells, reference
        x, y = axes(discmap.CELLS)
        self.mask = (x**2 + y**2 < 1).astype(np.float32)
        rho = np.maximum(np.hypot(x, y), 1e-3)
        self.cos, self.sin, self.x, self.y, self.rho = x / rho, y / rho, x, y, rho
        self.total = {s: self._blur(self.mask, s) + 1e-3 for s in WINDOWS}

    def _blur(self, a: F32, window: float) -> F32:
        return cv2.GaussianBlur(a, (0, 0), window * self.pitch / 3, borderType=cv2.BORDER_CONSTANT)

    def _mean(self, a: F32, window: float) -> F32:
        return self._blur(a * self.mask, window) / self.total[window]

    def _polar(self, gx: F32, gy: F32, mirror: int) -> list[F32]:
        return [self.cos * gx + self.sin * gy, mirror * (self.cos * gy - self.sin * gx)]

    def __call__(self, white: F32, mirror: int = 1) -> F32:
        """(features, N, N); mirror = -1 turns the tangential direction round."""
        d, r = white - self.reference, self.reference
        out = [self.x, self.y, self.rho, self._mean(r, 2.0), self._mean(r, 4.0)]
        for s in WINDOWS:
            g = self._mean(d, s)
            gx, gy = (cv2.Sobel(g, cv2.CV_32F, *o, scale=s * self.pitch / 8) for o in ((1, 0), (0, 1)))
            out += [g, self._mean(np.maximum(d, 0), s), self._mean(np.maximum(-d, 0), s), *self._polar(gx, gy, mirror)]
        rows, cols = np.mgrid[: discmap.CELLS, : discmap.CELLS].astype(np.float32)
        for s, far in ((1.0, 1.5), (2.0, 3.0)):
            for a in (self._mean(d, s), self._mean(np.abs(d), s)):
                for turn in np.arange(8) * np.pi / 4:
                    along, beside = far * self.pitch * np.cos(turn), mirror * far * self.pitch * np.sin(turn)
                    dx, dy = self.cos * along - self.sin * beside, self.sin * along + self.cos * beside
                    to = ((cols + dx).astype(np.float32), (rows + dy).astype(np.float32))
                    out.append(cv2.remap(a, *to, cv2.INTER_LINEAR))
        if self.flow:
            fine = cv2.GaussianBlur(r, (0, 0), 0.2 * self.pitch)
            rx, ry = cv2.Sobel(fine, cv2.CV_32F, 1, 0), cv2.Sobel(fine, cv2.CV_32F, 0, 1)
            for s in WINDOWS[1:]:
                power = self._mean(rx * rx + ry * ry, s) + 1e-3
                out += self._polar(self._mean(d * rx, s) / power, self._mean(d * ry, s) / power, mirror)
        return halve(np.stack(out))[:, INSIDE].T.copy()


class Sensor:
    """The rival solver of one sensor, in the shape that `evaluate.score` takes."""

    def __init__(self, taken: Taken, flow: bool) -> None:
        mean = pattern.mean_image(taken.references)
        disc = pattern.find_disc(mean)
        self.pitch_px, model = pattern.marker_pitch_px(mean, disc), taken.model
        self.geometry = Geometry(model.skin_radius_mm, model.camera_distance_mm, model.visible_half_angle_deg, disc)
        self.mask, self.nets = disc_mask(*mean.shape, disc).astype(np.uint8), []
        self.seen: dict[int, F32] = {}
        self.known = discmap.geometry_maps(self.geometry, self.pitch_px)
        self.unit_mm = model.skin_radius_mm * np.sin(np.radians(model.visible_half_angle_deg)) / 10
        self.whites = np.stack([self.white(r) for r in taken.references])
        self.features = Features(self.whites.mean(axis=0), self.pitch_px / discmap.map_grid(disc).step_px, flow)

    def white(self, image: U8) -> F32:
        """White ratio of the cells."""
        return discmap.disc_average(binarise(image, self.mask, "adaptive", self.pitch_px), self.geometry.disc)

    def truth(self, taken: Taken, k: int) -> F32:
        """(5, cells): h, weight of h, contact, weight of contact, hinted h of press k, of none from PRESSES on."""
        if k >= PRESSES:
            return np.stack([INSIDE[INSIDE] * v for v in (0.0, 1.0, 0.0, 1.0, 0.0)]).astype(np.float32)
        _, press, radius = taken.presses[k]
        h = np.nan_to_num(halve(np.nan_to_num(ball_height(self.geometry, _ball(self.geometry, press, radius)))))
        part = h / h.max()
        cell_mm = 10 * self.unit_mm * 2 * discmap.REACH / N
        off_mm = cv2.distanceTransform((part < 0.5).astype(np.uint8), cv2.DIST_L2, 5) * cell_mm
        skirt = 0.5 * h.max() * np.exp(-off_mm / (DECAY_RADII * self.geometry.skin_radius_mm))
        hint = np.where(part >= 0.5, h, skirt)
        far = off_mm > 0.45 * self.geometry.skin_radius_mm
        h = np.where(part >= 0.55, h, 0) / self.unit_mm
        sure = (part > 0.57) | (part < 0.45)
        return np.stack(
            [m[INSIDE] for m in (h, (part > 0.55) + 2.0 * far, part >= 0.5, sure, hint / self.unit_mm)]
        ).astype(np.float32)

    def fit(self, taken: Taken, use: list[int], poisson: torch.Tensor, steps: int, seed: int = 0) -> None:
        """Train on the presses (and references, numbered from PRESSES) `use`."""
        torch.manual_seed(seed)
        rng = np.random.default_rng(seed)
        for k in use:
            if k not in self.seen:
                w = self.white(taken.presses[k][0]) if k < PRESSES else self.whites[k - PRESSES]
                self.seen[k] = np.stack([self.features(w, m) for m in (1, -1)])
        given = torch.from_numpy(np.stack([self.seen[k] for k in use]))
        truth = torch.from_numpy(np.stack([self.truth(taken, k) for k in use]))
        middle, spread = given.mean((0, 1, 2)), given.std((0, 1, 2)) + 1e-4
        net = torch.nn.Sequential(
            torch.nn.Linear(given.shape[-1], HIDDEN), torch.nn.SiLU(), torch.nn.Linear(HIDDEN, HIDDEN), torch.nn.SiLU(),
            torch.nn.Linear(HIDDEN, 3),
        )  # fmt: skip
        optimiser = torch.optim.AdamW(net.parameters(), lr=3e-3, weight_decay=0.03)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 4e-3, total_steps=steps)
        cos, sin = torch.from_numpy(COS[INSIDE]), torch.from_numpy(SIN[INSIDE])
        self.nets, self.poisson, self.scale = [*self.nets, net], poisson, (middle, spread)
        hint_gradient = torch.from_numpy(np.stack([_gradient(t[4]) for t in truth.numpy()]))
        for _ in range(steps):
            pick = torch.from_numpy(rng.permutation(len(use))[:BATCH])
            mirror = int(rng.integers(2))
            x = (given[pick, mirror] - middle) / spread
            answer = net(x + NOISE * torch.randn_like(x))
            turned = answer[..., 1] * (1 - 2 * mirror)
            gx, gy = cos * answer[..., 0] - sin * turned, sin * answer[..., 0] + cos * turned
            height = torch.cat((gx, gy), 1) @ poisson.T
            h, weight, contact, sure, _ = truth[pick].unbind(1)
            top = 0.3 + h.amax(1, keepdim=True)
            loss = (weight * ((height - h) / top) ** 2).sum(1).div(weight.sum(1)).mean()
            touch = (contact * ((height - h) / top) ** 2 * (weight > 0)).sum(1) / (contact.sum(1) + 1)
            slope = torch.stack((gx, gy), 1) - hint_gradient[pick]
            trust = torch.where(contact > 0, 1.0, 0.2)[:, None] * 10
            loss = loss + 3 * touch.mean() + (trust * slope**2 / top[:, None] ** 2).mean()
            entropy = torch.nn.functional.binary_cross_entropy_with_logits(answer[..., 2], contact, reduction="none")
            loss = loss + 2 * (entropy * sure).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()

    def maps(self, image: U8) -> Inverse:
        """Mean of the frame's answers and its mirrored ones."""
        return self.read(self.white(image))

    def read(self, white: F32) -> Inverse:
        """From the white ratio."""
        with torch.no_grad():
            given = [(torch.from_numpy(self.features(white, m)) - self.scale[0]) / self.scale[1] for m in (1, -1)]
            both = [torch.stack([net(g) for net in self.nets]).mean(0).numpy() for g in given]
        radial, turned, logit = [(both[0][:, i] + s * both[1][:, i]) / 2 for i, s in ((0, 1), (1, -1), (2, 1))]
        c, s = COS[INSIDE], SIN[INSIDE]
        height = self.poisson.numpy() @ np.concatenate((c * radial - s * turned, s * radial + c * turned))
        maps = []
        for values, out in ((height * self.unit_mm, 0.0), (logit, -5.0)):
            whole = np.full((N, N), out, np.float32)
            whole[INSIDE] = values
            maps.append(cv2.resize(whole, (discmap.CELLS, discmap.CELLS), interpolation=cv2.INTER_LINEAR))
        return Inverse(*maps)


def _gradient(h: F32) -> F32:
    """(2, cells): gradient per cell in x and y."""
    whole = np.zeros((N, N), np.float32)
    whole[INSIDE] = h
    return np.stack([np.gradient(whole, axis=a)[INSIDE] for a in (1, 0)])


def trial(taken: Taken, name: str, flow: bool, steps: int, poisson: torch.Tensor) -> list[Row]:
    """Fit on the references and presses; two halves first, for a refit of the height on presses not seen."""
    sensor, blank = Sensor(taken, flow), list(range(PRESSES, PRESSES + len(taken.references)))
    rows, errors = [], []
    for half in range(2):
        sensor.nets = []
        sensor.fit(taken, [k for k in range(PRESSES) if k % 2 != half] + blank, poisson, steps)
        for image, press, radius in taken.presses[half::2]:
            inverse, ball = sensor.maps(image), _ball(sensor.geometry, press, radius)
            true = ball_height(sensor.geometry, ball)
            at = np.nan_to_num(true) > 0.55 * np.nanmax(true)
            errors.append(np.abs(inverse.height_mm - true)[at].mean())
            if row := press_rows(inverse, sensor.known, sensor.geometry, ball):
                rows.append(row)
    sensor.nets = []
    for seed in range(NETS):
        sensor.fit(taken, [*range(PRESSES), *blank], poisson, steps, seed)
    print(f"{name}: |dh| on unseen balls {np.mean(errors):.3f} mm, {len(rows)} refit rows", flush=True)
    refit = fit_refit(rows)
    return [score("40 presses", name, sensor, refit, s) for s in taken.scenes]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--sensors", default="0,5,11")
    parser.add_argument("--other", default="31,32,40")
    parser.add_argument("--flow", action="store_true", help="also the change times the reference's gradient")
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    poisson, rows = poisson_matrix(), []
    for text, other in ((args.sensors, False), (args.other, True)):
        for seed in (int(s) for s in text.split(",") if s):
            model = other_model(seed) if other else random_model(seed) if seed else SensorModel()
            taken = cached(args.cache, model, other, PAPER_OBJECTS)
            rows += trial(taken, f"{'other' if other else 'own'} {seed}", args.flow, args.steps, poisson)
    print(f"\n{table(rows, 'sensor')}\n\n{table(rows, 'shape')}")
    if args.json:
        args.json.write_text(json.dumps([{f: getattr(r, f) for f in Row.__slots__} for r in rows], indent=1))


if __name__ == "__main__":
    main()
