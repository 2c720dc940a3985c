"""Files of every kind that holds a log, each made by the writer that users have.

A writer is given a path without its end, times in whole microseconds from zero, and the
readings of an accelerometer (m/s^2), a gyroscope (rad/s) and, if there is one, a
magnetometer (the unit of the format), and returns the path of what it made.
"""

import gzip
import struct
from functools import partial

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
import scipy.io
from pyulog import ULog
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.typesys import Stores, get_typestore
from written import written

NAMES = ("ax", "ay", "az", "wx", "wy", "wz", "mx", "my", "mz")


def names(sensors):
    return ("t_s", *NAMES[: 3 * len(sensors)])


def table(us, *sensors):
    return np.column_stack([us / 1e6, *sensors])


def csv(path, us, *sensors):
    return written(
        path.with_suffix(".csv"), ",".join(names(sensors)), table(us, *sensors)
    )


def csv_gz(path, us, *sensors):
    content = csv(path, us, *sensors).read_bytes()
    path = path.with_suffix(".csv.gz")
    path.write_bytes(gzip.compress(content))
    return path


def npy(path, us, *sensors):
    path = path.with_suffix(".npy")
    rows = table(us, *sensors)
    form = [(name, "f8") for name in names(sensors)]
    np.save(path, np.array(list(map(tuple, rows.tolist())), dtype=form))
    return path


def npz(path, us, *sensors):
    path = path.with_suffix(".npz")
    named = dict(zip(("acc", "gyro", "mag"), sensors, strict=False))
    np.savez_compressed(path, t_s=us / 1e6, **named)
    return path


def parquet(path, us, *sensors):
    path = path.with_suffix(".parquet")
    named = dict(zip(names(sensors), table(us, *sensors).T, strict=True))
    pyarrow.parquet.write_table(pyarrow.table(named), path)
    return path


def matlab(path, us, *sensors):
    path = path.with_suffix(".mat")
    named = dict(zip(("imu_acc", "imu_gyr", "imu_mag"), sensors, strict=False))
    scipy.io.savemat(path, named | {"t_s": us[:, None] / 1e6}, do_compression=True)
    return path


def hdf5(path, us, *sensors):
    """As BROAD's second form: datasets by the sensors' names, with checksums."""
    h5py = pytest.importorskip("h5py", reason="the extra `logs` is not installed")
    path = path.with_suffix(".hdf5")
    with h5py.File(path, "w") as file:
        file["t_s"] = us / 1e6
        for name, values in zip(
            ("imu_acc", "imu_gyr", "imu_mag"), sensors, strict=False
        ):
            file.create_dataset(name, data=values, fletcher32=True, compression="gzip")
    return path


def matlab73(path, us, *sensors):
    """https://www.mathworks.com/help/matlab/import_export/mat-file-versions.html.

    A block of text before HDF5, a structure as a group, all arrays turned, and words
    as numbers with the attribute of their class.
    """
    h5py = pytest.importorskip("h5py", reason="the extra `logs` is not installed")
    path = path.with_suffix(".mat")
    with h5py.File(path, "w", userblock_size=512) as file:
        named = dict(zip(("acc", "gyr", "mag"), sensors, strict=False))
        for name, values in {"t_s": us[:, None] / 1e6, **named}.items():
            file[f"imu/{name}"] = np.ascontiguousarray(values.T)
        file["imu/note"] = np.full((1, len(us)), 97, np.uint16)
        file["imu/note"].attrs["MATLAB_class"] = np.bytes_("char")
        file["#refs#/a"] = np.zeros((3, len(us)))
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, HDF5 schema 1.00 ."
    with path.open("r+b") as raw:
        raw.write(head.ljust(512))
    return path


