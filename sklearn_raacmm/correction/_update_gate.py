"""What is most likely wrong with the new poses of a correction: the gate of `update_correction`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from itertools import combinations

import numpy as np

from sklearn_raacmm.arm import parameter_jacobian
from sklearn_raacmm.correction._new_poses import place_columns
from sklearn_raacmm.utils import Finding, centred

# Residuals below so many standard deviations of the noise show nothing of the model; an explanation
# is named where it leaves less than this part of what the model leaves; rows that it needs.
_SEEN, _BETTER, _LEAST_ROWS = 1.5, 0.6, 12
# Of another arm: the part of the model that its residuals contain, while they are no larger than
# so many times what the model expects (a knock may be).
_NOT_THERE, _NO_KNOCK = 0.35, 2.0


def what_is_wrong(model, poses):
    """Yield the most likely finding on new poses beside what the fitted model expects of them.

    Tried are other explanations of the residuals, with base and tool free: already corrected, the
    wrong sign, one row late, joints exchanged or reversed, another table, another arm.
    """
    linear, used = model.linear_model_, poses.weights > 0
    angles, y = poses.angles[used], poses.residuals[used]
    codes = None if poses.codes is None else np.unique(poses.codes[used], return_inverse=True)[1]
    if len(y) < _LEAST_ROWS:
        return
    place = place_columns(linear.arm, angles, codes is None)
    size = _Size(place, codes)
    expected = linear.predict(angles)[0]
    noise = np.sqrt(3) * linear.noise_sd
    about_model, about_zero, of_model = size(y - expected), size(y), size(expected)
    if of_model < _SEEN * noise:
        return
    left = {what: size(one) for what, one in _explanations(linear, angles, y, expected)}
    left["rows"] = min(_late(way, y, expected, angles, linear.arm, codes) for way in (1, -1))
    table = parameter_jacobian(linear.arm, angles[:, : linear.arm.n_joints])[1][:, :, :-3]
    # A knock is no other table: that of the calibration is off by much more.
    is_far = about_model >= 3 * max(of_model, noise)
    if is_far and y.size > 2 * (table.shape[2] + place.shape[2]):
        left["table"] = _Size(np.concatenate([place, table], axis=2), codes)(y - expected)
    best = min(left, key=lambda name: left[name])
    share = size.product(y, expected) / of_model**2
    if left[best] < _BETTER * about_model and about_model > _SEEN * noise:
        # An explanation is one of `_WORDS`, or says itself what is wrong with the joints.
        code, what, advice = _WORDS.get(best, ("joints", f"of the angles, {best}", _OF_JOINTS))
        text = (
            f"The new residuals leave {about_model:.3g} mm about the model, and "
            f"{left[best]:.3g} mm if {what}."
        )
        yield Finding(code, text, advice, "repair", size_mm=about_model)
    elif share < _NOT_THERE and _SEEN * noise < about_zero < _NO_KNOCK * of_model:
        text = (
            f"The new residuals, {about_zero:.3g} mm, do not contain what the model expects of "
            f"them, {of_model:.3g} mm: they differ from it by {about_model:.3g} mm."
        )
        advice = "Are they of this arm, and of the table that the model was fitted with?"
        yield Finding("another-arm", text, advice, "repair", size_mm=about_model)


_OF_JOINTS = "Look at the order and the sense of the joints."
_WORDS = {
    "corrected": (
        "corrected-already",
        "they have been corrected already",
        "Give what the arm shows without the correction: result.residuals(angles, points), not "
        "result.residuals_mm.",
    ),
    "sign": (
        "sign-of-residuals",
        "their sign is wrong, or they were corrected twice",
        "Give measured minus reference.",
    ),
    "rows": (
        "rows-shifted",
        "they are of the row before or after",
        "Are angles and points from two files, of which one has a row more?",
    ),
    "table": (
        "other-table",
        "they are of another table of this arm, such as the nominal one",
        "Take the arm that the model was fitted with, model.arm_.",
    ),
}


def _explanations(linear, angles, y, expected):
    """Yield what may be wrong, and what is then left of the residuals, mm."""
    yield "corrected", y
    yield "sign", y + expected
    for i, j in combinations(range(linear.arm.n_joints), 2):
        exchanged = angles.copy()
        exchanged[:, [i, j]] = angles[:, [j, i]]
        yield f"joints {i + 1} and {j + 1} are exchanged", y - linear.predict(exchanged)[0]
    for i in range(linear.arm.n_joints):
        reversed_ = angles.copy()
        reversed_[:, i] *= -1
        yield f"joint {i + 1} is reversed", y - linear.predict(reversed_)[0]


def _late(way, y, expected, angles, arm, codes):
    """What is left, mm, if residuals are of the row before or after."""
    of, by = (slice(1, None), slice(None, -1))[::way]
    kept = np.ones(len(y) - 1, bool) if codes is None else codes[1:] == codes[:-1]
    if kept.sum() < _LEAST_ROWS:
        return np.inf
    codes = None if codes is None else np.unique(codes[1:][kept], return_inverse=True)[1]
    place = place_columns(arm, angles[by][kept], codes is None)
    return _Size(place, codes)((y[of] - expected[by])[kept])


class _Size:
    """Root mean square length of vectors but for the place of base and tool, and positions."""

    def __init__(self, place, codes):
        self.codes = codes
        place = centred(place, codes)
        self.basis = np.linalg.qr(place.reshape(-1, place.shape[2]))[0]
        taken = place.shape[2] + (0 if codes is None else 3 * (codes.max() + 1))
        self.spare = max(len(self.basis) - taken, 1)

    def _free(self, vectors):
        flat = centred(vectors, self.codes).ravel()
        return flat - self.basis @ (self.basis.T @ flat)

    def __call__(self, vectors):
        return np.sqrt(self.product(vectors, vectors))

    def product(self, one, other):
        """Inner product in the same units."""
        return float(3 * (self._free(one) @ self._free(other)) / self.spare)
