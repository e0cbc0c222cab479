"""The arm in files: JSON, and the robot's own description, read, written and edited in place."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from os import PathLike
from typing import Any

from sklearn_raacmm.arm._chain import write_urdf
from sklearn_raacmm.arm._files import read_json, write_json
from sklearn_raacmm.arm._urdf import read_urdf, update_urdf


class Formats:
    """Methods of `Arm` that read and write files."""

    @classmethod
    def from_urdf(
        cls,
        source: str | PathLike[str],
        *,
        base: str | None = None,
        tip: str | None = None,
    ) -> Any:
        """Read a chain of revolute joints from a URDF file.

        The table follows from the common normals of the axes. Fixed joints are folded in; angles
        such as "1.5708", which are pi/2 rounded, are taken as pi/2. The order of the joints is
        that from `base` to `tip`, their zeros and senses are the file's.

        Parameters
        ----------
        source : str or path-like
            Path of the file, or the text itself. Universal Robots' kinematics in YAML, as
            ur_calibration writes them, are read as well; their base is the controller's.
        base, tip : str, default=None
            Names of the links where the chain begins and ends; `tip` is the probe. None: the only
            ones there are.

        Returns
        -------
        Arm
            In the modified convention. Points are in the frame of the link `base` wherever a
            Denavit-Hartenberg table can start from it, as with a first axis along z through the
            origin; else a warning says from where.

        Raises
        ------
        ValueError
            If the file is no URDF, branches and `base` or `tip` is not given, or a joint on the
            way is prismatic or of another kind: the sentence names it.

        Warns
        -----
        UserWarning
            If the base frame is another, or if axes are so nearly parallel that they are taken as
            parallel.

        Examples
        --------
        >>> from sklearn_raacmm import Arm
        >>> arm = Arm.from_name("panda")
        >>> again = Arm.from_urdf(arm.to_urdf())
        >>> bool(abs(again.forward([[0.1] * 7]) - arm.forward([[0.1] * 7])).max() < 1e-9)
        True
        """
        return read_urdf(cls, source, base, tip)

    def to_urdf(self, path: str | PathLike[str] | None = None) -> str:
        """Write the arm as a URDF file: links without shape, revolute joints, and the probe.

        Joints have the names and limits of the arm; without limits they are continuous. Where the
        robot has a file of its own, `update_urdf` keeps what else stands there.

        Parameters
        ----------
        path : str or path-like, default=None
            File to write. None only returns the text.

        Returns
        -------
        str
            The text: links ``base_link``, ``link1``, ... and ``probe``, in m and rad.
        """
        return write_urdf(self, path)

    def update_urdf(
        self,
        original: str | PathLike[str],
        out: str | PathLike[str] | None = None,
        *,
        base: str | None = None,
        tip: str | None = None,
    ) -> str:
        """Write the calibrated arm back into the robot's own description.

        The origins of the joints from `base` to `tip` get new numbers. Everything else stays as it
        is in the file: names, limits, meshes, tools and comments.

        Parameters
        ----------
        original : str or path-like
            What `from_urdf` has read: a URDF or UR's kinematics, path or text.
        out : str or path-like, default=None
            File to write, which may be the original. None only returns the text.
        base, tip : str, default=None
            As for `from_urdf`.

        Returns
        -------
        str
            The text. Its kinematics are those of `forward`. A tool is no part of UR's kinematics:
            there the probe's distance from the last axis is left out.

        Raises
        ------
        ValueError
            If this arm was not read from the file, or the file has no place for its probe.

        Examples
        --------
        >>> from sklearn_raacmm import Arm
        >>> file = Arm.from_name("panda").to_urdf()
        >>> arm = Arm.from_urdf(file)
        >>> calibrated = arm.replace(a=arm.a + 0.1)
        >>> again = Arm.from_urdf(calibrated.update_urdf(file))
        >>> off = again.forward([[0.1] * 7]) - calibrated.forward([[0.1] * 7])
        >>> bool(abs(off).max() < 1e-9)
        True
        """
        return update_urdf(self, original, out, base, tip)

    @classmethod
    def from_json(cls, source: str | PathLike[str] | bytes | dict[str, Any]) -> Any:
        """Read an arm from a JSON file.

        Parameters
        ----------
        source : str, path-like, bytes or dict
            Path of the file; or the text itself, which starts with a brace, as str or as bytes in
            UTF-8; or the dict that the text stands for. A byte-order mark is ignored.

        Returns
        -------
        Arm
            The arm, equal to the one that was written.

        Raises
        ------
        ValueError
            If the text is not JSON, of another format or version, or a field is missing, not
            numeric or out of bounds; the sentence names the field.
        TypeError
            If `source` is of another type.
        OSError
            If the file cannot be read, or is a folder.
        """
        return read_json(cls, source)

    def to_json(self, path: str | PathLike[str] | None = None) -> str:
        """Write the arm as JSON, with the units in the names of the fields.

        Parameters
        ----------
        path : str or path-like, default=None
            File to write. It is written beside and renamed, so that a file of this name is always
            whole. None only returns the text.

        Returns
        -------
        str
            The text.

        Examples
        --------
        >>> from sklearn_raacmm import Arm
        >>> arm = Arm.from_name("panda")
        >>> Arm.from_json(arm.to_json()) == arm
        True
        """
        return write_json(self, path)