def ros(path, us, force, rate, field=None, *, plugin=None, stamped=True, packed=False,
        late=(0,), order="little", frames=("imu_link",), poses=None):  # fmt: skip
    """A bag by rosbags: of ROS 1 without a plugin for storage, stamps if any.

    Messages are received so many ns late, and are of these frames, in turn; poses are
    the name of a message, positions and quaternions of each row.
    """
    first = plugin is None
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    kinds = store.types
    path = path.with_suffix(".bag") if first else path.with_suffix("")
    writer = Writer1(path) if first else Writer2(path, version=9, storage_plugin=plugin)
    if packed:  # each message by itself
        writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    pack = store.serialize_ros1
    if not first:
        pack = partial(store.serialize_cdr, little_endian=order == "little")
    three = kinds["geometry_msgs/msg/Vector3"]
    none = np.zeros(9)
    topics = {"Imu": "/imu/data", "MagneticField": "/imu/mag"}
    form = "sensor_msgs/msg/{}".format
    with writer:
        added = {
            name: writer.add_connection(topic, form(name), typestore=store)
            for name, topic in topics.items()
        }
        if poses is not None:
            pose_form = poses[0]
            truth = writer.add_connection("/body", pose_form, typestore=store)
        for k, t in enumerate((us * 1000).tolist()):
            t += 10**9  # a bag's times are from an epoch
            stamp = kinds["builtin_interfaces/msg/Time"](
                *divmod(stamped * t, 10**9),
            )
            sequence = {"seq": k} if first else {}
            header = kinds["std_msgs/msg/Header"](
                stamp=stamp, frame_id=frames[k % len(frames)], **sequence
            )
            turn = kinds["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 0.0)
            parts = turn, np.array([-1.0, *none[1:]]), three(*rate[k].tolist()), none
            messages = {"Imu": (header, *parts, three(*force[k].tolist()), none)}
            if field is not None:
                messages["MagneticField"] = (header, three(*field[k].tolist()), none)
            for name, parts in messages.items():
                raw = pack(kinds[form(name)](*parts), form(name))
                writer.write(added[name], t + late[k % len(late)], raw)
            if poses is not None:
                message = posed(kinds, header, pose_form, *(x[k] for x in poses[1:]))
                writer.write(truth, t, pack(message, pose_form))
    return path


def posed(kinds, header, form, place, turn):
    """A message of this name with a pose, and noise in whatever it has beside that."""
    point, turned, vector, *pair = (
        kinds[f"geometry_msgs/msg/{name}"]
        for name in ("Point", "Quaternion", "Vector3", "Pose", "Twist")
    )
    turned, sd = turned(*turn.tolist()), np.arange(36.0)
    if form.endswith("TransformStamped"):
        moved = kinds["geometry_msgs/msg/Transform"](vector(*place.tolist()), turned)
        return kinds[form](header, "a body", moved)
    pose = pair[0](point(*place.tolist()), turned)
    if form.endswith("PoseStamped"):
        return kinds[form](header, pose)
    pose = kinds["geometry_msgs/msg/PoseWithCovariance"](pose, sd)
    if not form.endswith("Odometry"):
        return kinds[form](header, pose)
    twist = pair[1](vector(1.0, 2.0, 3.0), vector(4.0, 5.0, 6.0))
    twist = kinds["geometry_msgs/msg/TwistWithCovariance"](twist, sd)
    return kinds[form](header, "body", pose, twist)


def ros1(path, *log):
    return ros(path, *log)


def ros2_folder(path, *log):
    return ros(path, *log, plugin=StoragePlugin.SQLITE3, packed=True)


def ros2_db3(path, *log):
    return next(ros(path, *log, plugin=StoragePlugin.SQLITE3).glob("*.db3"))


def mcap(path, *log):
    folder = ros(path, *log, plugin=StoragePlugin.MCAP)
    return next(folder.glob("*.mcap"))


def mcap_zstd(path, *log):
    """The same messages in chunks with checksums, as the writer of MCAP's own makes."""
    from mcap.writer import Writer

    made = mcap(path, *log)
    reader = McapReader(made)
    reader.open()
    path = path.with_name(f"{path.name}_zstd.mcap")
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="")
        numbers = {}
        for each in reader.connections:
            form = each.msgdef.data.encode()
            schema = writer.register_schema(each.msgtype, "ros2msg", form)
            numbers[each.id] = writer.register_channel(each.topic, "cdr", schema)
        for each, stamp, raw in reader.messages(reader.connections):
            writer.add_message(numbers[each.id], stamp, bytes(raw), stamp)
        writer.finish()
    reader.close()
    return path


