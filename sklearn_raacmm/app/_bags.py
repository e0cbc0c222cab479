"""Rows of a log of ROS, .bag or .mcap: the joints, and a tracker's points by their times.

Messages are read by the package rosbags. What `sensor_msgs/JointState` and the messages of points
hold, and that angles are in rad and lengths in metres, ROS defines (REP 103).
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections import Counter
from operator import attrgetter, itemgetter

import numpy as np

_JOINTS = "JointState"
# Types of messages with a point of the tracker, and where it stands in them.
_POINTS = {
    "PointStamped": "point",
    "PoseStamped": "pose.position",
    "PoseWithCovarianceStamped": "pose.pose.position",
    "TransformStamped": "transform.translation",
    "Odometry": "pose.pose.position",
}
# Seconds between two messages of the joints, of which more tell nothing of what is between. A
# choice.
_GAP = 0.1


def read_bag(path, n_joints, topics=()):
    """What was read, names of the columns, and rows: time, names of joints, angles, point.

    A point gets the angles between those of the two messages before and behind it; points without
    such neighbours are left out. Without points each message of the joints is a row. `topics` says
    which are meant. What cannot be decided or read raises a ValueError.
    """
    from rosbags.highlevel import AnyReader, AnyReaderError

    # A log of ROS 2 is a folder with a list of its files.
    folder = path if path.is_dir() or path.suffix == ".bag" else path.parent
    try:
        with AnyReader([folder]) as log:
            joints = _messages(log, {_JOINTS}, topics, "joints")
            points = _messages(log, _POINTS, topics, "a tracker's points")
    except FileNotFoundError:
        raise ValueError(
            f"a log of ROS 2 needs its metadata.yaml beside it: ros2 bag reindex {folder} makes it."
        ) from None
    except AnyReaderError as error:
        raise ValueError(str(error)) from None
    names = Counter(tuple(one.name) for _, one in joints if len(one.name) >= n_joints)
    if not names:
        raise ValueError(f"no messages {_JOINTS} of {n_joints} joints were found.")
    names = names.most_common(1)[0][0]  # other drivers may send their own
    states = [(stamp, one.position) for stamp, one in joints if tuple(one.name) == names]
    times, angles = (np.array(values, dtype=float) for values in zip(*states, strict=True))
    fields = [f"{field}{i}" for field in ("name", "position") for i in range(len(names))]
    own, what = np.column_stack([times, angles]), f"{len(times)} messages"
    if points:
        at, xyz = (np.array(values) for values in zip(*map(_point, points), strict=True))
        behind = np.searchsorted(times, at, side="right").clip(1, len(times) - 1)
        between = (at >= times[0]) & (at <= times[-1]) & (np.diff(times)[behind - 1] <= _GAP)
        if not between.any():
            raise ValueError(
                f"none of {len(at)} points lies between messages of the joints that are at most "
                f"{_GAP} s apart: do both have the same clock?"
            )
        turned = [np.interp(at, times, column) for column in np.unwrap(angles, axis=0).T]
        own = np.column_stack([at, *turned, xyz])[between]
        what = f"{len(own)} of {len(at)} points, those between messages of the joints"
        fields += [f"{axis} [m]" for axis in "xyz"]
    rows = [[t, *names, *numbers] for t, *numbers in own.tolist()]
    return f"Log of ROS, {what}", ["time", *fields], list(enumerate(rows, 1))


def _messages(log, kinds, topics, what):
    """Times in s and messages of the one topic of these kinds; none where there is no topic."""
    known = {one.topic: one for one in log.connections if one.msgtype.split("/")[-1] in kinds}
    if len(known) > 1:
        known = {topic: one for topic, one in known.items() if topic in topics} or known
    if len(known) > 1:
        raise ValueError(f"--sheet has to say which topic holds {what}: {', '.join(known)}.")
    messages = []
    for connection, received, data in log.messages(known.values()) if known else ():
        message = log.deserialize(data, connection.msgtype)
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        messages.append((stamp or 1e-9 * received, message))
    return sorted(messages, key=itemgetter(0))


def _point(pair):
    """Time, and coordinates in m, of a time and a message of a point."""
    stamp, message = pair
    where = _POINTS[type(message).__name__.rpartition("__")[2]]
    point = attrgetter(where)(message)
    return stamp, (point.x, point.y, point.z)
