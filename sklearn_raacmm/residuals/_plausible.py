"""Whether targets can be residuals: points, and differences between two frames, are none."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.utils import align, warn_user

# Part of their spread by which measured points may differ from the arm's, after a motion of the
# base: no calibrated arm is that far off.
_SHARE_OF_SPREAD = 0.05
# Median residual, as a share of the arm's reach, that is no residual; where the arm is not known,
# that of an arm of two metres, mm.
_SHARE_OF_REACH, _LARGEST_MM = 0.05, 100.0
# A motion of the base is worth a warning where it leaves no more than this part of the residuals,
# and they are larger than this share of the reach (or so many mm): small motions do no harm.
_LEFT, _STRIKING_SHARE, _STRIKING_MM = 0.1, 1e-3, 1.0
# With fewer rows, a motion (six numbers) explains anything.
_LEAST_ROWS = 4
_HOW_TO = (
    "Give arm.forward(angles) minus the reference in the arm's base frame: "
    "calibrate(arm, angles, points=points).residuals(angles, points), or position_residuals."
)


def refuse_points(y, points, reach):
    """Refuse the probe's points, in whatever frame.

    Parameters
    ----------
    y : ndarray of shape (n, 3)
        Targets, mm.
    points : ndarray of shape (n, 3)
        Where the arm says that its probe is, mm.
    reach : float
        Reach of the arm, mm.

    Raises
    ------
    ValueError
        If y are points.
    """
    if len(y) >= _LEAST_ROWS:
        rotation, shift = align(points, y)
        left = _rms(y - points @ rotation.T - shift)
        spread = _rms(points - points.mean(axis=0))
        # The points of a single position are residuals but for a shift.
        if left < _SHARE_OF_SPREAD * spread and spread > _SHARE_OF_REACH * reach:
            raise ValueError(
                "y are points, not residuals: up to a motion of the base they are where the arm "
                f"says that its probe is, with a root mean square difference of {left:.4g} mm. "
                + _HOW_TO
            )


def refuse_large(y, reach=np.inf):
    """Refuse what is too large for residuals.

    Parameters
    ----------
    y : ndarray of shape (n, 3)
        Targets, mm.
    reach : float, default=np.inf
        Reach of the arm, mm; infinite if it is not known.

    Raises
    ------
    ValueError
        If half of them are longer than any residual.
    """
    half = np.median(np.linalg.norm(y, axis=1))
    known = np.isfinite(reach)
    if half > (_SHARE_OF_REACH * reach if known else _LARGEST_MM):
        of_what = f"of an arm that reaches {reach:.4g} mm" if known else "in mm"
        raise ValueError(
            f"y are no residuals {of_what}: half of them are longer than {half:.4g} mm. Are they "
            f"points, differences between two frames, or in another unit? {_HOW_TO}"
        )


def warn_of_another_frame(y, points=None, reach=np.inf):
    """Warn where a motion of the base explains nearly all of the residuals.

    Parameters
    ----------
    y : ndarray of shape (n, 3)
        Residuals, mm.
    points : ndarray of shape (n, 3), default=None
        Where the arm says that its probe is, mm. None: only shifts can be seen.
    reach : float, default=np.inf
        Reach of the arm, mm.

    Warns
    -----
    UserWarning
        If the measured points seem to be in another frame.
    """
    size, striking = _rms(y), _STRIKING_MM if points is None else _STRIKING_SHARE * reach
    if len(y) < _LEAST_ROWS or size < striking:
        return
    if points is None:
        turn, left, n_found = 0.0, y - y.mean(axis=0), 3
    else:
        rotation, shift = align(points, points - y)
        turn = np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))
        left, n_found = points - y - points @ rotation.T - shift, 6
    rest = _rms(left) * np.sqrt(y.size / (y.size - n_found))
    if rest < _LEFT * size:
        mean = np.linalg.norm(y.mean(axis=0))
        about = f"a turn by {turn:.2g} rad and " if points is not None else ""
        warn_user(
            f"The residuals of {size:.4g} mm (root mean square) are nearly one motion of the base: "
            f"{about}a shift by {mean:.4g} mm on the average leave {rest:.4g} mm. Is the reference "
            f"in another frame? {_HOW_TO}"
        )


def _rms(vectors):
    return float(np.sqrt(np.square(vectors).sum(axis=1).mean()))
