"""The fitted linear error model as a value: its columns, coefficients and their covariance."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from sklearn_raacmm.arm import Arm, points_of, reach_mm
from sklearn_raacmm.error_model._columns import (
    ARCSEC,
    FAMILIES,
    LOAD,
    Terms,
    factored_columns,
    levers,
    other_columns,
    term_columns,
    term_names,
)
from sklearn_raacmm.error_model._gauge import unseen_half
from sklearn_raacmm.utils import check_shapes, chunks

# Columns times poses that are held at a time: 1 MB for each coordinate, measured between 2^13 and
# 2^18 with 177 and 769 columns.
_CHUNK = 2**17
# A root of which more than this share is not zero is worth being made a triangle.
_FULL = 0.6

_OF_HARMONICS = (
    "joint", "order", "amplitude_arcsec", "phase_deg", "cos_arcsec", "sin_arcsec",
    "cos_sd_arcsec", "sin_sd_arcsec", "log_bayes_factor",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Posterior of a linear error model: ``columns(angles) @ coef`` is the correction in mm.

    Estimators hold it, planners and exporters read it, and files keep it. It does not change;
    ``dataclasses.replace`` makes another one.

    Attributes
    ----------
    arm : Arm
        The calibrated arm.
    terms : Terms
        Which columns there are.
    coef : ndarray of shape (n_columns,)
        Posterior mean of the coefficients.
    half : ndarray of shape (n_columns, r)
        Root of their covariance, which is ``half @ half.T``.
    noise_variance : float
        Variance of a coordinate about the model, mm^2, the mean over the poses of the fit.
    prior_sd : dict
        Standard deviation before any data of the coefficients of each family.
    offsets : bool
        Whether each position had an unknown offset.
    n_determined : float
        Effective number of coefficients that the data determine.
    log_bayes_factor : ndarray of shape (n_harmonics,)
        By how much each harmonic of `terms` raises the log evidence, beside all others.
    gauge_free_half : ndarray of shape (n_columns, r)
        As `half`, for what a single-point test can show (see `constrained`): standard deviations of
        predictions are made of it, those of lengths of `half`. The same where positions have no
        offsets.
    fading_half : ndarray of shape (n_columns, r)
        Root of the covariance by which corrections fade: `gauge_free_half`, and after an update
        what the new poses leave of it.
    std_scale, noise_scale : float
        Factors of the standard deviation of the model and of the noise at which intervals hold at
        positions that were left out; 1 where that is not known.
    scale_sd : float
        Standard deviation of the common scale of all lengths that it holds: 0 without known ones.
    noise_of_angles : float
        Share of `noise_variance` that comes through the joints' angles, and so grows with the
        square of the distance from the joints to the probe.
    lever_mm : float
        Root mean square over the poses of the fit of what one radian of every joint, together as
        independent errors, moves a coordinate by.
    n_positions : float
        From how many positions these factors are; infinity where that is not known.
    """

    arm: Arm
    terms: Terms
    coef: np.ndarray
    half: np.ndarray
    noise_variance: float
    prior_sd: dict[str, Any]
    offsets: bool
    n_determined: float
    log_bayes_factor: np.ndarray
    gauge_free_half: np.ndarray
    fading_half: np.ndarray
    std_scale: float = 1.0
    noise_scale: float = 1.0
    n_positions: float = float("inf")
    scale_sd: float = 0.0
    noise_of_angles: float = 0.0
    lever_mm: float = 1.0

    def __getstate__(self) -> dict[str, Any]:
        state = dict(vars(self))
        for made_of_others in ("_std_root", "_fading_root"):
            state.pop(made_of_others, None)
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        pairs = np.asarray(self.terms.harmonics)
        shapes = {"coef": ("columns",), "half": ("columns", "rank"), "log_bayes_factor": ("pairs",)}
        shapes["gauge_free_half"] = ("columns", "rank")
        shapes["fading_half"] = ("columns", "fading")
        check_shapes("LinearModel", {"harmonics": pairs}, {"harmonics": ("pairs", 2)}, {})
        if len(pairs) and not (0 <= pairs[:, 0].min() <= pairs[:, 0].max() < self.arm.n_joints):
            raise ValueError(
                f"The file is damaged: a harmonic belongs to joint {pairs[:, 0].max() + 1} of "
                f"{self.arm.n_joints}."
            )
        n = 2 * len(pairs) + len(other_columns(self.arm, self.terms))
        check_shapes("LinearModel", vars(self), shapes, {"columns": n, "pairs": len(pairs)})

    @property
    def coef_sd(self) -> np.ndarray:
        """Standard deviations of the coefficients, (n_columns,)."""
        return np.sqrt(np.square(self.half).sum(axis=1))

    @property
    def noise_sd(self) -> float:
        """Standard deviation of a coordinate about the model, mm."""
        return float(np.sqrt(self.noise_variance))

    def columns(self, angles: np.ndarray) -> np.ndarray:
        """Columns (n, 3, n_columns) of the model in mm per unit coefficient: see `term_columns`."""
        return term_columns(self.arm, angles, self.terms)

    def predict(self, angles: np.ndarray, return_std: bool = False) -> tuple[np.ndarray, Any]:
        """Posterior of the correction: mean (n, 3) and standard deviation (n, 3) or None, mm.

        The standard deviation is without noise, and of what the test can show: :meth:`widened`
        makes intervals of it that hold.
        """
        mean, found = self._posterior(angles, [self._std_root] * return_std)
        return mean, found[0] if return_std else None

    def predict_with_doubt(
        self, angles: np.ndarray, return_std: bool = False, return_doubt: bool = True
    ) -> tuple[np.ndarray, Any, Any]:
        """As `predict`, and what corrections fade by: the length (n,) by `fading_half` in mm."""
        if not return_doubt:
            return *self.predict(angles, return_std), None
        roots = [self._fading_root]
        if return_std and roots[0] is not self._std_root:
            roots = [self._std_root, *roots]
        mean, found = self._posterior(angles, roots)
        return mean, found[0] if return_std else None, np.linalg.norm(found[-1], axis=1)

    def _posterior(self, angles, roots):
        """Mean (n, 3), and standard deviations (n, 3) by each of some roots."""
        mean = np.empty((len(angles), 3))
        found = [np.empty((len(angles), 3)) for _ in roots]
        for rows in chunks(len(angles), _CHUNK // max(len(self.coef), 1)):
            columns = factored_columns(self.arm, angles[rows], self.terms)
            mean[rows] = columns.dot(self.coef)
            for std, root in zip(found, roots, strict=True):
                std[rows] = np.sqrt(columns.squares(root))
        return mean, found

    @cached_property
    def _std_root(self):
        return _triangle(self.gauge_free_half, len(self.terms.harmonics))

    @cached_property
    def _fading_root(self):
        if np.array_equal(self.fading_half, self.gauge_free_half):
            return self._std_root
        return _triangle(self.fading_half, len(self.terms.harmonics))

    def widened(self, std: np.ndarray, noisy: np.ndarray | None = None) -> np.ndarray:
        """Standard deviations whose intervals hold at positions that were left out of the fit.

        With the noise at the poses `noisy`, or of the model alone.
        """
        noise: Any = 0.0
        if noisy is not None:
            noise = self.noise_scale * self.noise_sd * self.noise_ratio(noisy)
        return np.hypot(self.std_scale * std, noise)

    def noise_root(self, angles: np.ndarray) -> np.ndarray:
        """Root (n, 3, 3 + n_joints) of the noise's covariance at poses, over `noise_variance`."""
        n, share = self.arm.n_joints, self.noise_of_angles
        root = np.zeros((len(angles), 3, 3 + n))
        root[:, range(3), range(3)] = np.sqrt(1 - share)
        root[:, :, 3:] = np.sqrt(share) / self.lever_mm * levers(self.arm, self.terms, angles)
        return root

    def noise_ratio(self, angles: np.ndarray) -> np.ndarray:
        """Standard deviation of each coordinate's noise at poses over `noise_sd`, (n, 3)."""
        ratio = np.ones((len(angles), 3))
        if self.noise_of_angles:
            for rows in chunks(len(angles), _CHUNK // 32):
                ratio[rows] = np.linalg.norm(self.noise_root(angles[rows]), axis=2)
        return ratio

    def root_at(self, angles: np.ndarray, with_unseen: bool = True) -> np.ndarray:
        """Root (3 n, r) of the posterior covariance of the coordinates of some poses, mm.

        What a single-point test shows is widened by `std_scale`, what it does not is not.
        """
        half = self._root(with_unseen)
        out = np.empty((len(angles), 3, half.shape[1]))
        for rows in chunks(len(angles), _CHUNK // max(len(self.coef), 1)):
            columns = self.columns(angles[rows])
            every = columns.reshape(3 * len(columns), len(half)) @ half
            out[rows] = every.reshape(len(columns), 3, half.shape[1])
        return out.reshape(-1, half.shape[1])

    def _root(self, with_unseen):
        """Root (n_columns, r) of the widened covariance of the coefficients: see `root_at`."""
        seen = self.std_scale * self.gauge_free_half
        return seen + unseen_half(self) if with_unseen else seen

    def joint_covariance(
        self, angles: np.ndarray, with_noise: bool = False, with_unseen: bool = True
    ) -> np.ndarray:
        """Widened covariance (3 n, 3 n) of the coordinates of some poses, mm^2: see `root_at`."""
        root = self.root_at(angles, with_unseen)
        covariance = root @ root.T
        if with_noise:
            noise = self.noise_scale * self.noise_sd * self.noise_root(angles)
            place = np.arange(len(covariance)).reshape(-1, 3)
            covariance[place[:, :, None], place[:, None]] += noise @ noise.swapaxes(1, 2)
        return covariance

    def distance_std(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Posterior standard deviation (n,) in mm of a corrected length between two poses each."""
        n = self.arm.n_joints
        line = points_of(self.arm, second[:, :n]) - points_of(self.arm, first[:, :n])
        length = np.linalg.norm(line, axis=1, keepdims=True)
        line = line / np.maximum(length, 1e-300)
        half, out = self._root(with_unseen=True), np.empty(len(first))
        for rows in chunks(len(first), _CHUNK):
            difference = self.columns(second[rows]) - self.columns(first[rows])
            along = np.einsum("nc,ncp->np", line[rows], difference)
            out[rows] = np.linalg.norm(along @ half, axis=1)
        return out

    def harmonic_table(self) -> np.ndarray:
        """Harmonics as a structured array, the largest first: see `ArmResidualRegressor`."""
        n = 2 * len(self.terms.harmonics)
        pairs, sds = self.coef[:n].reshape(-1, 2), self.coef_sd[:n].reshape(-1, 2)
        kinds = ["i4"] * 2 + ["f8"] * 7
        table = np.empty(len(pairs), dtype=[*zip(_OF_HARMONICS, kinds, strict=True)])
        size, phase = np.hypot(*pairs.T), np.rad2deg(np.arctan2(*pairs.T[::-1]))
        places = np.add(self.terms.harmonics, (1, 0)).T
        values = *places, size, phase, *pairs.T, *sds.T, self.log_bayes_factor
        for name, column in zip(_OF_HARMONICS, values, strict=True):
            table[name] = column
        return table[np.argsort(-table["amplitude_arcsec"], kind="stable")]

    def term_table(self) -> Any:
        """The other causes as a structured array: see `ArmResidualRegressor`."""
        names, family = term_names(self.arm, self.terms)
        n = 2 * len(self.terms.harmonics)
        width = max([len(name) for name in names], default=1)
        dtype = [("family", "U11"), ("name", f"U{width}"), ("value", "f8"), ("sd", "f8")]
        table = np.empty(len(names), dtype=dtype)
        table["family"] = [FAMILIES[f] for f in family]
        table["name"] = names
        # The columns of gravity are not all of one arc second: see `_gravity`.
        arcsec = ARCSEC / reach_mm(self.arm)
        others = other_columns(self.arm, self.terms)
        size = np.array([c.unit / arcsec if c.kind == LOAD else 1.0 for c in others])
        table["value"], table["sd"] = size * self.coef[n:], size * self.coef_sd[n:]
        return table


def _triangle(half, n_pairs):
    """Root of the same covariance with many zeros.

    The columns that are multiplied for x, y and z each, those after the harmonics, have the
    shortest rows of a triangle.
    """
    if np.count_nonzero(half) <= _FULL * half.size:
        return half
    order = np.roll(np.arange(len(half)), -2 * n_pairs)
    root = np.empty((len(half), min(half.shape)))
    root[order] = np.asarray(np.linalg.qr(half[order].T, mode="r")).T
    return root
