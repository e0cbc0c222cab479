"""Logs of ROS 1 and ROS 2, written here by the library that reads them."""

import numpy as np
import pytest

from sklearn_raacmm.app import TableError, read_table

rosbags = pytest.importorskip("rosbags", reason="rosbags is not installed")

NAMES = [f"joint_{i}" for i in (3, 1, 2, 4, 5, 6)]
KINDS = ["bag", "mcap", "db3"]


def angles_at(times):
    """Angles of the joints 1 to 6, rad."""
    return 0.3 * np.sin(np.add.outer(times, np.arange(6)))


def write_log(folder, kind, lag=0.0, more=()):
    """A log of 2 s: joints every 20 ms in another order, a tracker's points every 150 ms."""
    from rosbags.rosbag1 import Writer
    from rosbags.rosbag2 import StoragePlugin, Writer as FolderWriter
    from rosbags.typesys import Stores, get_typestore

    path = folder / ("log.bag" if kind == "bag" else "log")
    if kind == "bag":
        store, writer = get_typestore(Stores.ROS1_NOETIC), Writer(path)
    else:
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        store = get_typestore(Stores.ROS2_HUMBLE)
        writer = FolderWriter(path, version=9, storage_plugin=plugin)

    def new(kind_of, **fields):
        return store.types[kind_of](**fields)

    def head(time):
        stamp = new("builtin_interfaces/msg/Time", sec=int(time), nanosec=round(time % 1 * 1e9))
        number = {"seq": 0} if kind == "bag" else {}
        return new("std_msgs/msg/Header", stamp=stamp, frame_id="", **number)

    def write(connection, time, message):
        to_bytes = store.serialize_ros1 if kind == "bag" else store.serialize_cdr
        data = to_bytes(message, connection.msgtype)
        # A log has its own times, those of arrival.
        writer.write(connection, round(1e9 * time) + 7_000_000, data)

    with writer:
        of_joints, *of_points = (
            writer.add_connection(topic, kind_of, typestore=store)
            for topic, kind_of in [
                ("/joint_states", "sensor_msgs/msg/JointState"),
                *((topic, "geometry_msgs/msg/PointStamped") for topic in ("/tracker", *more)),
            ]
        )
        for time in 1000 + 0.02 * np.arange(100):
            position, none = angles_at([time])[0, [2, 0, 1, 3, 4, 5]], np.zeros(0)
            state = {"name": NAMES, "position": position, "velocity": none, "effort": none}
            message = new("sensor_msgs/msg/JointState", header=head(time), **state)
            write(of_joints, time, message)
        for k, time in enumerate(999.95 + 0.15 * np.arange(15)):
            for topic in of_points:
                point = new("geometry_msgs/msg/Point", x=0.1 * k, y=1.0, z=2.0)
                stamped = {"header": head(time + lag), "point": point}
                write(topic, time, new("geometry_msgs/msg/PointStamped", **stamped))
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_points_get_the_angles_of_their_times(kind, tmp_path):
    """Between messages 20 ms apart a straight line is off by 0.3 rad (20 ms)^2 / 8 = 15 urad."""
    path = write_log(tmp_path, kind)
    files = [path] if kind == "bag" else [path, next(path.glob(f"*.{kind}"))]
    for file in files:
        table = read_table(file, 6, points=["x", "y", "z"])
        # The first point is before all messages of the joints, the last behind them.
        np.testing.assert_allclose(table.points, [[100.0 * k, 1000, 2000] for k in range(1, 14)])
        times = 999.95 + 0.15 * np.arange(1, 14)
        np.testing.assert_allclose(table.angles, angles_at(times), rtol=0, atol=1.6e-5)
        assert table.angle_unit == "rad"
        assert "13 of 15 points" in table.notes[0]


def test_what_a_log_does_not_say_is_asked_for(tmp_path):
    two = write_log(tmp_path, "mcap", more=["/prism"])
    with pytest.raises(TableError, match="which topic holds a tracker's points: /tracker, /prism"):
        read_table(two, 6, points=["x", "y", "z"])
    assert len(read_table(two, 6, points=["x", "y", "z"], sheet="/prism").points) == 13
    with pytest.raises(TableError, match="no messages JointState of 7 joints"):
        read_table(two, 7, points=["x", "y", "z"], sheet="/prism")
    (two / "metadata.yaml").unlink()
    with pytest.raises(TableError, match="ros2 bag reindex"):
        read_table(next(two.glob("*.mcap")), 6)


def test_clocks_that_have_nothing_in_common_are_named(tmp_path):
    path = write_log(tmp_path, "bag", lag=500.0)
    with pytest.raises(TableError, match=r"none of 15 points lies between .* the same clock"):
        read_table(path, 6, points=["x", "y", "z"])
