"""What is wrong with a simulated arm, and by how much; public in `sklearn_raacmm.datasets`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

# What differs from the defaults in a mix of sources.
_MIXES: dict[str, dict[str, Any]] = {
    "typical": {},
    "gravity": {
        "eccentricity_arcsec": (1.0, 0.3), "wobble_arcsec": 0.75, "runout_um": 0.5,
        "joint_compliance_urad_per_nm": 66.0, "counterbalance": 0.8, "sag_um": (256.0, 48.0),
    },
    "eccentricity": {
        "eccentricity_arcsec": (6.0, 1.8), "wobble_arcsec": 4.5,
        "joint_compliance_urad_per_nm": 8.0, "sag_um": (32.0, 6.0),
    },
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class ArmErrors:
    """Sizes of an arm's physical error sources, each in its own unit; 0 switches a source off.

    Defaults are *published*, *derived* from published sizes, or *our choice*. The force of the hand
    is left out, for which we found no published size.

    Parameters
    ----------
    length_mm : float, default=0.2
        Standard deviation of the errors of a, d and the probe vector, mm. *Published*: the
        identified arm of ``Arm.from_name("aacmm6")`` shows 0.1 to 0.7 mm.
    angle_deg : float, default=0.02
        Standard deviation of the errors of twists and zero offsets, degrees. *Published*: the same
        arm shows 0.004 to 0.047 degrees.
    eccentricity_arcsec : tuple of two float, default=(4.0, 1.2)
        Amplitudes of the first and the second harmonic of each encoder; joints differ by half of
        it either way, phases are random. *Our choice*: makers publish a compensation from 100 to 10
        arcsec; what is left in a finished arm is inferred.
    encoder_noise_arcsec : float, default=1.0
        White noise of each reading. *Published* for encoders: 0.5 to 1.5 arcsec.
    quantisation_arcsec : float, default=0.62
        Step of a reading: 2**21 counts a turn. *Our choice*.
    wobble_arcsec : float, default=3.0
        Tilt of each joint's axis, turning once a turn in the moving frame: a fixed one is a twist
        error, which calibration removes. *Our choice*: 2 to 5 arcsec inferred.
    runout_um : float, default=2.0
        Shift of each joint's axis, as the wobble. *Our choice*: 1 to 3 um inferred.
    joint_compliance_urad_per_nm : float, default=33.0
        Turn of the loaded joints under the torque of gravity, as though the hand carried nothing.
        *Derived*: stiffness of 2e4 to 5e4 N m/rad.
    counterbalance : float, default=0.85
        Share of the shoulder's (joint 2) torque that a spring carries. *Derived*: 0.8 to 0.9.
    sag_um : tuple of two float, default=(128.0, 24.0)
        How far the ends of the upper tube and of the forearm tube sink where the tube is
        horizontal. *Derived* for carbon tubes 75/71 mm of 0.75 m and 60/56 mm of 0.5 m, E 100 GPa.
    warming_k : float, default=1.0
        How much warmer the arm is than when it was calibrated, K. *Our choice*; expansions are
        makers' (carbon 0.5, aluminium 23 ppm/K).
    seating_um : float, default=3.0
        Standard deviation, per coordinate, of how the probe sits in a cone. *Our choice*: 2 to 5
        um inferred.
    play_arcsec : float, default=0.0
        Backlash of each joint: it lags by half of this behind the direction from which it came;
        joints differ by half of it either way. We found no published size.
    softening_arcsec : float, default=0.0
        Turn of the elbow (joint 4) under the weight of the horizontal forearm, which grows with
        the cube of the torque.
    drift_k : float, default=0.0
        Warming during a data set, K, on top of `warming_k`, of three time constants.
    payload_n : float, default=0.0
        Weight at the probe, N: it varies between 0 and this number from pose to pose. Joints twist
        and tubes bend under it as under the arm's own weight.
    slip_share : float, default=0.0
        Share of the poses in which the probe has slipped out of its cone.
    slip_mm : float, default=1.0
        How far it has slipped then, in a random direction.

    Examples
    --------
    >>> from sklearn_raacmm.datasets import ArmErrors
    >>> ArmErrors.only(sag_um=(128, 24)).seating_um
    0.0
    """

    length_mm: float = 0.2
    angle_deg: float = 0.02
    eccentricity_arcsec: Sequence[float] = (4.0, 1.2)
    encoder_noise_arcsec: float = 1.0
    quantisation_arcsec: float = 0.62
    wobble_arcsec: float = 3.0
    runout_um: float = 2.0
    joint_compliance_urad_per_nm: float = 33.0
    counterbalance: float = 0.85
    sag_um: Sequence[float] = (128.0, 24.0)
    warming_k: float = 1.0
    seating_um: float = 3.0
    play_arcsec: float = 0.0
    softening_arcsec: float = 0.0
    drift_k: float = 0.0
    payload_n: float = 0.0
    slip_share: float = 0.0
    slip_mm: float = 1.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value, pair = getattr(self, field.name), isinstance(field.default, tuple)
            numbers = np.asarray(value)
            wanted = "two numbers" if pair else "a number"
            if numbers.dtype.kind not in "iuf" or numbers.shape != ((2,) if pair else ()):
                raise ValueError(f"{field.name} must be {wanted}, got {value!r:.60}.")
            signed = field.name in ("warming_k", "drift_k")
            high = 1 if field.name in ("counterbalance", "slip_share") else np.inf
            if not np.all(np.isfinite(numbers) & (signed | (numbers >= 0)) & (numbers <= high)):
                bounds = "finite" if signed else f"finite and in [0, {high:g}]"
                raise ValueError(f"{field.name} must be {bounds}, got {value!r:.60}.")
            plain = tuple(map(float, value)) if pair else float(value)
            object.__setattr__(self, field.name, plain)

    @classmethod
    def only(cls, **sizes: Any) -> "ArmErrors":
        """Switch on only the sources that are named.

        Parameters
        ----------
        **sizes : dict
            Parameters of `ArmErrors`. `counterbalance` and `slip_mm`, no sources, keep their
            defaults.

        Returns
        -------
        ArmErrors
        """
        kept = ("counterbalance", "slip_mm")
        off: Any = {f.name: np.zeros_like(f.default) for f in fields(cls) if f.name not in kept}
        return cls(**off | sizes)

    @classmethod
    def from_name(cls, name: str) -> "ArmErrors":
        """Return a mix of sources by name.

        Parameters
        ----------
        name : {"typical", "gravity", "eccentricity", "none"}
            "typical" are the defaults. In "gravity" joints twist and tubes bend twice as much,
            four fifths of the shoulder's torque are balanced, and the encoders are good (a quarter
            of the eccentricity and of the wobble). In "eccentricity" encoders and axes are half
            again as bad and the arm is four times as stiff. "none" is a perfect arm.

        Returns
        -------
        ArmErrors
        """
        if name == "none":
            return cls.only()
        if not isinstance(name, str) or name not in _MIXES:
            raise ValueError(f"name must be one of {sorted([*_MIXES, 'none'])}, got {name!r}.")
        return cls(**_MIXES[name])