def ulog_of(path, messages):
    """By pyulog: of each (name, number) the form of its fields, and their columns."""
    log = ULog(None)
    for at, ((name, number), (form, rows)) in enumerate(messages.items()):
        text = f"{name}:{form}".encode()
        header = ULog._MessageHeader()
        header.msg_size = len(text)
        log._message_formats[name] = ULog.MessageFormat(text, header)
        text = struct.pack("<BH", number, at) + name.encode()
        header.msg_size = len(text)
        own = ULog._MessageAddLogged(text, header, log._message_formats)
        columns = [rows[field] for field in own.dtype.names]
        own.buffer = bytearray(np.rec.fromarrays(columns, own.dtype).tobytes())
        log._data_list.append(ULog.Data(own))
    path = path.with_suffix(".ulg")
    log.write_ulog(str(path))
    return path


def ulog(path, us, *sensors):
    """Three messages of the same times."""
    form = "uint64_t timestamp;float x;float y;float z;"
    named = ("sensor_accel", 0), ("sensor_gyro", 0), ("sensor_mag", 0)
    rows = ({"timestamp": us + 1} | dict(zip("xyz", x.T, strict=True)) for x in sensors)
    return ulog_of(
        path, {name: (form, x) for name, x in zip(named, rows, strict=False)}
    )


def _dataflash(us, *sensors):
    """Records as pymavlink packs them."""
    from pymavlink.DFReader import DFFormat, DFMessage

    force, rate, *field = (np.float32(each).tolist() for each in sensors)
    forms = [
        DFFormat(number, name, 0, codes, labels)
        for name, number, codes, labels in (
            ("FMT", 128, "BBnNZ", "Type,Length,Name,Format,Columns"),
            ("IMU", 129, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
            ("MAG", 130, "QBfff", "TimeUS,I,MagX,MagY,MagZ"),
        )
    ]
    for form in forms:
        form.len = 3 + struct.calcsize(form.msg_struct)
    for form in forms:
        text = (form.name, form.format, ",".join(form.columns))
        yield DFMessage(forms[0], [form.type, form.len, *text], False, None)
    for k, t in enumerate(us.tolist()):
        yield DFMessage(forms[1], [t, 0, *rate[k], *force[k]], False, None)
        for each in field:
            yield DFMessage(forms[2], [t, 0, *each[k]], False, None)


def dataflash_text(path, us, *sensors):
    """The same records in words, by the form of ArduPilot's .log; not by its writer."""
    path = path.with_suffix(".log")
    records = _dataflash(us, *sensors)
    lines = [", ".join(map(str, (r.fmt.name, *r._elements))) for r in records]
    path.write_text("\n".join([*lines, ""]))
    return path


def dataflash(path, us, *sensors):
    path = path.with_suffix(".bin")
    path.write_bytes(b"".join(each.get_msgbuf() for each in _dataflash(us, *sensors)))
    return path


WRITERS = {  # by the name of the container: what writes it
    each.__name__: each
    for each in (
        *(
            csv,
            csv_gz,
            npy,
            npz,
            parquet,
            matlab,
            hdf5,
            matlab73,
            ros1,
            ros2_folder,
            ros2_db3,
            mcap,
        ),
        *(mcap_zstd, ulog, dataflash, dataflash_text),
    )
}
SINGLE = {"ulog", "dataflash", "dataflash_text"}
"""Formats of single precision."""
CHECKED = {"csv_gz", "npz", "matlab", "hdf5", "mcap_zstd"}
"""Formats with a checksum of the readings: a changed byte is seen."""
